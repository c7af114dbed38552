//! Messages of graphics drivers that say nothing to a user.

/// Stops a layer of Mesa from looking for a desktop where there is none: it prints an error each time it fails, on servers and in
/// containers.
pub fn silence_drivers() {
    // Other systems have no such layer.
    let has_layer = cfg!(all(target_os = "linux", feature = "wgpu"));
    if has_layer && std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: the program has no other thread yet.
        unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    }
}
