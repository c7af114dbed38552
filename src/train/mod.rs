//! The two stages of training: building Gaussians from photos, then segmentation identities; checkpoints, progress.

pub mod checkpoint;
