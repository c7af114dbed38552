//! Scenes, references and devices that several tests share.

pub mod dino_reference;
pub mod plates;
pub mod raster_reference;
pub mod spoilt_masks;
pub mod torch_file;

use burn::tensor::Device;
use coseg::backend::device::BackendName;
use std::path::PathBuf;

/// The device of tests that are not about devices: ndarray, or the first CPU backend compiled in.
pub fn device() -> Device {
    let name = BackendName::compiled()
        .iter()
        .rfind(|name| **name != BackendName::Wgpu);
    coseg::backend::device::open(name.copied()).expect("a CPU backend")
}

/// The wgpu device, if this machine has one that all kernels run on. Without it tests say so and pass, unless the
/// environment has COSEG_REQUIRE_GPU, which is `hardware` where a software adapter is not enough.
#[cfg(feature = "wgpu")]
pub fn gpu() -> Option<Device> {
    let required = std::env::var_os("COSEG_REQUIRE_GPU");
    let hardware = required.as_ref().is_some_and(|how| how == "hardware");
    let device = if hardware {
        coseg::backend::device::open_hardware_gpu()
    } else {
        coseg::backend::device::open_gpu()
    };
    let device = device.inspect_err(|error| assert!(required.is_none(), "{error}"));
    device
        .inspect_err(|error| eprintln!("SKIPPED: {error}"))
        .ok()
}

/// The message of `error` must hold all of `parts`.
#[track_caller]
pub fn assert_names(error: &coseg::Error, parts: &[&str]) {
    let message = error.to_string();
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
}

/// The folder of real scenes and weights that some tests use, if it is there; those tests say so and pass otherwise.
pub fn shared_dir() -> Option<PathBuf> {
    let dir = std::env::var_os("COSEG_SHARED").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"),
        PathBuf::from,
    );
    if dir.is_dir() {
        return Some(dir);
    }
    eprintln!("SKIPPED: {} is absent", dir.display());
    None
}
