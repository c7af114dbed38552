//! The `coseg` command line.
fn main() {}
