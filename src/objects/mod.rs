//! Which thing each Gaussian belongs to: association of segments across views, the vote over raw labels, stored identities, label rendering.

mod association;
mod device_labels;
mod hard_labels;
mod identities;
mod inventory;
mod label_maps;
mod renderer;
mod semantics;
mod separate;
mod smoothing;
mod vote;

pub use association::{Association, Group, associate, associate_until};
pub use hard_labels::hard_label_map;
pub use identities::Identities;
pub use inventory::{Object, Picked, inventory, pick};
pub use label_maps::{DeviceLabelMaps, LabelMaps, LabelRule, label_map};
pub use renderer::{Frame, RenderOptions, Renderer};
pub use semantics::{Semantics, has_truth};
pub use separate::{Separated, Separation};
pub use smoothing::{Diffusion, NeighbourGraph};
pub use vote::{Votes, vote};
