//! Random streams that need no stored state: each is a function of (seed, purpose, index).
//!
//! A resumed run derives the stream of iteration `k` again and so draws the same numbers as an uninterrupted one.

use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What a stream is for; different purposes never share numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Initial points of scenes that have none, index 0; which points of a cloud that is too large are kept, index 1.
    InitialPoints = 1,
    /// Order of the training views; index = epoch.
    ViewOrder = 2,
    /// Positions of split Gaussians; index = iteration.
    Densification = 3,
    /// Order of the views in stage two; index = epoch.
    SegmentationViews = 4,
    /// Pixels of a step of stage two; index = iteration.
    Pixels = 5,
    /// Samples of the 3D regularisation; index = 4 iteration + scale.
    Regularisation = 6,
    /// Initial parameters of rivals; index 0.
    RivalParameters = 11,
    /// Cells that a PCA is fitted on; index = 4 * training view + scale.
    PcaCells = 32,
    /// Colours behind the scene; index = iteration.
    Background = 9,
    /// Training photos that keep their raw labels; index 0.
    LabelledPhotos = 10,
    /// Pixels at which features are scored; index = number of the held-out view.
    ScoredPixels = 12,
    /// Signs that the Gaussians are measured with; index = iteration.
    Pruning = 13,
    /// Scenes and maps that benchmarks make up; index = size.
    Benchmark = 48,
}

/// The stream of `purpose` at `index` (an epoch or iteration, below 2^56) under `seed`.
pub fn stream(seed: u64, purpose: Purpose, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream((purpose as u64) << 56 | index & ((1 << 56) - 1));
    rng
}

/// The one of `all` that `iteration` (from 0) takes: a fresh shuffle every epoch; 0 if there is none.
pub(crate) fn in_epochs(
    mut all: Vec<usize>,
    seed: u64,
    purpose: Purpose,
    iteration: usize,
) -> usize {
    let count = all.len().max(1);
    all.shuffle(&mut stream(seed, purpose, (iteration / count) as u64));
    all.get(iteration % count).copied().unwrap_or(0)
}

/// A standard normal number (Box-Muller). Two uniform numbers a draw, so that the position of the stream does not depend on the
/// values.
pub(crate) fn standard_normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// `count` numbers, uniform in +-`bound`.
pub(crate) fn uniform(count: usize, bound: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    (0..count)
        .map(|_| bound * rng.random_range(-1.0_f32..1.0))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngCore;

    #[test]
    fn streams_repeat_and_differ() {
        let draw = |seed, purpose, index| stream(seed, purpose, index).next_u64();
        assert_eq!(
            draw(1, Purpose::ViewOrder, 2),
            draw(1, Purpose::ViewOrder, 2)
        );
        assert_ne!(
            draw(1, Purpose::ViewOrder, 2),
            draw(1, Purpose::ViewOrder, 3)
        );
        assert_ne!(
            draw(1, Purpose::ViewOrder, 2),
            draw(1, Purpose::Densification, 2)
        );
        assert_ne!(
            draw(1, Purpose::ViewOrder, 2),
            draw(2, Purpose::ViewOrder, 2)
        );
    }
}
