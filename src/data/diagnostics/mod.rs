//! What is wrong with a scene folder, and what it holds.

pub(crate) mod cautions;
pub(crate) mod check;
pub(crate) mod info;
pub(crate) mod poses;
pub(crate) mod sweep;
