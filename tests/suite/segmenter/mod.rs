//! `coseg::segmenter`: contracts, networks, labels of a scene folder, and the network of `../shared` against its reference.

mod contract;
mod features;
mod label;
mod model;
mod parity;
mod scene_folders;
mod scores;
mod turned_photos;
mod values;
