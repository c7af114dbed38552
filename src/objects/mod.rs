//! Which thing each Gaussian belongs to: the vote over raw labels, stored identities, label rendering.

mod identities;
mod vote;

pub use identities::{Identities, label_map};
pub use vote::{Votes, vote};
