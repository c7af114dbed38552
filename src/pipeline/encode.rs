//! Encoding of a run: the frozen point encoder over the Gaussians, joined with their lifted features.

use super::lift::LiftedFeatures;
use super::train_decoder::{DecoderInput, Encoded, TrainingViews};
use crate::config::{Config, Encode, SpatialSource, Variant};
use crate::data::{Scene, Split};
use crate::error::{Error, Result};
use crate::objects::Semantics;
use crate::raster::{Projected, Settings};
use crate::segmentation::encoder::{Cloud, Encoding, encode, load_spatial, metres_per_unit};
use crate::segmentation::pyramid::{Pyramid, Standardisation, Switches};
use crate::splat::Gaussians;
use burn::tensor::{Device, Tensor, TensorData};

/// Scale (zero-based) whose image features the single-scale row reads.
const SINGLE_SCALE: usize = 0;

/// The inputs of stage two.
pub struct Inputs<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its Gaussians, after attendance pruning.
    pub gaussians: &'a Gaussians,
    /// Lifted image features; absent where nothing reads them.
    pub lifted: Option<LiftedFeatures>,
    /// What the classes of objects are scored against, after association.
    pub semantics: Option<&'a Semantics>,
    /// Settings of the run.
    pub config: &'a Config,
    /// Blending constants.
    pub settings: Settings,
    /// Device without autodiff.
    pub device: &'a Device,
}

impl<'a> Inputs<'a> {
    /// The labelled training views, with the coverage and the budget for weights that settings say.
    pub fn training_views(&self) -> TrainingViews<'a> {
        let config = &self.config.segmentation;
        TrainingViews::new(
            self.gaussians,
            self.scene.split(Split::Train),
            &self.scene.classes,
            self.settings,
            config.min_coverage as f32,
            config.weight_cache_mb << 20,
            self.device,
        )
    }
}

/// Which inputs a variant leaves out, and whether its point encoder is random.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ablation {
    switches: Switches,
    random: bool,
}

impl Ablation {
    fn of(row: Variant) -> Self {
        let switches = Switches {
            image: row != Variant::NoImageFeatures,
            spatial: row != Variant::NoSpatial,
            single_scale: (row == Variant::SingleScale).then_some(SINGLE_SCALE),
        };
        Self {
            switches,
            random: row == Variant::RandomSpatial,
        }
    }
}

/// Encodings of the scene, made for the first variant that needs them and shared by the others.
#[derive(Default)]
pub struct Spatial {
    /// Where the weights came from; empty until an encoder was needed.
    pub name: String,
    encodings: Option<(bool, Encodings)>,
    source: Option<(Ablation, DecoderInput)>,
}

struct Encodings {
    scene: Encoding,
    views: Vec<EncodedView>,
}

/// A view's visible Gaussians, encoded alone.
struct EncodedView {
    visible: Vec<u32>,
    weights: Vec<f32>,
    encoding: Encoding,
}

impl Spatial {
    /// The input of the decoder of a variant.
    ///
    /// # Errors
    /// Those of the encoder's weights and of the encoding.
    pub fn source(&mut self, row: Variant, inputs: &Inputs) -> Result<&DecoderInput> {
        let ablation = Ablation::of(row);
        let made = match self.source.take() {
            Some((of, source)) if of == ablation => source,
            _ => self.make(ablation, inputs)?,
        };
        Ok(&self.source.insert((ablation, made)).1)
    }

    fn make(&mut self, ablation: Ablation, inputs: &Inputs) -> Result<DecoderInput> {
        let encodings = match self.encodings.take() {
            Some((random, encodings)) if random == ablation.random => encodings,
            _ => self.encode(ablation.random, inputs)?,
        };
        let all: Vec<u32> = (0..inputs.gaussians.len() as u32).collect();
        let scene = join(&encodings.scene, all, ablation, inputs)?;
        let scales = inputs
            .config
            .segmentation
            .standardise
            .then(|| Standardisation::of(&scene.pyramid));
        let scaled = |encoded: Encoded| match &scales {
            Some(scales) => Encoded {
                pyramid: scales.apply(encoded.pyramid),
                ..encoded
            },
            None => encoded,
        };
        let source = match inputs.config.spatial.encode {
            Encode::Scene => DecoderInput::Scene(scaled(scene)),
            Encode::View => {
                let view = |v: &EncodedView| {
                    Ok(scaled(join(
                        &v.encoding,
                        v.visible.clone(),
                        ablation,
                        inputs,
                    )?))
                };
                DecoderInput::Views {
                    views: encodings.views.iter().map(view).collect::<Result<_>>()?,
                    weights: encodings.views.iter().map(|v| v.weights.clone()).collect(),
                    scene: scaled(scene),
                }
            }
        };
        self.encodings = Some((ablation.random, encodings));
        Ok(source)
    }

    fn encode(&mut self, random: bool, inputs: &Inputs) -> Result<Encodings> {
        let Config { seed, spatial, .. } = inputs.config;
        let mut spatial = spatial.clone();
        if random {
            spatial.source = SpatialSource::Random;
        }
        let (encoder, name) = load_spatial(&spatial, *seed, inputs.device)?;
        if !random || self.name.is_empty() {
            self.name = name;
        }
        let scale = metres_per_unit(&spatial, camera_extent(inputs.scene))?;
        let gaussians = inputs.gaussians;
        let colors: Vec<[f32; 3]> = gaussians.base_colors();
        let one = |positions: &[[f32; 3]], colors: &[[f32; 3]]| {
            let cloud = Cloud {
                positions,
                colors: Some(colors),
                up: inputs.scene.up,
                scale,
            };
            encode(&encoder, &cloud, *seed, inputs.device)
        };
        let scene = one(&gaussians.means, &colors)?;
        let mut views = Vec::new();
        if spatial.encode == Encode::View {
            for view in inputs.scene.split(Split::Train).filter(|v| v.raw.is_some()) {
                let projected =
                    Projected::new(&gaussians.splats(), &view.camera, &inputs.settings)?;
                let sums = projected.weight_sums();
                let visible: Vec<u32> = (0..gaussians.len() as u32)
                    .filter(|&i| projected.radii()[i as usize] > 0)
                    .collect();
                let positions: Vec<_> = visible
                    .iter()
                    .map(|&i| gaussians.means[i as usize])
                    .collect();
                let tints: Vec<_> = visible.iter().map(|&i| colors[i as usize]).collect();
                let weights = visible.iter().map(|&i| sums[i as usize]).collect();
                views.push(EncodedView {
                    encoding: one(&positions, &tints)?,
                    visible,
                    weights,
                });
            }
        }
        Ok(Encodings { scene, views })
    }
}

/// Largest distance of a camera from the mean camera, world units.
fn camera_extent(scene: &Scene) -> f64 {
    let centers: Vec<_> = scene.split(Split::Train).map(|v| v.camera.center).collect();
    let mean = centers.iter().sum::<glam::DVec3>() / centers.len().max(1) as f64;
    centers.iter().map(|c| c.distance(mean)).fold(0.0, f64::max)
}

/// Joins an encoding of the Gaussians `points` with their lifted features.
fn join(
    encoding: &Encoding,
    points: Vec<u32>,
    ablation: Ablation,
    inputs: &Inputs,
) -> Result<Encoded> {
    let image = |scale: usize, rows: &[u32]| {
        let Some(features) = &inputs.lifted else {
            let help = "unproject image features first, or leave them off";
            return Err(Error::argument(
                "image features",
                "none",
                "those of every Gaussian",
                help,
            ));
        };
        let (lifted, d) = (&features.lifted[scale], features.dimensions);
        let mut values = Vec::with_capacity(rows.len() * d);
        for &row in rows {
            values.extend_from_slice(&lifted[points[row as usize] as usize * d..][..d]);
        }
        Ok(Tensor::from_data(
            TensorData::new(values, [rows.len(), d]),
            inputs.device,
        ))
    };
    Ok(Encoded {
        pyramid: Pyramid::gathered(encoding, ablation.switches, image)?,
        points,
    })
}
