//! Stage one: Gaussians from photos. Schedule, densification, 3DGS-MCMC, initialization.

pub(crate) mod building;
pub(crate) mod building_state;
pub mod densify;
pub mod frusta;
pub mod initialization;
pub mod noise;
pub(crate) mod parameters;
pub(crate) mod photos;
pub mod relocate;
pub mod schedule;

pub use self::building::BuildingStage;
pub use self::building::Densified;
pub use self::building::StepReport;
pub use self::building_state::BuildingState;
pub use self::parameters::Moments;
