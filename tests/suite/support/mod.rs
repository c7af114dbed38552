//! Scenes, references and devices that several tests share.

pub mod bent_photos;
pub mod blender;
pub mod browser;
pub mod capture;
#[cfg(feature = "serve")]
pub mod client;
pub mod clip_weights;
pub mod colmap;
pub mod comparison;
pub mod damage;
#[cfg(feature = "wgpu")]
pub mod device_tensors;
#[cfg(unix)]
pub mod devtools;
pub mod dino_reference;
pub mod dino_weights;
#[cfg(unix)]
pub mod edited_plates;
pub mod exif_photo;
pub mod feature_maps;
pub mod finite_differences;
pub mod generator;
pub mod glb;
pub mod hall;
pub mod hard_labels;
pub mod label_losses;
pub mod labelme_files;
pub mod lifting;
pub mod linear_probe;
pub mod made_up_report;
pub mod masked_plates;
pub mod mobilenet_weights;
pub mod onnx;
pub mod painted_plane;
pub mod photometric;
pub mod pictures;
pub mod plate_objects;
pub mod plate_runs;
pub mod plates;
#[path = "../../../examples/pretrain_encoder/training.rs"]
pub mod pretraining;
pub mod program;
#[cfg(unix)]
pub mod programs;
pub mod raster_errors;
pub mod raster_precision;
pub mod raster_reference;
pub mod raw_labels;
pub mod rendered_views;
#[path = "../../../examples/pretrain_encoder/rooms.rs"]
pub mod rooms;
pub mod rounding;
pub mod scannet;
#[cfg(feature = "serve")]
pub mod served_plates;
pub mod settings_file;
pub mod short_runs;
pub mod small_scene;
pub mod snapshot;
pub mod sog;
pub mod spoilt_masks;
pub mod spz;
pub mod torch_file;
pub mod transforms_json;
pub mod turned_cameras;

use burn::tensor::{Device, Int, Tensor, TensorData};
use coseg::backend::device::{self, BackendName};
use coseg::backend::host_fallbacks;
use coseg::segmentation::encoder::Encoding;
use coseg::segmentation::pyramid::{Pyramid, Switches};
use std::path::PathBuf;

/// The device of tests that do not compare devices: ndarray, or the first CPU backend of the build.
pub fn device() -> Device {
    let name = BackendName::compiled()
        .iter()
        .rfind(|name| **name != BackendName::Wgpu);
    device::open(name.copied()).expect("a CPU backend")
}

/// A device of each backend of this build, by name; without the GPU where this machine has none.
pub fn devices() -> Vec<(BackendName, Device)> {
    let named = |&name: &BackendName| {
        let device = match name {
            #[cfg(feature = "wgpu")]
            BackendName::Wgpu => gpu()?,
            name => device::open(Some(name)).expect("a CPU backend"),
        };
        Some((name, device))
    };
    BackendName::compiled().iter().filter_map(named).collect()
}

/// The wgpu device, if this machine has one that runs all kernels. Without it tests print that they skip, and pass. With
/// `COSEG_REQUIRE_GPU` in the environment they fail; `COSEG_REQUIRE_GPU=hardware` also refuses a software adapter.
#[cfg(feature = "wgpu")]
pub fn gpu() -> Option<Device> {
    let required = std::env::var_os("COSEG_REQUIRE_GPU");
    let hardware = required.as_ref().is_some_and(|how| how == "hardware");
    let name = BackendName::Wgpu;
    let opened = device::open(Some(name)).map_err(|error| error.to_string());
    let suited = opened.and_then(|gpu| {
        let adapter = device::described(name);
        match device::missing_capability(&gpu) {
            Some(missing) => Err(format!("{adapter} lacks what the kernels need: {missing}")),
            None if hardware && adapter.ends_with(", a software adapter)") => {
                Err(format!("{adapter} is the only one"))
            }
            None => Ok(gpu),
        }
    });
    let suited = suited.inspect_err(|reason| assert!(required.is_none(), "{reason}"));
    suited
        .inspect_err(|reason| eprintln!("SKIPPED: {reason}"))
        .ok()
}

/// What `f` gives, none of whose tensors went to the CPU's kernels when it ran on a GPU.
pub fn on_device<T>(on: Option<&Device>, f: impl FnOnce() -> T) -> T {
    let before = host_fallbacks();
    let out = f();
    assert!(
        on.is_none() || host_fallbacks() == before,
        "{} tensors went to the host",
        host_fallbacks() - before
    );
    out
}

/// Prints that a test skips because `reason`. With `COSEG_REQUIRE_PROGRAMS=1` in the environment the test fails.
#[track_caller]
pub fn skip_without_program(reason: &str) {
    let required = std::env::var_os("COSEG_REQUIRE_PROGRAMS").is_some_and(|value| value != "0");
    assert!(!required, "COSEG_REQUIRE_PROGRAMS is set, but {reason}");
    eprintln!("SKIPPED: {reason}");
}

/// An encoding joined with `image`, f_d of each scale for the whole cloud.
pub fn joined_pyramid(encoding: &Encoding, image: &[Tensor<2>], switches: Switches) -> Pyramid {
    let joined = Pyramid::new(encoding, switches, |scale, rows| {
        let rows: Vec<i64> = rows.iter().map(|&row| row.into()).collect();
        let count = rows.len();
        let rows = TensorData::new(rows, [count]);
        let rows = Tensor::<1, Int>::from_data(rows, &image[scale].device());
        Ok(image[scale].clone().select(0, rows))
    });
    joined.expect("features")
}

/// Asserts that the message of `error` contains all of `parts`.
#[track_caller]
pub fn assert_names(error: &coseg::Error, parts: &[&str]) {
    let message = error.to_string();
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
}

/// The folder of real scenes and weights that some tests use. Without it these tests print that they skip, and pass; with
/// `COSEG_REQUIRE_SHARED=1` in the environment they fail.
pub fn shared_dir() -> Option<PathBuf> {
    let dir = std::env::var_os("COSEG_SHARED").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"),
        PathBuf::from,
    );
    if dir.is_dir() {
        return Some(dir);
    }
    let required = std::env::var_os("COSEG_REQUIRE_SHARED").is_some_and(|value| value != "0");
    assert!(
        !required,
        "COSEG_REQUIRE_SHARED is set, but {} is absent",
        dir.display()
    );
    eprintln!("SKIPPED: {} is absent", dir.display());
    None
}

/// A file below [`shared_dir`], under the same rule.
pub fn shared_file(path: &str) -> Option<PathBuf> {
    let file = shared_dir()?.join(path);
    assert!(file.is_file(), "{} is absent", file.display());
    Some(file)
}
