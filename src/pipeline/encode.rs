//! Encoding of a run: the frozen point encoder over the Gaussians (Eq. 6), joined with their lifted features.

use super::segmentation_inputs::SegmentationInputs;
use super::train_decoder::{DecoderInput, Encoded};
use crate::backend::device::upload;
use crate::config::{Encode, Variant};
use crate::data::Split;
use crate::error::{Result, bail};
use crate::raster::Projected;
use crate::segmentation::encoder::{self, Cloud, Encoding, load_spatial, metres_per_unit};
use crate::segmentation::pyramid::{Pyramid, Standardisation, Switches};
use crate::splat::camera::spread;
use crate::splat::rows_where;

/// Spatial features of the Gaussians, from local to global.
pub struct Encodings {
    /// Where the encoder's weights came from.
    pub weights: String,
    scene: Encoding,
    /// With `spatial.encode = "view"`, in the order of the training views.
    views: Vec<EncodedView>,
}

/// A view's visible Gaussians, encoded alone.
struct EncodedView {
    visible: Vec<u32>,
    /// Summed alpha' T of each.
    weights: Vec<f32>,
    encoding: Encoding,
}

/// Encodes the Gaussians of `inputs` at the scales that the decoder reads.
///
/// # Errors
/// Those of the encoder's weights and of [`encoder::encode`].
pub fn encode(inputs: &SegmentationInputs) -> Result<Encodings> {
    let spatial = &inputs.config.spatial;
    let gaussians = inputs.gaussians;
    let seed = inputs.config.seed;
    let (encoder, weights) = load_spatial(spatial, seed, inputs.device)?;
    let encoder = encoder.first_blocks(inputs.config.features.scale_count());
    let train = inputs.scene.split(Split::Train).collect::<Vec<_>>();
    let (_, extent) = spread(train.iter().map(|view| view.camera.center));
    let scale = metres_per_unit(spatial.scale, inputs.scene.unit, extent)?;
    let colors: Vec<[f32; 3]> = gaussians.base_colors();
    let encoded = |positions: &[[f32; 3]], colors: &[[f32; 3]]| {
        let cloud = Cloud {
            positions,
            colors: Some(colors),
            up: inputs.scene.up,
            scale,
        };
        encoder::encode(&encoder, &cloud, seed, inputs.device)
    };
    let mut views = Vec::new();
    if spatial.encode == Encode::View {
        for view in inputs.scene.labelled() {
            let projected = Projected::new(&gaussians.splats(), &view.camera, &inputs.settings)?;
            let sums = projected.weight_sums();
            let visible = rows_where(projected.radii(), |radius| *radius > 0);
            let of_visible = |values: &[[f32; 3]]| -> Vec<[f32; 3]> {
                visible.iter().map(|&i| values[i as usize]).collect()
            };
            views.push(EncodedView {
                encoding: encoded(&of_visible(&gaussians.means), &of_visible(&colors))?,
                weights: visible.iter().map(|&i| sums[i as usize]).collect(),
                visible,
            });
        }
    }
    Ok(Encodings {
        weights,
        scene: encoded(&gaussians.means, &colors)?,
        views,
    })
}

impl Encodings {
    /// The input of the decoder of `variant`: spatial features joined with the lifted ones, where the variant reads them.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for a variant that reads image features where none were lifted.
    pub fn decoder_input(
        &self,
        variant: Variant,
        inputs: &SegmentationInputs,
    ) -> Result<DecoderInput> {
        let switches = Switches {
            image: variant != Variant::NoImageFeatures,
            spatial: variant != Variant::NoSpatial,
            scales: inputs.config.features.scale_count(),
        };
        let all: Vec<u32> = (0..inputs.gaussians.len() as u32).collect();
        let mut scene = join(&self.scene, all, switches, inputs)?;
        let of_view =
            |view: &EncodedView| join(&view.encoding, view.visible.clone(), switches, inputs);
        let views = self.views.iter().map(of_view);
        let mut views = views.collect::<Result<Vec<Encoded>>>()?;
        if inputs.config.segmentation.standardise {
            let scales = Standardisation::of(&scene.pyramid);
            for encoded in views.iter_mut().chain([&mut scene]) {
                scales.apply(&mut encoded.pyramid);
            }
        }
        Ok(match inputs.config.spatial.encode {
            Encode::Scene => DecoderInput::Scene(scene),
            Encode::View => DecoderInput::Views {
                views,
                weights: self.views.iter().map(|v| v.weights.clone()).collect(),
                scene,
            },
        })
    }
}

/// Joins an encoding of the Gaussians `points` with their lifted features.
fn join(
    encoding: &Encoding,
    points: Vec<u32>,
    switches: Switches,
    inputs: &SegmentationInputs,
) -> Result<Encoded> {
    let image = |scale: usize, rows: &[u32]| {
        let Some(features) = &inputs.lifted else {
            bail!(argument "image features"; found "none";
                expected "those of every Gaussian";
                help "unproject image features first, or leave them off");
        };
        let points: Vec<u32> = rows.iter().map(|&row| points[row as usize]).collect();
        let values = features.rows(scale, &points);
        let size = [rows.len(), features.dimensions];
        Ok(upload(values, size, inputs.device))
    };
    Ok(Encoded {
        pyramid: Pyramid::new(encoding, switches, image)?,
        points,
    })
}
