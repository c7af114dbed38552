//! Which thing each Gaussian belongs to: association of segments across views, the vote over raw labels, stored identities, label rendering.

mod association;
mod hard_labels;
mod identities;
mod inventory;
mod renderer;
mod semantics;
mod separate;
mod smoothing;
mod vote;

pub use association::{Association, Group, associate, associate_until};
pub use hard_labels::hard_label_map;
pub use identities::{Identities, LabelRule, label_map};
pub use inventory::{Object, Picked, inventory, pick};
pub use renderer::{Frame, RenderOptions, Renderer};
pub use semantics::{Semantics, has_truth};
pub use separate::{Separated, Separation};
pub use smoothing::{Diffusion, NeighbourGraph};
pub use vote::{Votes, vote};
