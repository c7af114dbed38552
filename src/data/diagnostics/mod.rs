//! What is wrong with a scene folder, what it holds, and what is probably a mistake.
//!
//! A fault is an error and stops loading. A notice is a sentence about input that loads but is probably a mistake.

pub(crate) mod check;
mod convention;
pub(crate) mod info;
pub(crate) mod notices;
mod photometric_poses;
pub(crate) mod poses;
