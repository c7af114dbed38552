//! Segmented 3D Gaussian scenes from posed photos and noisy 2D label maps.
//!
//! The crate implements CoSegGaussians: *Learning Segmented 3D Gaussians via Efficient Feature Unprojection for Zero-shot
//! Neural Scene Segmentation* ([arXiv 2401.05925](https://arxiv.org/abs/2401.05925)). `preset = "paper"` ([`config`]) follows
//! the paper where it states a choice; `docs/settings.md` names the rest.
//!
//! ```text
//!  data::load               photos, cameras, label maps                    data::Scene
//!      |
//!  reconstruct              stage one: Gaussians from photos               splat::Gaussians
//!      |
//! (associate)               segments of single views become objects        data::Scene with one id for each object
//!      |
//!  lift                     2D features onto Gaussians, Eq. 5              LiftedFeatures, pruned Gaussians
//!      |
//!  encode                   RandLA-Net features of the centres, Eq. 6      pipeline::Encodings, then DecoderInput
//!      |
//!  train_decoder            decoder (Eq. 7) under the CoSeg loss (Eq. 10)  objects::Identities, [N, classes]
//!      |
//!  evaluate, report, viewer label maps of held-out views, scores, pages    metrics.json, report.html, viewer.html, scene.ply
//! ```
//!
//! [`pipeline::run`] calls these steps in order. `docs/architecture.md` says where each equation of the paper is computed.
//!
//! | paper | where |
//! |---|---|
//! | Eq. 1 to 4, rendering in N channels | [`raster`] |
//! | Eq. 5, Algorithm 1, unprojection | [`segmentation::unprojection`]: [`LiftedViews::add`](segmentation::unprojection::LiftedViews::add) sums, [`features`](segmentation::unprojection::LiftedViews::features) divides |
//! | Eq. 6, RandLA-Net | [`segmentation::randla`] |
//! | Eq. 7, decoder | [`Decoder`](segmentation::decoder::Decoder) |
//! | Eq. 8, label loss | [`LabelLoss`](segmentation::loss::LabelLoss) |
//! | Eq. 9, neighbours agree | [`neighbour_divergence`](segmentation::loss::neighbour_divergence) |
//! | Eq. 10, CoSeg loss | [`CoSegLoss::forward`](segmentation::loss::CoSegLoss::forward) |
//! | stage one | [`reconstruction`] |
//! | stage two | [`pipeline::train_decoder`] |
//!
//! Operations run on ndarray and flex by CPU kernels in f32 or f64, and on wgpu by CubeCL kernels in f32.
//!
//! Cameras look along +z with x right and y down, pixel centres at half integers. Gaussians are stored unactivated, as in their
//! PLY. Class id 0 is unlabelled unless `classes.json` says otherwise.
//!
//! ```
//! use coseg::splat::camera::Camera;
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
//! let camera = Camera::centred([80.0; 2], [65, 49]).with_opengl_pose(&pose).expect("a rigid pose");
//! let picture = render(&ball, &camera, &Settings::default(), [0.0; 3])?;
//! let centre = 3 * (24 * 65 + 32);
//! assert!(picture.rgb[centre] > 0.99 && picture.rgb[centre + 1] < 0.01);
//! assert!(picture.rgb[0] < 0.01, "nothing in the corner");
//! # Ok::<(), coseg::Error>(())
//! ```

pub mod backend;
pub mod bench;
pub mod capture;
pub mod checkpoint;
pub mod compare;
pub mod config;
pub mod data;
pub mod error;
pub mod features;
pub mod files;
mod memory;
pub mod metrics;
pub mod objects;
pub mod ops;
pub mod pipeline;
pub mod progress;
pub mod provenance;
pub mod random;
pub mod ranks;
pub mod raster;
pub mod reconstruction;
pub mod report;
pub mod runs;
mod seal;
pub mod segmentation;
pub mod segmenter;
#[cfg(feature = "serve")]
mod server;
pub mod splat;
pub mod viewer;
#[cfg(feature = "serve")]
pub mod watch;
pub mod weights;

pub use crate::error::{Error, Result};
