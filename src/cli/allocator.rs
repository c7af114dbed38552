//! How the program's allocator gives memory back.

/// Lets freed memory stay with the process.
///
/// A training step allocates and frees the same large tensors again and again. By default glibc returns them to the system,
/// which clears every page anew for the next step; small scenes feel it most.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn keep_freed_memory() {
    /// The largest that glibc takes: greater allocations still have pages of their own.
    const MAPPED_FROM: libc::c_int = 32 << 20;
    // SAFETY: sets two parameters of the allocator; no memory is read or written.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, MAPPED_FROM);
        libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
    }
}

/// Other allocators keep what they see fit.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn keep_freed_memory() {}
