//! Labelled points of procedural rooms that are never evaluated.

use coseg::data::builtin::{PRETRAINING_SEEDS, classes, labelled_points};
use coseg::metrics::{Confusion, Void};

/// Rooms of one seed; held-out rooms follow the trained ones.
pub const ROOMS_PER_SEED: u64 = 1 << 12;

/// Labelled points of one room.
#[derive(Clone, Debug, Default)]
pub struct LabelledCloud {
    /// `[N, 3]` metres, z up.
    pub positions: Vec<[f32; 3]>,
    /// `[N]` class indices, [`NO_CLASS`](coseg::segmentation::pixels::NO_CLASS) where there is none.
    pub labels: Vec<u16>,
}

/// How well labels can be told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scores {
    /// Share of labelled points told right.
    pub accuracy: f64,
    /// Mean IoU over the classes present, all rooms together.
    pub miou: f64,
}

impl From<&Confusion> for Scores {
    fn from(confusion: &Confusion) -> Self {
        Self {
            accuracy: confusion.accuracy(Void::Wrong).unwrap_or_default(),
            miou: confusion.miou(Void::Wrong).unwrap_or_default(),
        }
    }
}

/// Room `i` of `seed`, labels as class indices.
pub fn room(seed: u64, i: u64, points: usize) -> LabelledCloud {
    let rooms = PRETRAINING_SEEDS.end - PRETRAINING_SEEDS.start;
    let made = labelled_points(
        PRETRAINING_SEEDS.start + (seed.wrapping_mul(ROOMS_PER_SEED) + i) % rooms,
        points,
    );
    let lookup = classes().lookup();
    LabelledCloud {
        positions: made.positions,
        labels: made
            .classes
            .iter()
            .map(|&c| lookup[usize::from(c)])
            .collect(),
    }
}
