//! How the program's allocator returns memory.

/// Keeps freed memory in the process.
///
/// Each training step allocates and frees the same large tensors. By default glibc returns them to the system, which then
/// clears every page for the next step. Small scenes suffer most.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn keep_freed_memory() {
    /// The largest value that glibc accepts: larger allocations still get pages of their own.
    const MAPPED_FROM: libc::c_int = 32 << 20;
    // SAFETY: sets two parameters of the allocator; no memory is read or written.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, MAPPED_FROM);
        libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
    }
}

/// Other allocators need no advice.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn keep_freed_memory() {}
