//! All public behaviour, one module a subject, in one binary.

mod absgrad;
mod adam;
mod assignment;
mod association;
mod association_figures;
mod attendance;
mod backends;
mod bench;
mod blender;
mod building;
mod building_settings;
mod builtin;
mod camera_files;
mod camera_paths;
mod cameras;
mod cautions;
mod checkpoint;
mod classes;
mod cli;
mod colmap;
mod colmap_models;
mod config;
mod consistency;
mod data_check;
mod decoder;
mod decoder_chunks;
mod densify;
#[cfg(feature = "wgpu")]
mod device_building;
#[cfg(feature = "wgpu")]
mod device_dense;
#[cfg(feature = "wgpu")]
mod device_labels;
#[cfg(feature = "wgpu")]
mod device_ops;
#[cfg(feature = "wgpu")]
mod device_stage_two;
#[cfg(feature = "wgpu")]
mod device_training;
#[cfg(feature = "wgpu")]
mod device_unprojection;
mod dino;
mod dino_reference;
mod dino_weights;
mod edit;
mod features;
mod fused;
mod given;
mod gsplat;
mod instance_metrics;
#[cfg(unix)]
mod interrupt;
mod lens;
mod level;
mod loss;
mod map_geometry;
mod mask_folders;
mod masked_training;
mod masked_unprojection;
mod masks;
mod mcmc;
mod metrics;
mod mobilenet;
mod neighbours;
mod object_classes;
mod ops;
mod pca;
mod photometric;
mod photos;
mod plates;
mod ply;
mod poses;
mod pretrain;
mod provenance;
mod randla;
mod raster;
mod raster_contract;
#[cfg(feature = "wgpu")]
mod raster_gpu;
mod raster_gradients;
mod raster_reference;
#[cfg(feature = "wgpu")]
mod raster_room;
mod raw_formats;
mod real_poses;
mod relocation;
mod render_settings;
mod renderer;
mod replica;
mod report;
mod resume;
mod run_folder;
mod scannet;
mod segments;
mod separate;
mod smoothing;
mod solve;
mod splits;
mod spoilt_masks;
mod stage_two;
mod stops;
mod torch_file;
mod transforms;
mod turned_photos;
mod unprojection;
mod unread;
mod viewer;
mod viewer_edits;
mod views;
mod votes;
mod weights;

use burn::tensor::Device;
use coseg::device::BackendName;
use std::path::PathBuf;

/// The device of tests that are not about devices: ndarray, or the first CPU backend compiled in.
pub fn device() -> Device {
    let name = BackendName::compiled()
        .iter()
        .rfind(|name| **name != BackendName::Wgpu);
    coseg::device::open(name.copied()).expect("a CPU backend")
}

/// The wgpu device, if this machine has one that all kernels run on. Without it tests say so and pass, unless the
/// environment has COSEG_REQUIRE_GPU, which is `hardware` where a software adapter is not enough.
#[cfg(feature = "wgpu")]
pub fn gpu() -> Option<Device> {
    let required = std::env::var_os("COSEG_REQUIRE_GPU");
    let hardware = required.as_ref().is_some_and(|how| how == "hardware");
    let device = if hardware {
        coseg::device::open_hardware_gpu()
    } else {
        coseg::device::open_gpu()
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
