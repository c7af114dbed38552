//! Tests of `coseg::objects`.

pub mod association;
pub mod corrections;
#[cfg(feature = "wgpu")]
pub mod device_labels;
pub mod edit;
pub mod edits;
pub mod normals;
pub mod object_classes;
pub mod renderer;
pub mod segments;
pub mod select;
pub mod separate;
pub mod separate_refused;
pub mod votes;
