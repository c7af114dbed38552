//! The decoder's frozen input: of the scene, and of the Gaussians that a training view shows.

use super::DecoderPlan;
use crate::error::{Result, bail};
use crate::ops::SparseMatrix;
use crate::random::{Purpose, stream};
use crate::segmentation::loss::{NeighbourPairs, neighbour_divergence};
use crate::segmentation::neighbours::without_self;
use crate::segmentation::pyramid::{Dependencies, Pyramid};
use burn::tensor::Tensor;
use std::ops::Range;
use std::sync::Arc;

/// Scales of the 3D regularisation (n = 3, 4), zero-based.
pub(super) const REGULARISED: Range<usize> = 2..4;

/// A set of Gaussians with the decoder's frozen inputs.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// Frozen inputs of all scales; level 1 holds every point of the set.
    pub pyramid: Pyramid,
    /// Scene index of each point of the set, ascending.
    pub points: Vec<u32>,
}

/// The decoder's frozen input.
pub enum DecoderInput {
    /// The whole scene, encoded once; each view uses the part it sees.
    Scene(Encoded),
    /// The visible Gaussians of each training view, encoded alone (the paper), and the whole scene for Gaussians that no
    /// view sees.
    Views {
        /// In the order of the training views.
        views: Vec<Encoded>,
        /// Summed alpha' T of each view's points, for the weighted mean of identities.
        weights: Vec<Vec<f32>>,
        /// The whole scene.
        scene: Encoded,
    },
}

impl DecoderInput {
    /// The encoding of the whole scene.
    pub fn scene(&self) -> &Encoded {
        match self {
            Self::Scene(scene) | Self::Views { scene, .. } => scene,
        }
    }

    /// The encoding that training view `view` uses.
    pub fn view(&self, view: usize) -> &Encoded {
        match self {
            Self::Scene(scene) => scene,
            Self::Views { views, .. } => &views[view],
        }
    }
}

/// What the Gaussians that a view shows depend on.
#[derive(Clone, Debug)]
pub(super) struct ViewInput {
    /// The visible Gaussians in order, in parts that are decoded at once.
    pub parts: Vec<Part>,
    /// The points of the regularised scales that all parts together depend on.
    clouds: Vec<Cloud>,
}

/// Gaussians that are decoded together.
#[derive(Clone, Debug)]
pub(super) struct Part {
    /// Their positions among the visible Gaussians.
    pub places: Range<usize>,
    /// Selects them from the scene.
    pub gaussians: Arc<SparseMatrix>,
    /// The rows of the pyramid that they depend on.
    pub rows: Dependencies,
}

/// Points of a regularised scale.
#[derive(Clone, Debug)]
struct Cloud {
    /// Rows of the pyramid's level, ascending.
    rows: Vec<u32>,
    /// The K nearest others of each point, `[N_n, K]`, as positions in `rows`.
    neighbours: Vec<u32>,
}

impl ViewInput {
    /// The input for the Gaussians `visible` of `encoded`, in parts of `plan.config.decoder_chunk`. `means` are the centres of
    /// all Gaussians of the scene.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] naming a centre; [`crate::Error::Argument`] for a Gaussian that was not encoded.
    pub fn new(
        encoded: &Encoded,
        visible: &[u32],
        means: &[[f32; 3]],
        plan: &DecoderPlan,
    ) -> Result<Self> {
        let row = |g: &u32| match encoded.points.binary_search(g) {
            Ok(row) => Ok(row as u32),
            Err(_) => {
                bail!(argument "visible Gaussians"; found "Gaussian {g}"; expected "Gaussians that were encoded";
                help "set spatial.encode = \"scene\"")
            }
        };
        let rows = visible.iter().map(row).collect::<Result<Vec<u32>>>()?;
        let count = rows.len().max(1);
        let parts = match plan.config.decoder_chunk {
            0 => 1,
            chunk => count.div_ceil(chunk),
        };
        // Parts of one size instead of a small one at the end.
        let size = count.div_ceil(parts);
        let part = |first: usize| {
            let places = first..(first + size).min(rows.len());
            let gaussians = visible[places.clone()].to_vec();
            Part {
                rows: Dependencies::new(&encoded.pyramid, rows[places.clone()].to_vec()),
                gaussians: Arc::new(SparseMatrix::selection(gaussians, means.len())),
                places,
            }
        };
        let parts: Vec<Part> = (0..count).step_by(size).map(part).collect();
        let clouds = if plan.regularised && encoded.pyramid.levels.len() >= REGULARISED.end {
            let neighbours = plan.config.reg_neighbours;
            let cloud = |scale| Cloud::new(encoded, &parts, scale, means, neighbours);
            REGULARISED.map(cloud).collect::<Result<_>>()?
        } else {
            Vec::new()
        };
        Ok(Self { parts, clouds })
    }

    /// Rows of the regularised scales and of what they depend on; none without regularisation.
    pub fn coarse_rows(&self, pyramid: &Pyramid) -> Option<Dependencies> {
        let coarse = self.clouds.iter().map(|cloud| cloud.rows.clone());
        let finer = std::iter::repeat_n(Vec::new(), REGULARISED.start);
        (!self.clouds.is_empty()).then(|| Dependencies::of_levels(pyramid, finer.chain(coarse)))
    }

    /// Eq. 9 over a sample of the points of the regularised scales. `fused` are the fused features of all their points, the
    /// last scales of a decoding. None without points that have neighbours.
    pub fn regularisation(
        &self,
        fused: &[Tensor<2>],
        plan: &DecoderPlan,
        iteration: usize,
    ) -> Option<Tensor<1>> {
        let coarse = fused.iter().rev().take(self.clouds.len()).rev();
        let terms = self.clouds.iter().zip(REGULARISED).zip(coarse);
        let terms = terms.filter_map(|((cloud, scale), fused)| {
            let pairs = cloud.sample(plan, scale, iteration)?;
            Some(neighbour_divergence(fused.clone(), &pairs))
        });
        terms.reduce(|sum, term| sum + term)
    }
}

impl Cloud {
    fn new(
        encoded: &Encoded,
        parts: &[Part],
        scale: usize,
        means: &[[f32; 3]],
        neighbours: usize,
    ) -> Result<Self> {
        let rows = parts.iter().flat_map(|part| part.rows.rows(scale));
        let mut rows: Vec<u32> = rows.copied().collect();
        rows.sort_unstable();
        rows.dedup();
        let points = &encoded.pyramid.levels[scale].points;
        let centre = |&r: &u32| means[encoded.points[points[r as usize] as usize] as usize];
        let centres: Vec<[f32; 3]> = rows.iter().map(centre).collect();
        let neighbours = without_self(&centres, neighbours)?;
        Ok(Self { rows, neighbours })
    }

    /// The sampled points of `iteration` at `scale` with their neighbours, as positions in [`Cloud::rows`].
    fn sample(&self, plan: &DecoderPlan, scale: usize, iteration: usize) -> Option<NeighbourPairs> {
        let points = self.rows.len();
        let k = plan.config.reg_neighbours;
        if points < 2 {
            return None;
        }
        let index = (iteration * 4 + scale) as u64;
        let mut rng = stream(plan.seed, Purpose::Regularisation, index);
        let count = plan.config.reg_samples.min(points);
        let chosen = rand::seq::index::sample(&mut rng, points, count);
        let chosen = chosen.iter().map(|i| i as u32).collect();
        Some(NeighbourPairs::new(chosen, &self.neighbours, k))
    }
}
