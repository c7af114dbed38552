//! Segmented 3D Gaussian scenes from posed photos and noisy 2D label maps.
//!
//! Two stages, as in the paper *CoSegGaussians: Compact and Swift Scene Segmenting 3D Gaussians with Dual Feature Fusion*
//! (arXiv 2401.05925): Gaussians are built from the photos ([`reconstruction::Trainer`]); then image features, unprojected onto
//! them ([`segmentation::unprojection`]), and features of a point encoder ([`segmentation::randla`]) are fused by a decoder
//! that learns from the label maps under a loss that stands noise ([`train::segmentation`]). [`train::run`] does both, and
//! is what `coseg train` calls. What departs from the paper is a setting, named by `preset = "paper"` ([`config`]).
//!
//! # Parts that stand alone
//!
//! | what | where |
//! |---|---|
//! | a differentiable rasterizer of N channels, as an operation of burn | [`raster::rasterize`] |
//! | one view's blending as a linear map and its adjoint, on the CPU in `f32` or `f64` | [`raster::Projected`] |
//! | scenes in the layouts of nerfstudio, COLMAP, Replica, ScanNet | [`data::load`] |
//! | 3DGS PLY files with labels, hostile ones included | [`gaussians::ply`] |
//! | clone, split and prune; relocation of 3DGS-MCMC | [`gaussians::densify`], [`gaussians::relocate`] |
//! | a vote of label maps, objects from masks with ids of their view alone, picking | [`objects`] |
//! | new views: paths through cameras, circles around things | [`camera_path`] |
//! | a scene as a page for the browser | [`viewer::Viewer`] |
//! | DINO, MobileNetV2 and weight-free features of an image | [`features`] |
//!
//! `examples/` has the rasterizer in a training loop of burn's own optimiser, and features lifted onto Gaussians.
//!
//! # One code, several backends
//!
//! Operations of this crate run on burn's ndarray and flex backends by kernels for the CPU (AVX2 and AVX-512 chosen at run
//! time), in `f32` or `f64`; on wgpu most by CubeCL kernels, in `f32`, the rest by burn's. cuda, by name alone, is type-checked and was
//! never run. [`device::open`] takes a GPU where there is one, else a CPU backend.
//!
//! # Conventions
//!
//! Cameras look along +z with x right and y down, pixel centres at half integers ([`camera`]). Gaussians are kept unactivated, as
//! their PLY stores them ([`gaussians::Gaussians`]). Class id 0 is unlabelled unless `classes.json` says otherwise. Every error
//! is an [`Error`] that names what was found, what was expected and what mends it.
//!
//! ```
//! use coseg::splat::camera::{Camera, Intrinsics};
//! use coseg::splat::Gaussians;
//! use coseg::raster::{Settings, render};
//! use glam::{DMat4, DVec3};
//!
//! // One opaque red ball a metre wide, four metres ahead.
//! let ball = Gaussians {
//!     means: vec![[0.0; 3]],
//!     log_scales: vec![[0.5_f32.ln(); 3]],
//!     rotations: vec![[1.0, 0.0, 0.0, 0.0]],
//!     opacity_logits: vec![10.0],
//!     sh: vec![0.5 / 0.282_094_8, -0.5 / 0.282_094_8, -0.5 / 0.282_094_8],
//!     sh_degree: 0,
//! };
//! let pose = DMat4::look_at_rh(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, DVec3::Y).inverse();
//! let intrinsics = Intrinsics { fx: 80.0, fy: 80.0, cx: 32.5, cy: 24.5, width: 65, height: 49 };
//! let camera = Camera::from_opengl(&pose, intrinsics).expect("a rigid pose");
//! let picture = render(&ball, &camera, &Settings::default(), [0.0; 3])?;
//! let centre = 3 * (24 * 65 + 32);
//! assert!(picture.rgb[centre] > 0.99 && picture.rgb[centre + 1] < 0.01);
//! assert!(picture.rgb[0] < 0.01, "nothing in the corner");
//! # Ok::<(), coseg::Error>(())
//! ```

pub mod backend;
pub mod bench;
pub mod checkpoint;
pub mod config;
pub mod data;
pub mod error;
pub mod features;
pub mod files;
pub mod metrics;
pub mod objects;
pub mod ops;
pub mod pipeline;
pub mod progress;
pub mod provenance;
pub mod random;
pub mod raster;
pub mod reconstruction;
pub mod report;
pub mod segmentation;
pub mod splat;
pub mod viewer;
pub mod weights;

pub use crate::error::{Error, Result};
