//! The multi-scale input of the decoder: point sets from fine to coarse with frozen features, and the maps between them.

use super::encoder::Encoding;
use crate::error::{Error, Result};
use crate::ops::{RowList, SparseMatrix, gather_rows};
use burn::tensor::Tensor;
use std::sync::Arc;

/// Which features the decoder reads: the switches of the ablation table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Switches {
    /// Image features f_d,n.
    pub image: bool,
    /// Spatial features f_s,n and f_e.
    pub spatial: bool,
    /// All scales, or level 1 alone with the image features of the scale given (0 is scale 1).
    pub single_scale: Option<usize>,
}

impl Default for Switches {
    fn default() -> Self {
        Self {
            image: true,
            spatial: true,
            single_scale: None,
        }
    }
}

/// Frozen inputs of one scale n = 1..4 (Eq. 7), on `N_n` points, without autodiff.
#[derive(Clone, Debug)]
pub struct Level {
    /// Scene index of each point, `[N_n]`.
    pub points: Arc<Vec<u32>>,
    /// Features side by side, `[N_n, D + S_n]`: unprojected image features of those very points, f_d,n, then spatial
    /// features before their sampling, f_s,n; either is left out where it is off.
    pub features: Tensor<2>,
    /// Interpolation onto these points from the next coarser set, `[N_n, N_(n+1)]`.
    pub upsample: Arc<SparseMatrix>,
}

/// Levels from fine to coarse, and the encoder's last sampled set below them.
#[derive(Clone, Debug)]
pub struct Pyramid {
    /// Scales 1 to 4, or scale 1 alone; level 1 holds every point of the set that was encoded.
    pub levels: Vec<Level>,
    /// f_e, features of the set below the last level; no channels where nothing is read from there.
    pub top: Tensor<2>,
}

impl Pyramid {
    /// Puts an encoding and the unprojected features together. `image[n]` is f_d of scale n + 1 for the whole encoded
    /// cloud, `[N, D]`; each level reads the rows of its own points.
    ///
    /// # Errors
    /// [`Error::Argument`] when all features are off, or image features are on and missing or of another length.
    pub fn new(encoding: &Encoding, image: &[Tensor<2>], switches: Switches) -> Result<Self> {
        let points = encoding.levels[0].indices.len();
        Self::gathered(encoding, switches, |scale, rows| match image.get(scale) {
            Some(features) if features.dims()[0] == points => {
                Ok(select(features, &Arc::new(rows.to_vec().into())))
            }
            other => {
                let (key, found) = (
                    format!("image features of scale {}", scale + 1),
                    other.map(Tensor::dims),
                );
                let help = "unproject them first";
                Err(Error::argument(
                    key,
                    format!("{found:?}"),
                    format!("{points} rows"),
                    help,
                ))
            }
        })
    }

    /// [`Pyramid::new`] with image features that are gathered where they are needed: `image(n, rows)` is f_d of scale n + 1
    /// for the rows `rows` of the encoded cloud, `[rows, D]`. Nothing is asked for that no level reads.
    ///
    /// # Errors
    /// [`Error::Argument`] when all features are off; those of `image`.
    pub fn gathered(
        encoding: &Encoding,
        switches: Switches,
        image: impl Fn(usize, &[u32]) -> Result<Tensor<2>>,
    ) -> Result<Self> {
        if !switches.image && !switches.spatial {
            let help = "leave image or spatial features on";
            return Err(Error::argument(
                "decoder inputs",
                "none",
                "image features, spatial features or both",
                help,
            ));
        }
        let device = encoding.coarsest.features.device();
        let count = if switches.single_scale.is_some() {
            1
        } else {
            encoding.levels.len()
        };
        let mut levels = Vec::with_capacity(count);
        for (n, level) in encoding.levels.iter().take(count).enumerate() {
            let scale = switches.single_scale.unwrap_or(n);
            let lifted = if switches.image {
                Some(image(scale, &level.indices)?)
            } else {
                None
            };
            let spatial = switches.spatial.then(|| level.features.clone());
            let parts: Vec<_> = [lifted, spatial]
                .into_iter()
                .flatten()
                .filter(|f| f.dims()[1] > 0)
                .collect();
            levels.push(Level {
                points: Arc::new(level.indices.clone()),
                features: match parts.is_empty() {
                    true => Tensor::zeros([level.indices.len(), 0], &device),
                    false => Tensor::cat(parts, 1),
                },
                upsample: encoding.upsample[n].clone(),
            });
        }
        let top = match switches.spatial && switches.single_scale.is_none() {
            true => encoding.coarsest.features.clone(),
            false => Tensor::zeros([encoding.upsample[count - 1].columns, 0], &device),
        };
        Ok(Self { levels, top })
    }
}

/// Variant numbers of a level.
pub type Rows = Arc<RowList>;

/// The rows of a [`Pyramid`] that some of its finest points depend on; cheap to keep per view.
#[derive(Clone, Debug)]
pub struct Restriction {
    levels: Vec<(Option<Rows>, Arc<SparseMatrix>)>,
    top: Option<Rows>,
}

impl Restriction {
    /// Follows the interpolation maps down from `finest`, rows of level 1.
    ///
    /// # Panics
    /// If a row is not one of level 1.
    pub fn new(pyramid: &Pyramid, finest: Rows) -> Self {
        Self::of_levels(pyramid, [finest])
    }

    /// What points of several levels depend on, and those points: `wanted` holds rows of level 1, of level 2 and so on. Levels
    /// that it does not reach add nothing of their own.
    ///
    /// # Panics
    /// If a row is not one of its level.
    pub fn of_levels(pyramid: &Pyramid, wanted: impl IntoIterator<Item = Rows>) -> Self {
        let mut wanted = wanted.into_iter();
        let mut rows = wanted.next().unwrap_or_default();
        let mut levels = Vec::with_capacity(pyramid.levels.len());
        for level in &pyramid.levels {
            let used = level.upsample.select_rows(&rows);
            let (upsample, below) = match wanted.next().filter(|more| !more.is_empty()) {
                None => {
                    let used = used.compact();
                    (used.matrix, used.columns)
                }
                Some(more) => {
                    let mut below = [&used.indices[..], &more].concat();
                    below.sort_unstable();
                    below.dedup();
                    (used.over_columns(&below), below)
                }
            };
            levels.push((Some(rows), Arc::new(upsample)));
            rows = Arc::new(below.into());
        }
        Self {
            levels,
            top: Some(rows),
        }
    }

    /// All of `pyramid`.
    pub fn none(pyramid: &Pyramid) -> Self {
        Self {
            levels: pyramid
                .levels
                .iter()
                .map(|level| (None, level.upsample.clone()))
                .collect(),
            top: None,
        }
    }

    /// Rows of the pyramid's level `scale` (0 = finest) that are kept; `None`: all.
    pub fn rows(&self, scale: usize) -> Option<&Rows> {
        self.levels[scale].0.as_ref()
    }

    /// Interpolation onto the kept rows of level `scale` from those of the next coarser set.
    pub fn upsample(&self, scale: usize) -> &Arc<SparseMatrix> {
        &self.levels[scale].1
    }

    /// The kept rows of `top`, the features below the last level.
    pub fn of_top(&self, top: &Tensor<2>) -> Tensor<2> {
        match &self.top {
            None => top.clone(),
            Some(rows) => select(top, rows),
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let rows = self
            .levels
            .iter()
            .map(|level| &level.0)
            .chain([&self.top])
            .flatten();
        4 * rows.map(|r| r.len()).sum::<usize>()
            + self
                .levels
                .iter()
                .map(|level| level.1.bytes())
                .sum::<usize>()
    }
}

fn select(features: &Tensor<2>, rows: &Rows) -> Tensor<2> {
    match features.dims()[1] {
        // Some backends refuse to index nothing.
        0 => Tensor::zeros([rows.len(), 0], &features.device()),
        _ => gather_rows(features.clone(), rows),
    }
}

/// Per-channel mean and spread of a pyramid's frozen features.
///
/// Image features are unit vectors and spatial ones grow with depth; brought to one scale, the decoder learns in far
/// fewer steps. The paper says nothing of it; `standardise = false` leaves the features as they are.
#[derive(Clone, Debug)]
pub struct Standardisation {
    levels: Vec<ChannelScale>,
    top: ChannelScale,
}

/// `[1, C]` mean and reciprocal spread; 0 for channels that do not vary.
#[derive(Clone, Debug)]
struct ChannelScale {
    mean: Tensor<2>,
    factor: Tensor<2>,
}

/// Spreads below this share of the channel's root mean square count as none.
const FLAT: f32 = 1e-5;

impl ChannelScale {
    fn of(features: &Tensor<2>) -> Option<Self> {
        let [rows, channels] = features.dims();
        if rows == 0 || channels == 0 {
            return None;
        }
        let mean = features.clone().mean_dim(0);
        let square = features.clone().powi_scalar(2).mean_dim(0);
        let spread = (features.clone() - mean.clone())
            .powi_scalar(2)
            .mean_dim(0)
            .sqrt();
        let varies = spread.clone().greater(square.sqrt() * FLAT).float();
        let factor = varies / spread.clamp_min(f32::MIN_POSITIVE);
        Some(Self { mean, factor })
    }

    fn or_none(features: &Tensor<2>) -> Self {
        let empty = || Tensor::zeros([1, features.dims()[1]], &features.device());
        Self::of(features).unwrap_or_else(|| Self {
            mean: empty(),
            factor: empty(),
        })
    }

    /// In place where nobody else holds `features`.
    fn apply(&self, features: Tensor<2>) -> Tensor<2> {
        match features.shape().num_elements() {
            0 => features,
            _ => (features - self.mean.clone()) * self.factor.clone(),
        }
    }
}

impl Standardisation {
    /// Statistics of `pyramid`.
    pub fn of(pyramid: &Pyramid) -> Self {
        let levels = pyramid
            .levels
            .iter()
            .map(|l| ChannelScale::or_none(&l.features))
            .collect();
        Self {
            levels,
            top: ChannelScale::or_none(&pyramid.top),
        }
    }

    /// The pyramid with every channel brought to mean 0 and spread 1 by these statistics.
    #[must_use]
    pub fn apply(&self, pyramid: Pyramid) -> Pyramid {
        let levels = pyramid.levels.into_iter().zip(&self.levels);
        let levels = levels.map(|(level, scale)| Level {
            features: scale.apply(level.features),
            ..level
        });
        Pyramid {
            levels: levels.collect(),
            top: self.top.apply(pyramid.top),
        }
    }
}
