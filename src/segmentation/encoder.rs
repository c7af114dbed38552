//! The frozen spatial encoder of a run: which weights, and a cloud of Gaussian centres turned into features (Eq. 6).

use super::randla::{POSITION_CHANNELS, RandlaEncoder, block_name};
use super::sampling::{Hierarchy, LAYERS};
use crate::backend::check_finite;
use crate::backend::device::{read, upload};
use crate::config::{SpatialConfig, SpatialScale, SpatialSource};
use crate::data::WorldUnit;
use crate::error::{Result, ensure, invalid};
use crate::files::sha256;
use crate::ops::SparseMatrix;
use crate::random::uniform;
use crate::splat::median;
use crate::weights::{HostTensor, WeightFile};
use burn::tensor::{Device, Tensor};
use glam::{DQuat, DVec3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};
use std::sync::Arc;

/// Radius of a camera path that is assumed when nothing says how large a scene is, metres.
const ASSUMED_EXTENT: f64 = 2.0;
/// Stem width and block widths of encoders made here; a block's features are twice as wide.
const WIDTHS: [usize; 1 + LAYERS] = [8, 16, 32, 64, 128];
/// The weights inside this crate.
const BUILTIN: &[u8] = include_bytes!("../../assets/randla_builtin.safetensors");

/// Points to encode.
#[derive(Clone, Copy, Debug)]
pub struct Cloud<'a> {
    /// `[N, 3]`, world units, any origin.
    pub positions: &'a [[f32; 3]],
    /// `[N, 3]` sRGB in 0..1; read only by encoders with six inputs.
    pub colors: Option<&'a [[f32; 3]]>,
    /// World direction that points up; any length but zero.
    pub up: DVec3,
    /// Metres per world unit.
    pub scale: f64,
}

impl Cloud<'_> {
    /// Positions in metres, z up, the median at the origin.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] naming the first bad row; [`crate::Error::Config`] for an unusable scale;
    /// [`crate::Error::Argument`] for an up direction of no length.
    pub fn oriented(&self) -> Result<Vec<[f32; 3]>> {
        check_finite("positions to encode", self.positions.as_flattened(), 3)?;
        ensure!(self.scale.is_finite() && self.scale > 0.0, setting "spatial.scale"; found "{}", self.scale;
            expected "a finite number above 0"; help "give metres per world unit");
        let up = self.up.try_normalize().ok_or_else(|| {
            invalid!(argument "up"; found "{}", self.up; expected "a finite direction";
                help "give the direction that points up")
        })?;
        let turn = DQuat::from_rotation_arc(up, DVec3::Z);
        let turned: Vec<DVec3> = self
            .positions
            .iter()
            .map(|p| turn * DVec3::from(p.map(f64::from)) * self.scale)
            .collect();
        let centre = DVec3::from([0, 1, 2].map(|axis| median(turned.iter().map(|p| p[axis]))));
        Ok(turned
            .iter()
            .map(|p| (*p - centre).as_vec3().to_array())
            .collect())
    }
}

/// A point set of an [`Encoding`].
#[derive(Clone, Debug)]
pub struct EncodedLevel {
    /// `[N_n]` rows of the encoded cloud; level 1 holds them all, in order.
    pub indices: Vec<u32>,
    /// `f_s,n` before its sampling, `[N_n, S_n]`; without autodiff.
    pub features: Tensor<2>,
}

/// Spatial features of a cloud from local to global (Eq. 6).
#[derive(Clone, Debug)]
pub struct Encoding {
    /// Levels from 1 on, one for each block of the encoder, `N / 4^(n-1)` points.
    pub levels: Vec<EncodedLevel>,
    /// The last sampled set and its features `f_e`.
    pub coarsest: EncodedLevel,
    /// Interpolation onto each level n from level n + 1, and from the coarsest set onto the last.
    pub upsample: Vec<Arc<SparseMatrix>>,
}

/// Encodes a cloud, to as many levels as `encoder` has blocks; `seed` decides the random sampling.
///
/// Memory beyond the result is bounded: a few 2 MB tensors a thread, and 17 indices a point.
///
/// # Errors
/// [`crate::Error::Argument`] for an empty cloud, missing or miscounted colours; those of [`Cloud::oriented`]; [`crate::Error::NonFinite`]
/// naming the first bad row of the input, or of the features when the weights overflow.
pub fn encode(
    encoder: &RandlaEncoder,
    cloud: &Cloud,
    seed: u64,
    device: &Device,
) -> Result<Encoding> {
    ensure!(!cloud.positions.is_empty(), argument "positions to encode"; found "none"; expected "at least one point";
        help "encode a scene with Gaussians");
    let positions = cloud.oriented()?;
    let hierarchy = Hierarchy::build(&positions, encoder.widths().len(), seed)?;
    let device = device.clone().inner();
    let input = encoder_input(encoder.inputs(), &positions, cloud.colors, &device)?;
    let (features, coarsest) = encoder.encode_levels(input, &hierarchy, true);
    for (n, f) in features.iter().chain([&coarsest]).enumerate() {
        let what = format!("spatial features of level {}", n + 1);
        check_finite(&what, &read(&what, f.clone())?, f.dims()[1])?;
    }
    let upsample = hierarchy.upsampling()?;
    let level = |(indices, features)| EncodedLevel { indices, features };
    let indices = hierarchy.levels.into_iter().map(|level| level.indices);
    Ok(Encoding {
        levels: indices.zip(features).map(level).collect(),
        coarsest: level((hierarchy.coarsest_indices, coarsest)),
        upsample,
    })
}

/// `[N, 3]` positions, or `[N, 6]` with colours, for an encoder of `inputs` channels.
pub(crate) fn encoder_input(
    inputs: usize,
    positions: &[[f32; 3]],
    colors: Option<&[[f32; 3]]>,
    device: &Device,
) -> Result<Tensor<2>> {
    let points = positions.len();
    if inputs == 3 {
        let values = positions.as_flattened().to_vec();
        return Ok(upload(values, [points, 3], device));
    }
    match colors {
        Some(colors) if colors.len() == points => {
            check_finite("colours to encode", colors.as_flattened(), 3)?;
            let values = positions
                .iter()
                .zip(colors)
                .flat_map(|(p, c)| p.iter().chain(c))
                .copied()
                .collect();
            Ok(upload(values, [points, 6], device))
        }
        other => Err(invalid!(argument "colours to encode";
            found "{}", other.map_or("none".into(), |c| format!("{} rows", c.len()));
            expected "{points} rows: these weights read xyz and rgb";
            help "give the cloud's colours, or weights that read xyz only")),
    }
}

/// Metres per world unit by the setting. An estimate assumes that the extent of the cameras (the largest distance of one from their
/// mean, world units) is two metres. For 0 this is `extent`. For `"auto"` it is the extent of the whole scene where the unit is
/// arbitrary; all other units count as metres.
///
/// # Errors
/// [`crate::Error::Config`] for 0 without a usable extent.
pub fn metres_per_unit(scale: SpatialScale, unit: WorldUnit, extent: f64) -> Result<f64> {
    let is_usable = |extent: f64| extent.is_finite() && extent > 0.0;
    match (scale, unit) {
        (SpatialScale::Auto, WorldUnit::Arbitrary { extent }) if is_usable(extent) => {
            Ok(ASSUMED_EXTENT / extent)
        }
        (SpatialScale::Auto, _) => Ok(1.0),
        (SpatialScale::Metres(metres), _) if metres > 0.0 => Ok(metres),
        (SpatialScale::Metres(_), _) => {
            ensure!(is_usable(extent), setting "spatial.scale"; found "0, and cameras within {extent} units";
                expected "cameras at several places"; help "give the metres of a world unit: the cameras do not tell how large the scene is");
            Ok(ASSUMED_EXTENT / extent)
        }
    }
}

/// The encoder that the settings ask for, frozen, and how a run names it: `pretrained FILE`, `trained here`, `random`.
///
/// # Errors
/// [`crate::Error::Io`], [`crate::Error::Input`] when a checkpoint cannot be read or does not fit.
pub fn load_spatial(
    config: &SpatialConfig,
    seed: u64,
    device: &Device,
) -> Result<(RandlaEncoder, String)> {
    let (weights, name) = match &config.source {
        SpatialSource::Builtin => (builtin_weights()?, "trained here".to_owned()),
        SpatialSource::Random => (random_weights(3, seed), "random".to_owned()),
        SpatialSource::Pretrained(path) => {
            let weights =
                WeightFile::open(path)?.of_network("RandLA-Net (keys `dilated_res_blocks.*`)");
            (weights, format!("pretrained {}", path.display()))
        }
    };
    let encoder = RandlaEncoder::load(&weights, &device.clone().inner())?;
    Ok((encoder, name))
}

/// SHA-256 of the weights that `config` asks for; `None` for random weights, which the seed determines.
///
/// # Errors
/// [`crate::Error::Io`] when their file cannot be read.
pub(crate) fn spatial_digest(config: &SpatialConfig) -> Result<Option<String>> {
    match &config.source {
        SpatialSource::Builtin => Ok(Some(format!("{:x}", Sha256::digest(BUILTIN)))),
        SpatialSource::Pretrained(path) => sha256(path).map(Some),
        SpatialSource::Random => Ok(None),
    }
}

/// The weights inside this crate; `assets/README.md` holds the command that made them and its scores.
///
/// # Errors
/// [`crate::Error::Input`] when the build embedded a broken file.
pub fn builtin_weights() -> Result<WeightFile> {
    WeightFile::from_safetensors(BUILTIN, "built-in RandLA weights")
}

/// Untrained weights (He-uniform, running statistics 0 and 1) in the layout of the published checkpoints: where
/// pretraining starts, and the ablation row `random`. `inputs` is 3 or 6.
pub fn random_weights(inputs: usize, seed: u64) -> WeightFile {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut weights = WeightFile {
        origin: "random RandLA weights".into(),
        ..WeightFile::default()
    };
    add_random_mlp(&mut weights, "fc0", [inputs, WIDTHS[0]], &mut rng);
    let mut input = WIDTHS[0];
    for (n, &d) in WIDTHS[1..].iter().enumerate() {
        for (part, shape) in [
            ("mlp1", [input, d / 2]),
            ("lfa.mlp1", [POSITION_CHANNELS, d / 2]),
            ("lfa.att_pooling_1.mlp", [d, d / 2]),
            ("lfa.mlp2", [d / 2, d / 2]),
            ("lfa.att_pooling_2.mlp", [d, d]),
            ("mlp2", [d, 2 * d]),
            ("shortcut", [input, 2 * d]),
        ] {
            add_random_mlp(&mut weights, &block_name(n, part), shape, &mut rng);
        }
        for stage in ["lfa.att_pooling_1.fc.weight", "lfa.att_pooling_2.fc.weight"] {
            add_random_matrix(&mut weights, &block_name(n, stage), [d, d], &mut rng);
        }
        input = 2 * d;
    }
    weights
}

/// Adds a shared MLP's `conv.weight` and `bn.bn.*` under `name`.
fn add_random_mlp(weights: &mut WeightFile, name: &str, shape: [usize; 2], rng: &mut ChaCha8Rng) {
    add_random_matrix(weights, &format!("{name}.conv.weight"), shape, rng);
    let statistics = [
        ("weight", 1.0),
        ("bias", 0.0),
        ("running_mean", 0.0),
        ("running_var", 1.0),
    ];
    for (part, value) in statistics {
        let values = vec![value; shape[1]];
        let shape = vec![shape[1]];
        weights.insert(
            &format!("{name}.bn.bn.{part}"),
            HostTensor { shape, values },
        );
    }
}

/// Adds a matrix `[out, in]`, uniform as He et al. 2015 choose it.
fn add_random_matrix(
    weights: &mut WeightFile,
    name: &str,
    [input, output]: [usize; 2],
    rng: &mut ChaCha8Rng,
) {
    let bound = (6.0 / input.max(1) as f64).sqrt() as f32;
    let shape = vec![output, input];
    let values = uniform(input * output, bound, rng);
    weights.insert(name, HostTensor { shape, values });
}
