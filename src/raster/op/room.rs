//! Tile lists with room taken beforehand, so that nobody waits for a GPU to count them.

use crate::backend::device::read;
use crate::error::Result;
use burn::tensor::Tensor;

/// How large the tile lists of a view came out, where it was rendered: `[non-finite rows, entries without room, entries]` on a
/// GPU; nothing on the host, whose kernels have looked at both.
#[derive(Clone, Debug)]
pub struct ListSummary(Option<Tensor<1>>);

impl ListSummary {
    /// `summary` is empty where the host's kernels rendered.
    pub(super) fn new(summary: Tensor<1>) -> Self {
        let summary = if summary.device().is_autodiff() {
            summary.inner()
        } else {
            summary
        };
        Self((summary.dims() == [FIELDS]).then_some(summary))
    }

    /// What it says, `None` on the host; from a GPU this waits for the device and copies.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when a device fails.
    pub fn read(&self) -> Result<Option<ListCount>> {
        match self.as_tensor() {
            Some(summary) => Ok(ListCount::from_values(&read("tile lists", summary)?)),
            None => Ok(None),
        }
    }

    /// The summary as it lies on the GPU, without autodiff: to be read together with something else.
    pub fn as_tensor(&self) -> Option<Tensor<1>> {
        self.0.clone()
    }
}

/// Floats of a summary.
const FIELDS: usize = 3;

/// What a [`ListSummary`] says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ListCount {
    /// Entries of the tile lists; exact up to 2^24, and within 1e-7 of it beyond.
    pub entries: usize,
    /// Whether image and gradients are what they should be: every entry found room, and every input was finite.
    pub is_sound: bool,
}

impl ListCount {
    /// From the values of [`ListSummary::as_tensor`]; `None` for any other number of values.
    pub fn from_values(values: &[f32]) -> Option<Self> {
        let &[non_finite, without_room, entries] = values else {
            return None;
        };
        Some(Self {
            entries: entries as usize,
            is_sound: non_finite == 0.0 && without_room == 0.0,
        })
    }
}

/// Growth that is taken for granted between a view and the next time it, or one near it, is rendered: a fifth, and so many
/// entries more.
const GROWTH: usize = 5;
const MORE: usize = 4096;

/// Room for a view whose tile lists had `entries` entries when it, or one near it, was rendered last: what it will hardly exceed.
pub fn room_for(entries: usize) -> usize {
    entries
        .saturating_add(entries / GROWTH)
        .saturating_add(MORE)
}
