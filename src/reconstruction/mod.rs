//! Stage one: 3D Gaussians from posed photos (3DGS, Kerbl et al. 2023).

mod budget;
mod densification;
pub mod densify;
pub mod initialization;
pub(crate) mod optimizer;
pub(crate) mod pruning;
pub mod schedule;
mod state;
mod step;
mod trainer;

pub(crate) use self::budget::MAX_GAP;
pub use self::densify::Densified;
pub use self::optimizer::Moments;
pub use self::state::TrainerState;
pub use self::trainer::{StepReport, Trainer};
