//! Tests of `coseg::ranks`.

#[cfg(all(feature = "mpi", target_os = "linux"))]
pub mod mpirun;
pub mod single;
