//! What is wrong with a scene folder, what it holds, and what loads but is seldom intended.
//!
//! Faults are errors, and stop loading. Notices are sentences for what loads but is seldom intended.

pub(crate) mod check;
mod convention;
pub(crate) mod info;
pub(crate) mod notices;
mod photometric_poses;
pub(crate) mod poses;
