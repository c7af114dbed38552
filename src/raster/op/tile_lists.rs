//! The size of the tile lists of a view, and the capacity to allocate for them.

/// How large the tile lists of a view came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ListCount {
    /// Entries of the tile lists; exact up to 2^24, and within 1e-7 of it beyond.
    pub entries: usize,
    /// Whether image and gradients are valid: the capacity sufficed and every input was finite.
    pub is_sound: bool,
}

impl ListCount {
    /// From the values of [`RasterOutput::tile_lists`](super::RasterOutput::tile_lists): non-finite rows, entries beyond the
    /// capacity, and entries. `None` for any other number of values.
    pub fn from_values(values: &[f32]) -> Option<Self> {
        let &[non_finite, beyond_capacity, entries] = values else {
            return None;
        };
        Some(Self {
            entries: entries as usize,
            is_sound: non_finite == 0.0 && beyond_capacity == 0.0,
        })
    }
}

/// The capacity that a view hardly exceeds whose tile lists had `entries` entries when it, or one near it, was last rendered:
/// a fifth more, and 4096.
pub fn tile_capacity(entries: usize) -> usize {
    entries.saturating_add(entries / 5).saturating_add(4096)
}
