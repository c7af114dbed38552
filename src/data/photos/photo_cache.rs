//! How many decoded photos of a scene stay in memory.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Room for decoded photos of a scene, shared by its views. The photos that are loaded first stay in memory; once the room is
/// taken, the others are decoded again at each use. No result depends on which ones stay.
#[derive(Debug)]
pub struct PhotoCache {
    budget: usize,
    bytes: AtomicUsize,
}

impl PhotoCache {
    /// Room for `budget` bytes of pixels.
    pub(crate) fn new(budget: usize) -> Self {
        Self {
            budget,
            bytes: AtomicUsize::new(0),
        }
    }

    /// Bytes of pixels that it may hold.
    pub fn budget(&self) -> usize {
        self.budget
    }

    /// Bytes of pixels that it holds.
    pub fn bytes(&self) -> usize {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Takes room for `bytes`, where there is so much.
    pub(crate) fn admits(&self, bytes: usize) -> bool {
        let more = |held: usize| held.checked_add(bytes).filter(|held| *held <= self.budget);
        let taken = self
            .bytes
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, more);
        taken.is_ok()
    }
}
