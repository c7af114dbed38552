//! The decoder's step in parts: the gradients of the step at once, whatever the size of the parts.

use crate::support::joined_pyramid;
use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::{Tensor, TensorData};
use coseg::config::{Blend, SegmentationConfig, SpatialConfig, SpatialSource};
use coseg::ops::SparseMatrix;
use coseg::pipeline::train_decoder::{
    Adam, DecoderInput, DecoderModel, DecoderPlan, Encoded, IdentityModel, ViewSample,
};
use coseg::segmentation::decoder::{Decoder, DecoderConfig};
use coseg::segmentation::encoder::{Cloud, encode, load_spatial};
use coseg::segmentation::loss::{CoSegLoss, LabelLoss};
use coseg::segmentation::pixels::{LabelledPixels, NO_CLASS, PixelWeights};
use coseg::segmentation::pyramid::{Dependencies, Switches};
use glam::DVec3;
use std::sync::Arc;

/// The third scale has more than the 256 points of a block.
const POINTS: usize = 4_500;
const CLASSES: usize = 5;
const PIXELS: usize = 700;

struct Scene {
    means: Vec<[f32; 3]>,
    source: DecoderInput,
    drawn: ViewSample,
    blend: Blend,
}

impl Scene {
    /// Of the scales that `switches` leave, in the whole scene's encoding; one view sees six of seven points.
    fn new(switches: Switches, blend: Blend) -> Self {
        let device = crate::support::device();
        let means: Vec<[f32; 3]> = (0..POINTS)
            .map(|i| std::array::from_fn(|a| (i as f32 * [0.37, 0.61, 0.83][a]).sin()))
            .collect();
        let config = SpatialConfig {
            source: SpatialSource::Random,
            ..SpatialConfig::default()
        };
        let (encoder, _) = load_spatial(&config, 5, &device).expect("random weights");
        let cloud = Cloud {
            positions: &means,
            colors: None,
            up: DVec3::Y,
            scale: 1.0,
        };
        let encoding = encode(&encoder, &cloud, 3, &device).expect("finite");
        let image: Vec<Tensor<2>> = (0..4)
            .map(|n| {
                let values = (0..POINTS * 8)
                    .map(|i| (i as f32 * 0.13 + n as f32).cos())
                    .collect();
                Tensor::from_data(TensorData::new::<f32, _>(values, [POINTS, 8]), &device)
            })
            .collect();
        let pyramid = joined_pyramid(&encoding, &image, switches);
        let source = DecoderInput::Scene(Encoded {
            pyramid,
            points: (0..POINTS as u32).collect(),
        });
        let visible: Vec<u32> = (0..POINTS as u32).filter(|i| i % 7 != 2).collect();
        let k = 4;
        let columns = visible.len();
        let weights = SparseMatrix::new(
            columns,
            (0..=PIXELS).map(|r| (r * k) as u32).collect(),
            (0..PIXELS * k)
                .map(|i| ((i * 11 + i / k * 5) % columns) as u32)
                .collect(),
            (0..PIXELS)
                .flat_map(|_| [0.5, 0.25, 0.125, 0.125])
                .collect(),
        );
        let label = |r: usize| {
            if r % 13 == 4 {
                NO_CLASS
            } else {
                (r * 3 / 7 % CLASSES) as u16
            }
        };
        let weights = PixelWeights::Stored(Arc::new(weights));
        let pixels = LabelledPixels::new(weights, (0..PIXELS).map(label).collect());
        Self {
            means,
            source,
            drawn: ViewSample {
                visible: Arc::new(visible),
                pixels,
                numbers: Arc::new((0..PIXELS as u32).collect()),
            },
            blend,
        }
    }
}

/// A model that decodes `chunk` Gaussians together, and the parameters of any of the scene.
fn model<'a>(
    scene: &'a Scene,
    config: &'a SegmentationConfig,
    regularised: bool,
    prior: bool,
) -> (DecoderModel<'a>, Decoder) {
    let plan = DecoderPlan {
        config,
        regularised,
        size: [POINTS, CLASSES],
        seed: 3,
    };
    let device = crate::support::device().autodiff();
    let pyramid = &scene.source.scene().pyramid;
    let decoder = DecoderConfig::for_pyramid(pyramid, CLASSES)
        .with_seed(1)
        .init(&device);
    let mut model = DecoderModel::new(&scene.source, &scene.means, plan);
    if prior {
        let shares = (0..POINTS * CLASSES)
            .map(|i| (i as f32 * 0.71).sin())
            .collect();
        model = model.with_prior(shares, &device);
    }
    (model, decoder)
}

fn config(blend: Blend, chunk: usize) -> SegmentationConfig {
    SegmentationConfig {
        blend,
        decoder_chunk: chunk,
        reg_samples: 20,
        reg_neighbours: 3,
        ..Default::default()
    }
}

/// The loss of the first step, and the gradient of each parameter of the decoder.
fn gradients(
    (mut model, decoder): (DecoderModel, Decoder),
    scene: &Scene,
) -> (f32, Vec<(String, Vec<f32>)>) {
    let (loss, gradient) = step(&mut model, &decoder, scene, 0);
    let mut lengths = Lengths::default();
    decoder.visit(&mut lengths);
    let mut first = 0;
    let named = lengths.found.into_iter().map(|(name, length)| {
        first += length;
        (name, gradient[first - length..first].to_vec())
    });
    let named: Vec<_> = named.collect();
    assert_eq!(first, gradient.len());
    (loss, named)
}

/// Loss and gradient `[P]` of a step.
fn step(
    model: &mut DecoderModel,
    decoder: &Decoder,
    scene: &Scene,
    iteration: usize,
) -> (f32, Vec<f32>) {
    let label = LabelLoss::Js { pi: 0.9 };
    let loss = CoSegLoss {
        lambda: [0.8, 20.0],
        ..label.into()
    };
    let drawn = &scene.drawn;
    let blend = scene.blend;
    let decoded = model
        .decode(decoder, 0, &drawn.visible, iteration)
        .expect("a prediction");
    let scores = drawn
        .blended(decoded.scores.clone(), blend)
        .expect("scores");
    let loss = loss
        .forward(scores, &drawn.pixels, decoded.regularisation.clone())
        .expect("a loss");
    let gradient = model.gradient(decoder, 0, &decoded, &mut loss.backward());
    let gradient = gradient.into_data().into_vec().expect("f32");
    (loss.inner().into_scalar(), gradient)
}

/// Losses and gradients of some steps of gradient descent.
fn trained(
    (mut model, mut decoder): (DecoderModel, Decoder),
    scene: &Scene,
    steps: usize,
) -> Vec<(f32, Vec<f32>)> {
    let mut adam = Adam::new(1e-2, 1, None);
    let step = |iteration| {
        let (loss, gradient) = step(&mut model, &decoder, scene, iteration);
        let device = crate::support::device();
        let values = TensorData::new(gradient.clone(), [gradient.len()]);
        decoder = adam.step(decoder.clone(), Tensor::from_data(values, &device), 1.0);
        (loss, gradient)
    };
    (0..steps).map(step).collect()
}

/// Names and lengths of parameters.
#[derive(Default)]
struct Lengths {
    path: Vec<String>,
    found: Vec<(String, usize)>,
}

impl ModuleVisitor for Lengths {
    fn enter_module(&mut self, name: &str, _container: &str) {
        self.path.push(name.to_owned());
    }
    fn exit_module(&mut self, _name: &str, _container: &str) {
        self.path.pop();
    }
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let length = param.val().shape().num_elements();
        self.found.push((self.path.join("."), length));
    }
}

#[test]
fn parts_of_any_size_give_the_gradients_of_the_step_at_once() {
    let single = Switches {
        scales: 1,
        ..Switches::default()
    };
    for (switches, blend, prior, regularised) in [
        (Switches::default(), Blend::Probabilities, true, true),
        (Switches::default(), Blend::Probabilities, false, false),
        (Switches::default(), Blend::Logits, false, true),
        (
            Switches {
                spatial: false,
                ..Switches::default()
            },
            Blend::Logits,
            false,
            false,
        ),
        (single, Blend::Probabilities, true, true),
    ] {
        let scene = Scene::new(switches, blend);
        let of = |chunk| {
            let config = config(blend, chunk);
            gradients(model(&scene, &config, regularised, prior), &scene)
        };
        let (loss, whole) = of(0);
        assert!(
            whole.len() >= 2 * switches.scales + 2,
            "every parameter has a gradient: {}",
            whole.len()
        );
        let visible = scene.drawn.visible.len();
        for chunk in [64, 300, visible - 1, visible] {
            let (loss_in_parts, parts) = of(chunk);
            let case = format!(
                "{switches:?}, {blend:?}, prior {prior}, Eq. 9 {regularised}, chunks of {chunk}"
            );
            assert!(
                (loss_in_parts - loss).abs() <= 1e-6 * loss.abs(),
                "{case}: loss {loss_in_parts} for {loss}"
            );
            assert_eq!(parts.len(), whole.len(), "{case}");
            for ((name, got), (_, want)) in parts.iter().zip(&whole) {
                let rms = (want.iter().map(|v| v * v).sum::<f32>() / want.len() as f32).sqrt();
                assert!(rms > 0.0, "{case}: {name} is at rest");
                let worst = got
                    .iter()
                    .zip(want)
                    .map(|(a, b)| (a - b).abs())
                    .fold(0.0, f32::max);
                // Parts are added up in f32.
                assert!(
                    worst <= 1e-4 * rms,
                    "{case}: {name} is off by {worst}, rms {rms}"
                );
                assert!(
                    chunk < visible || got == want,
                    "{case}: one part is the step at once"
                );
            }
        }
    }
}

/// A whole step with all custom operations replaced by their plain-tensor references.
#[test]
fn a_step_by_references_has_the_same_loss_and_gradients() {
    for (blend, chunk) in [
        (Blend::Probabilities, 0),
        (Blend::Probabilities, 300),
        (Blend::Logits, 0),
    ] {
        let scene = Scene::new(Switches::default(), blend);
        let config = config(blend, chunk);
        let step = || {
            let model = model(&scene, &config, true, blend == Blend::Probabilities);
            gradients(model, &scene)
        };
        let (loss, found) = step();
        let (reference_loss, references) =
            coseg::ops::with_references(&coseg::ops::CustomOp::ALL, step);
        assert!((loss - reference_loss).abs() <= 1e-6 * loss.abs());
        assert_eq!(found.len(), references.len());
        for ((name, got), (_, want)) in found.iter().zip(&references) {
            let rms = (want.iter().map(|v| v * v).sum::<f32>() / want.len() as f32).sqrt();
            let off = got.iter().zip(want).map(|(a, b)| (a - b).abs());
            let worst = off.fold(0.0, f32::max);
            assert!(worst <= 1e-4 * rms, "{name} is off by {worst}, rms {rms}");
        }
    }
}

#[test]
fn the_regularisation_matters_in_parts_too() {
    let scene = Scene::new(Switches::default(), Blend::Probabilities);
    let config = config(Blend::Probabilities, 200);
    let of = |regularised| gradients(model(&scene, &config, regularised, false), &scene);
    let ((with, a), (without, b)) = (of(true), of(false));
    assert!(with > without + 1e-3, "{with} and {without}");
    assert_ne!(a, b);
}

#[test]
fn parts_have_the_same_bits_at_any_number_of_threads() {
    let scene = Scene::new(Switches::default(), Blend::Probabilities);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        let config = config(Blend::Probabilities, 250);
        pool.install(|| trained(model(&scene, &config, true, true), &scene, 4))
    };
    let (one, two) = (run(1), run(2));
    assert!(one == two);
    let losses: Vec<f32> = one.iter().map(|(loss, _)| *loss).collect();
    assert!(losses[3] < losses[0], "four steps help: {losses:?}");
}

#[test]
fn points_of_coarse_levels_decode_as_in_the_whole() {
    let scene = Scene::new(Switches::default(), Blend::Probabilities);
    let pyramid = &scene.source.scene().pyramid;
    let decoder = DecoderConfig::for_pyramid(pyramid, CLASSES).init(&crate::support::device());
    let whole = decoder.forward(pyramid);
    let wanted = [vec![], vec![], vec![3, 17, 60], vec![0, 9, 20]];
    let kept = Dependencies::of_levels(pyramid, wanted.clone());
    let fused = decoder.fuse(&pyramid.part(&kept), 2);
    assert_eq!(fused.len(), 2);
    for (scale, part) in [2, 3].into_iter().zip(fused) {
        let rows = kept.rows(scale);
        assert!(
            rows.is_sorted() && wanted[scale].iter().all(|row| rows.contains(row)),
            "{rows:?}"
        );
        assert!(
            rows.len() < pyramid.levels[scale].points.len(),
            "not all of scale {scale}"
        );
        let width = part.dims()[1];
        let values = |t: Tensor<2>| t.into_data().into_vec::<f32>().expect("f32");
        let (part, whole) = (values(part), values(whole.fused[scale].clone()));
        for (got, &row) in part.chunks_exact(width).zip(rows.iter()) {
            let want = &whole[row as usize * width..][..width];
            let worst = got
                .iter()
                .zip(want)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f32::max);
            assert!(worst < 1e-5, "row {row} of scale {scale}: {worst}");
        }
    }
}
