//! The tests of the crate's public behaviour in one binary. Folders mirror `src`; what tests share lives in `support`.

mod backend;
mod cli;
mod compare;
mod config;
mod data;
mod features;
mod files;
mod metrics;
mod objects;
mod ops;
mod pipeline;
mod ranks;
mod raster;
mod reconstruction;
mod report;
mod runs;
mod segmentation;
mod segmenter;
mod splat;
mod support;
mod viewer;
#[cfg(feature = "serve")]
mod watch;
