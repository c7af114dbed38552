//! Capacity of the tile lists, from the entries that each view had last.

use crate::raster::tile_capacity;

/// The tile lists of a view when it was last rendered.
#[derive(Clone, Copy, Debug)]
struct Last {
    entries: usize,
    gaussians: usize,
}

/// What the tile lists of each view had last.
#[derive(Clone, Debug)]
pub(crate) struct Capacities(Vec<Option<Last>>);

impl Capacities {
    /// Nothing known of `views` views.
    pub fn new(views: usize) -> Self {
        Self(vec![None; views])
    }

    /// Capacity that `view` hardly exceeds with `gaussians`; `None` where it was not rendered yet.
    pub fn of(&self, view: usize, gaussians: usize) -> Option<usize> {
        let last = (*self.0.get(view)?)?;
        // Fewer Gaussians may have as many entries: those that were pruned may have been out of view.
        let growth = gaussians.max(last.gaussians) as f64 / last.gaussians.max(1) as f64;
        Some(tile_capacity((last.entries as f64 * growth) as usize))
    }

    /// Records that `view` had `entries` with `gaussians`.
    pub fn record(&mut self, view: usize, entries: usize, gaussians: usize) {
        if let Some(last) = self.0.get_mut(view) {
            *last = Some(Last { entries, gaussians });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capacity_grows_with_the_scene_and_never_shrinks() {
        let mut capacities = Capacities::new(2);
        assert_eq!(capacities.of(0, 100), None, "nothing known");
        capacities.record(0, 1_000, 100);
        assert_eq!(capacities.of(0, 100), Some(tile_capacity(1_000)));
        assert_eq!(capacities.of(0, 300), Some(tile_capacity(3_000)));
        assert_eq!(
            capacities.of(0, 50),
            Some(tile_capacity(1_000)),
            "pruned ones may have been nowhere to be seen"
        );
        assert_eq!((capacities.of(1, 100), capacities.of(2, 100)), (None, None));
        capacities.record(2, 7, 7);
        capacities.record(1, 0, 0);
        assert_eq!(
            capacities.of(1, 9),
            Some(tile_capacity(0)),
            "no Gaussian before"
        );
    }
}
