//! Label maps from photos alone: a 2D semantic segmenter, read from an ONNX file and run by `tract`.
//!
//! A [`Contract`] says how the network reads photos and what its output means. A [`Network`] gives [`Logits`] for a photo.
//! [`Mapping`] makes the network's classes the user's. The result is a label map of the photo's size, and the scores of the best
//! classes at the cells of the output ([`crate::data::ScoreMap`]). [`label_scene`] labels a scene folder.

pub mod contract;
mod folder;
mod graph;
mod index;
mod mapping;
mod model;
mod run;
mod turned;
mod values;

pub use self::contract::Contract;
pub use self::folder::{Job, Labelled, label_scene};
pub use self::mapping::{ClassFile, Mapping};
pub use self::model::{Network, is_guarded};
pub use self::run::Logits;
