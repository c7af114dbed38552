//! How many tile entries each view had last, and what it may have now.

use crate::raster::tile_capacity;

/// Entries of every view's tile lists when it was last rendered, and the Gaussians there were.
#[derive(Clone, Debug)]
pub(crate) struct Rooms(Vec<Option<[usize; 2]>>);

impl Rooms {
    /// Nothing known of `views` views.
    pub fn new(views: usize) -> Self {
        Self(vec![None; views])
    }

    /// Room that `view` will hardly exceed with `gaussians`; nothing where it was not rendered yet.
    pub fn room(&self, view: usize, gaussians: usize) -> Option<usize> {
        let [entries, before] = (*self.0.get(view)?)?;
        let expected =
            (entries as u128 * gaussians.max(before) as u128 / before.max(1) as u128) as usize;
        Some(tile_capacity(expected))
    }

    /// Keeps that `view` had `entries` with `gaussians`.
    pub fn keep(&mut self, view: usize, entries: usize, gaussians: usize) {
        if let Some(last) = self.0.get_mut(view) {
            *last = Some([entries, gaussians]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_grows_with_the_scene_and_is_never_less_than_there_was() {
        let mut rooms = Rooms::new(2);
        assert_eq!(rooms.room(0, 100), None, "nothing known");
        rooms.keep(0, 1_000, 100);
        assert_eq!(rooms.room(0, 100), Some(tile_capacity(1_000)));
        assert_eq!(rooms.room(0, 300), Some(tile_capacity(3_000)));
        assert_eq!(
            rooms.room(0, 50),
            Some(tile_capacity(1_000)),
            "pruned ones may have been nowhere to be seen"
        );
        assert_eq!((rooms.room(1, 100), rooms.room(2, 100)), (None, None));
        rooms.keep(2, 7, 7);
        rooms.keep(1, 0, 0);
        assert_eq!(
            rooms.room(1, 9),
            Some(tile_capacity(0)),
            "no Gaussian before"
        );
    }
}
