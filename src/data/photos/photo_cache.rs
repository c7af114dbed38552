//! Decoded photos of a scene, up to a number of bytes.

use crate::error::Result;
use image::RgbImage;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A photo gives way to another when it was not asked for during this many rounds of all photos.
///
/// Photos are asked for in rounds, each in another order. At half of them kept, least recently used order would find one
/// in six of those asked for, and none where the order stays; keeping what is in use finds half.
const ROUNDS: u64 = 2;

/// Decoded photos of a scene, shared by its views. Holds no more than its budget; photos that callers hold besides are
/// their own. Training does not depend on what is in it.
#[derive(Debug)]
pub struct PhotoCache {
    budget: usize,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    kept: HashMap<usize, Kept>,
    bytes: usize,
    /// Photos that there are.
    photos: usize,
    /// How often any was asked for.
    asked: u64,
}

#[derive(Debug)]
struct Kept {
    pixels: Arc<RgbImage>,
    /// [`State::asked`] when it was asked for last.
    last: u64,
}

impl PhotoCache {
    /// An empty one for `budget` bytes of pixels.
    pub(crate) fn new(budget: usize) -> Self {
        Self {
            budget,
            state: Mutex::default(),
        }
    }

    /// Bytes of pixels that it may hold.
    pub fn budget(&self) -> usize {
        self.budget
    }

    /// Bytes of pixels that it holds.
    pub fn bytes(&self) -> usize {
        self.state().bytes
    }

    /// Photos that it holds.
    pub fn len(&self) -> usize {
        self.state().kept.len()
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A new photo, kept where there is room; its number.
    pub(crate) fn admit(&self, pixels: RgbImage) -> usize {
        let mut state = self.state();
        let number = state.photos;
        state.photos += 1;
        state.keep(number, Arc::new(pixels), self.budget);
        number
    }

    /// Photo `number`, made by `decode` where it is not held. Other photos can be asked for meanwhile.
    pub(crate) fn get(
        &self,
        number: usize,
        decode: impl FnOnce() -> Result<RgbImage>,
    ) -> Result<Arc<RgbImage>> {
        if let Some(pixels) = self.state().ask(number) {
            return Ok(pixels);
        }
        let pixels = Arc::new(decode()?);
        Ok(self.state().keep(number, pixels, self.budget))
    }

    /// Nothing in it is half done when a thread panics.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn ask(&mut self, number: usize) -> Option<Arc<RgbImage>> {
        self.asked += 1;
        let kept = self.kept.get_mut(&number)?;
        kept.last = self.asked;
        Some(kept.pixels.clone())
    }

    /// Keeps a photo if those out of use leave room for it. The one to go on with, where two threads made the same.
    fn keep(&mut self, number: usize, pixels: Arc<RgbImage>, budget: usize) -> Arc<RgbImage> {
        if let Some(kept) = self.kept.get(&number) {
            return kept.pixels.clone();
        }
        let size = pixels.as_raw().len();
        while self.bytes.saturating_add(size) > budget {
            let oldest = self
                .kept
                .iter()
                .map(|(&number, kept)| (kept.last, number))
                .min();
            let idle = |last: u64| self.asked - last > ROUNDS * self.photos as u64;
            let Some((_, oldest)) = oldest.filter(|(last, _)| size <= budget && idle(*last)) else {
                return pixels;
            };
            if let Some(gone) = self.kept.remove(&oldest) {
                self.bytes -= gone.pixels.as_raw().len();
            }
        }
        self.bytes += size;
        self.kept.insert(
            number,
            Kept {
                pixels: pixels.clone(),
                last: self.asked,
            },
        );
        pixels
    }
}
