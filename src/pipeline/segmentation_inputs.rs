//! The frozen inputs of stage two: image features lifted onto the Gaussians, spatial features, and their pyramids.

use super::train_decoder::{Encoded, Source, TrainingViews};
use crate::config::{Config, Encode, SpatialConfig, SpatialSource, Variant};
use crate::data::{Scene, Split};
use crate::error::{Error, Result};
use crate::features::{Reduction, SCALES};
use crate::objects::Semantics;
use crate::progress::{Progress, Viewing};
use crate::raster::{Projected, Settings};
use crate::segmentation::encoder::{Cloud, Encoding, encode, load_spatial, metres_per_unit};
use crate::segmentation::pyramid::{Pyramid, Standardisation, Switches};
use crate::segmentation::unprojection::unproject_each;
use crate::splat::Gaussians;
use burn::tensor::{Device, Tensor, TensorData};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

/// Scale (zero-based) whose image features the single-scale row reads.
const SINGLE_SCALE: usize = 0;

/// Image features lifted onto the Gaussians that were seen often enough.
pub struct Seen {
    /// Rows of the Gaussians that attendance pruning keeps, ascending.
    pub kept: Vec<u32>,
    /// Lifted features of the kept Gaussians per scale, `[N, D]`.
    pub lifted: [Vec<f32>; SCALES],
    /// D.
    pub dimensions: usize,
    /// Where the features came from.
    pub name: String,
    /// What they depend on besides photos and Gaussians, see [`Reduction::content`].
    pub content: String,
    /// Seconds of extraction and of unprojection.
    pub seconds: [f64; 2],
}

impl Seen {
    /// Extracts and unprojects features of the training views, a few views at a time. None where `progress` says stop in
    /// between: nothing of them is kept.
    ///
    /// # Errors
    /// Those of the extractor and of the unprojection.
    pub fn new(
        scene: &Scene,
        gaussians: &Gaussians,
        config: &Config,
        settings: &Settings,
        device: &Device,
        progress: &mut dyn Progress,
    ) -> Result<Option<Self>> {
        let (clock, views) = (Instant::now(), scene.split(Split::Train).count());
        let mut viewing = Viewing::begin(progress, "features", views);
        let reduction = Reduction::fit(scene, &config.features, config.seed, device, &mut || {
            viewing.looked(1)
        })?;
        let ControlFlow::Continue(mut reduction) = reduction else {
            return Ok(None);
        };
        viewing.end();
        if progress.stop() {
            return Ok(None);
        }
        let (name, content) = (reduction.name.clone(), reduction.content.clone());
        let mut extraction = clock.elapsed();
        let clock = Instant::now();
        let mut viewing = Viewing::begin(progress, "unprojection", views);
        let mut maps = reduction.training_views();
        let mut reducing = Duration::ZERO;
        let maps = std::iter::from_fn(|| {
            let clock = Instant::now();
            let next = maps.next();
            reducing += clock.elapsed();
            next
        });
        let (train, looked) = (scene.split(Split::Train), &mut || viewing.looked(1));
        let lifted = unproject_each(
            gaussians,
            train,
            maps,
            &config.unprojection,
            settings,
            device,
            looked,
        )?;
        let ControlFlow::Continue(lifted) = lifted else {
            return Ok(None);
        };
        extraction += reducing;
        let unprojection = clock.elapsed().saturating_sub(reducing);
        viewing.end();
        let kept: Vec<u32> = (0..gaussians.len() as u32)
            .filter(|&i| lifted.keep[i as usize])
            .collect();
        let dimensions = config.features.dimensions;
        let mut rows = lifted.features;
        rows.iter_mut()
            .for_each(|rows| keep_rows(rows, &kept, dimensions));
        let seconds = [extraction, unprojection].map(|time| time.as_secs_f64());
        Ok(Some(Self {
            lifted: rows,
            kept,
            dimensions,
            name,
            content,
            seconds,
        }))
    }
}

/// Leaves the rows `kept` (ascending) of `values`, `[N, width]`: the features of a large scene take a gigabyte, and are not
/// copied.
fn keep_rows(values: &mut Vec<f32>, kept: &[u32], width: usize) {
    for (to, &from) in kept.iter().enumerate() {
        let from = from as usize * width;
        values.copy_within(from..from + width, to * width);
    }
    values.truncate(kept.len() * width);
}

/// Everything stage two reads.
pub struct Inputs<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its Gaussians, after attendance pruning.
    pub gaussians: &'a Gaussians,
    /// Lifted image features; absent where nothing reads them.
    pub seen: Option<Seen>,
    /// What the classes of objects are scored against, where classes are objects that association found.
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

/// What a row's decoder is shown, and whether the encoder is a random one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Flavour {
    switches: Switches,
    random: bool,
}

impl Flavour {
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

/// Encodings of the scene, made at the first row that needs them and shared by the others.
#[derive(Default)]
pub struct Spatial {
    /// Where the weights came from; empty until an encoder was needed.
    pub name: String,
    encodings: Option<(bool, Encodings)>,
    source: Option<(Flavour, Source)>,
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
    /// The decoder's input for `row`.
    ///
    /// # Errors
    /// Those of the encoder's weights and of the encoding.
    pub fn source(&mut self, row: Variant, inputs: &Inputs) -> Result<&Source> {
        let flavour = Flavour::of(row);
        let made = match self.source.take() {
            Some((of, source)) if of == flavour => source,
            _ => self.make(flavour, inputs)?,
        };
        Ok(&self.source.insert((flavour, made)).1)
    }

    fn make(&mut self, flavour: Flavour, inputs: &Inputs) -> Result<Source> {
        let encodings = match self.encodings.take() {
            Some((random, encodings)) if random == flavour.random => encodings,
            _ => self.encode(flavour.random, inputs)?,
        };
        let all: Vec<u32> = (0..inputs.gaussians.len() as u32).collect();
        let scene = join(&encodings.scene, all, flavour, inputs)?;
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
            Encode::Scene => Source::Scene(scaled(scene)),
            Encode::View => {
                let view = |v: &EncodedView| {
                    Ok(scaled(join(
                        &v.encoding,
                        v.visible.clone(),
                        flavour,
                        inputs,
                    )?))
                };
                Source::Views {
                    views: encodings.views.iter().map(view).collect::<Result<_>>()?,
                    weights: encodings.views.iter().map(|v| v.weights.clone()).collect(),
                    scene: scaled(scene),
                }
            }
        };
        self.encodings = Some((flavour.random, encodings));
        Ok(source)
    }

    fn encode(&mut self, random: bool, inputs: &Inputs) -> Result<Encodings> {
        let Config { seed, spatial, .. } = inputs.config;
        let spatial = match random {
            true => SpatialConfig {
                source: SpatialSource::Random,
                ..spatial.clone()
            },
            false => spatial.clone(),
        };
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
    flavour: Flavour,
    inputs: &Inputs,
) -> Result<Encoded> {
    let image = |scale: usize, rows: &[u32]| {
        let Some(seen) = &inputs.seen else {
            let help = "unproject image features first, or leave them off";
            return Err(Error::argument(
                "image features",
                "none",
                "those of every Gaussian",
                help,
            ));
        };
        let (lifted, d) = (&seen.lifted[scale], seen.dimensions);
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
        pyramid: Pyramid::gathered(encoding, flavour.switches, image)?,
        points,
    })
}

#[cfg(test)]
mod tests {
    use super::keep_rows;

    #[test]
    fn kept_rows_stay_in_order() {
        let all: Vec<f32> = (0..12).map(|v| v as f32).collect();
        for (kept, want) in [
            (vec![0, 1, 2, 3], all.clone()),
            (vec![1, 3], vec![3.0, 4.0, 5.0, 9.0, 10.0, 11.0]),
            (vec![], vec![]),
        ] {
            let mut rows = all.clone();
            keep_rows(&mut rows, &kept, 3);
            assert_eq!(rows, want, "{kept:?}");
        }
    }
}
