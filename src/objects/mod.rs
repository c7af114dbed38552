//! Labels of Gaussians: association of segments across views, votes over raw labels, stored identities, label rendering, edits.

mod association;
mod borders;
mod calibration;
mod coloring;
mod edits;
mod identities;
mod inventory;
mod label_errors;
mod label_maps;
mod pooled_vote;
mod regions;
mod relevancy;
mod renderer;
mod select;
mod semantics;
mod separate;
mod smoothing;
mod superpoints;
mod vote;

pub use self::association::{AssociatedObjects, associate};
pub use self::borders::{BlockObjects, JoinedObjects, join_objects};
pub use self::calibration::Calibration;
pub use self::coloring::{color_all_apart, color_apart};
pub(crate) use self::edits::farthest;
pub use self::edits::{
    Corrections, Edited, Editing, Edits, NewObject, Operation, Turn, VERSION as EDITS_VERSION,
    is_name,
};
pub use self::identities::Identities;
pub use self::inventory::{Object, Picked, inventory, pick};
pub use self::label_errors::LabelErrors;
pub use self::label_maps::LabelMaps;
pub use self::pooled_vote::{PooledVote, PooledVotes, pooled_vote};
pub use self::regions::Regions;
pub use self::relevancy::{CANONICAL, NEUTRAL, Similarities, best_scale, largest, selections};
pub use self::renderer::{Frame, RenderOptions, Renderer};
pub use self::select::{Growth, seed};
pub use self::semantics::{Semantics, has_truth};
pub use self::separate::{Separated, Separation};
pub use self::smoothing::smoothed;
pub use self::superpoints::{Superpoints, SurfaceGraph};
pub use self::vote::{Votes, refined_vote, vote, weighted_vote};
