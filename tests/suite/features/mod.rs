//! Tests of `coseg::features`.

pub mod clip;
pub mod dino;
pub mod dino_weights;
pub mod extraction;
pub mod imported_maps;
pub mod mobilenet;
pub mod pca;
pub mod weights;
