//! The multi-scale input of the decoder: point sets from fine to coarse with frozen features, and the maps between them.

use super::encoder::Encoding;
use super::linear::fill_blocks;
use crate::config::SCALES;
use crate::error::{Result, ensure};
use crate::ops::{SparseMatrix, selected};
use burn::tensor::Tensor;
use smart_default::SmartDefault;
use std::sync::Arc;

/// Which features the decoder reads: the switches of the ablation table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, SmartDefault)]
pub struct Switches {
    /// Image features f_d,n.
    #[default(true)]
    pub image: bool,
    /// Spatial features f_s,n and f_e.
    #[default(true)]
    pub spatial: bool,
    /// Scales that are read, finest first. What lies below the last one is read where all are.
    #[default(SCALES)]
    pub scales: usize,
}

/// Frozen inputs of one scale n = 1..4 (Eq. 7), on `N_n` points, without autodiff.
#[derive(Clone, Debug)]
pub struct Level {
    /// Row of each point in the cloud that was encoded, `[N_n]`.
    pub points: Arc<Vec<u32>>,
    /// Features side by side, `[N_n, D + S_n]`: the unprojected image features f_d,n of the points, then their spatial features
    /// f_s,n. A part that is switched off is left out.
    pub features: Tensor<2>,
    /// Interpolation onto these points from the next coarser set, `[N_n, N_(n+1)]`.
    pub upsample: Arc<SparseMatrix>,
}

/// Levels from fine to coarse, and the encoder's last sampled set below them.
#[derive(Clone, Debug)]
pub struct Pyramid {
    /// Scale 1 and the next ones, up to four; level 1 holds every point of the set that was encoded.
    pub levels: Vec<Level>,
    /// f_e, features of the set below the last level; no channels where nothing is read from there.
    pub top: Tensor<2>,
}

impl Pyramid {
    /// Joins an encoding, of the scales that are read or more, with unprojected features: `image(n, rows)` is f_d of scale n + 1 for the
    /// rows `rows` of the encoded cloud, `[rows, D]`. It is called only for scales that are read.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] when all features are off; those of `image`.
    pub fn new(
        encoding: &Encoding,
        switches: Switches,
        image: impl Fn(usize, &[u32]) -> Result<Tensor<2>>,
    ) -> Result<Self> {
        ensure!(switches.image || switches.spatial, argument "decoder inputs"; found "none";
            expected "image features, spatial features or both"; help "leave image or spatial features on");
        let device = encoding.coarsest.features.device();
        let count = switches.scales.clamp(1, encoding.levels.len());
        let mut levels = Vec::with_capacity(count);
        for (n, level) in encoding.levels.iter().take(count).enumerate() {
            let lifted = switches.image.then(|| image(n, &level.indices));
            let spatial = switches.spatial.then(|| level.features.clone());
            let parts: Vec<_> = [lifted.transpose()?, spatial]
                .into_iter()
                .flatten()
                .filter(|f| f.dims()[1] > 0)
                .collect();
            levels.push(Level {
                points: Arc::new(level.indices.clone()),
                features: if parts.is_empty() {
                    Tensor::zeros([level.indices.len(), 0], &device)
                } else {
                    Tensor::cat(parts, 1)
                },
                upsample: encoding.upsample[n].clone(),
            });
        }
        let top = if switches.spatial && count == SCALES {
            encoding.coarsest.features.clone()
        } else {
            Tensor::zeros([encoding.upsample[count - 1].columns, 0], &device)
        };
        Ok(Self { levels, top })
    }

    /// The part that holds `rows` alone.
    #[must_use]
    pub fn part(&self, rows: &Dependencies) -> Self {
        let levels = self.levels.iter().zip(&rows.levels);
        let levels = levels.map(|(level, part)| Level {
            points: part.points.clone(),
            features: selected(&level.features, &part.selection),
            upsample: part.upsample.clone(),
        });
        Self {
            levels: levels.collect(),
            top: selected(&self.top, &rows.top),
        }
    }

    /// Features of the levels, then of the set below them.
    fn features(&self) -> impl Iterator<Item = &Tensor<2>> {
        let levels = self.levels.iter().map(|level| &level.features);
        levels.chain([&self.top])
    }
}

/// The rows of a [`Pyramid`] that some of its points depend on. The last row of a level may be repeated: products run
/// in blocks of rows.
#[derive(Clone, Debug)]
pub struct Dependencies {
    levels: Vec<LevelPart>,
    /// Selects rows of the set below the last level.
    top: Arc<SparseMatrix>,
}

/// Some rows of a [`Level`].
#[derive(Clone, Debug)]
struct LevelPart {
    selection: Arc<SparseMatrix>,
    /// Row of each in the cloud that was encoded.
    points: Arc<Vec<u32>>,
    /// Interpolation onto them from the rows of the next coarser set.
    upsample: Arc<SparseMatrix>,
}

impl Dependencies {
    /// Follows the interpolation maps down from `finest`, rows of level 1.
    ///
    /// # Panics
    /// If a row is not one of level 1.
    pub fn new(pyramid: &Pyramid, finest: Vec<u32>) -> Self {
        Self::of_levels(pyramid, [finest])
    }

    /// The rows that points of several levels depend on, with those points. `wanted` holds rows of level 1, of level 2 and
    /// so on.
    ///
    /// # Panics
    /// If a row is not one of its level.
    pub fn of_levels(pyramid: &Pyramid, wanted: impl IntoIterator<Item = Vec<u32>>) -> Self {
        let mut wanted = wanted.into_iter();
        let mut rows = wanted.next().unwrap_or_default();
        fill_blocks(&mut rows);
        let mut levels = Vec::with_capacity(pyramid.levels.len());
        for level in &pyramid.levels {
            let used = level.upsample.select_rows(&rows);
            let mut below = wanted.next().unwrap_or_default();
            below.extend_from_slice(used.entries().0);
            below.sort_unstable();
            below.dedup();
            fill_blocks(&mut below);
            let points = rows.iter().map(|&r| level.points[r as usize]).collect();
            levels.push(LevelPart {
                points: Arc::new(points),
                selection: Arc::new(SparseMatrix::selection(rows, level.points.len())),
                upsample: Arc::new(used.over_columns(&below)),
            });
            rows = below;
        }
        let top = SparseMatrix::selection(rows, pyramid.top.dims()[0]);
        Self {
            levels,
            top: Arc::new(top),
        }
    }

    /// Rows of level `scale` (0 is the finest).
    pub fn rows(&self, scale: usize) -> &[u32] {
        self.levels[scale].selection.entries().0
    }
}

/// Per-channel mean and spread of a pyramid's frozen features.
///
/// Image features are unit vectors, and spatial features grow with depth. When they are brought to one scale, the decoder learns
/// in far fewer steps. The paper does not mention this; `standardise = false` leaves the features as they are.
#[derive(Clone, Debug)]
pub struct Standardisation {
    /// `[1, C]` mean and reciprocal spread of each level, then of the set below them; `None` if there are no features. The
    /// reciprocal is 0 for channels that do not vary.
    channels: Vec<Option<[Tensor<2>; 2]>>,
}

/// Spreads below this share of the channel's root mean square count as none.
const MIN_SPREAD: f32 = 1e-5;

impl Standardisation {
    /// Statistics of `pyramid`.
    pub fn of(pyramid: &Pyramid) -> Self {
        let channels = pyramid.features().map(mean_and_factor).collect();
        Self { channels }
    }

    /// Brings every channel of `pyramid` to mean 0 and spread 1 by these statistics.
    pub fn apply(&self, pyramid: &mut Pyramid) {
        let levels = pyramid.levels.iter_mut().map(|level| &mut level.features);
        let features = levels.chain([&mut pyramid.top]);
        for (features, channels) in features.zip(&self.channels) {
            if let Some([mean, factor]) = channels
                && features.shape().num_elements() > 0
            {
                *features = (features.clone() - mean.clone()) * factor.clone();
            }
        }
    }
}

/// Mean and reciprocal spread of each channel, if there are values.
fn mean_and_factor(features: &Tensor<2>) -> Option<[Tensor<2>; 2]> {
    if features.shape().num_elements() == 0 {
        return None;
    }
    let mean = features.clone().mean_dim(0);
    let square = features.clone().powi_scalar(2).mean_dim(0);
    let spread = (features.clone() - mean.clone())
        .powi_scalar(2)
        .mean_dim(0)
        .sqrt();
    let varies = spread.clone().greater(square.sqrt() * MIN_SPREAD).float();
    let factor = varies / spread.clamp_min(f32::MIN_POSITIVE);
    Some([mean, factor])
}
