//! The built-in scene: a procedurally furnished room, ray-cast, with exact labels and depth, simulated raw labels and
//! an initial cloud. It shares no code with the rasterizer, so it is also an independent check of the conventions.

mod build;
mod cameras;
mod corrupt;
mod furniture;
mod layout;
mod light;
mod noise;
mod paintings;
mod patterns;
mod points;
mod room;
mod shapes;
mod shell;
mod style;

pub use self::cameras::TEST_DISTANCE;
pub use self::corrupt::{Corruption, corrupt};
pub use self::points::{LabelledPoints, PRETRAINING_SEEDS, labelled_points};
pub use self::room::{Room, Truth, render_truth};

use super::{Classes, LabelMap, Scene, Split, View, WorldUnit};
use crate::error::{Result, bail};
use build::class;
use cameras::Shot;
use glam::DVec3;
use rand::Rng;
use room::{RoomStream, stream};
use smart_default::SmartDefault;

/// Seed of the scene that `train` runs on without arguments, the same for everyone and for every `--seed`.
pub const EVALUATED_SEED: u64 = 0x0c05_e600_0000_0003;

const _: () = assert!(
    EVALUATED_SEED >= PRETRAINING_SEEDS.end,
    "the evaluated room must not be pretrained on"
);

/// The ten classes. Carpets count as floor, curtains as window, and small things as the piece they stand on.
pub fn classes() -> Classes {
    let names = [
        (class::WALL, "wall"),
        (class::FLOOR, "floor"),
        (class::CEILING, "ceiling"),
        (class::WINDOW, "window"),
        (class::PICTURE, "picture"),
        (class::TABLE, "table"),
        (class::CHAIR, "chair"),
        (class::SOFA, "sofa"),
        (class::CABINET, "cabinet"),
        (class::LAMP, "lamp"),
    ];
    Classes::from_names(0, names)
}

/// What [`scene_with`] makes.
#[derive(Clone, Debug, PartialEq, SmartDefault)]
pub struct BuiltinOptions {
    /// Seed of room, cameras, points and raw labels.
    #[default(EVALUATED_SEED)]
    pub seed: u64,
    /// Image width, pixels.
    #[default(320)]
    pub width: usize,
    /// Image height, pixels.
    #[default(240)]
    pub height: usize,
    /// Number of training views.
    #[default(48)]
    pub train_views: usize,
    /// Number of test views.
    #[default(12)]
    pub test_views: usize,
    /// Number of initial points (fewer in tiny scenes, where 8 cm cells run out).
    #[default(12_000)]
    pub points: usize,
    /// How raw labels are corrupted.
    pub corruption: Corruption,
}

/// The built-in scene of a seed at its full size: 48 training and 12 test views of 320x240. [`EVALUATED_SEED`] gives
/// the one that is scored. Takes a few seconds on 2 cores; the same bytes at any thread count.
pub fn scene(seed: u64) -> Scene {
    assemble(&BuiltinOptions {
        seed,
        ..Default::default()
    })
}

/// A built-in scene of any size.
///
/// # Errors
/// [`crate::Error::Argument`] when there are no training views or a side of the image is 0 or above 8192 pixels.
pub fn scene_with(options: &BuiltinOptions) -> Result<Scene> {
    let out_of_range = [
        ("builtin.width", options.width, 1..=8192),
        ("builtin.height", options.height, 1..=8192),
        ("builtin.train_views", options.train_views, 1..=100_000),
        ("builtin.test_views", options.test_views, 0..=100_000),
    ]
    .into_iter()
    .find(|(_, value, range)| !range.contains(value));
    if let Some((key, value, range)) = out_of_range {
        bail!(argument "{key}"; found "{value}";
            expected "{} to {}", range.start(), range.end(); help "change the option");
    }
    Ok(assemble(options))
}

fn assemble(options: &BuiltinOptions) -> Scene {
    let seed = options.seed;
    let room = Room::of_scene(seed);
    let size = (options.width, options.height);
    let shots = cameras::shots(&room, size, options.train_views, options.test_views, seed);
    let truths: Vec<Truth> = shots
        .iter()
        .map(|shot| render_truth(&room, &shot.camera))
        .collect();
    let train = shots
        .iter()
        .zip(&truths)
        .filter(|(shot, _)| shot.split == Split::Train);
    let train: Vec<_> = train.map(|(shot, truth)| (&shot.camera, truth)).collect();
    let points = points::initial_points(&room, &train, options.points, seed);
    let raw = raw_labels(&shots, &truths, options);
    let mut counts = [0; 2];
    let views = shots
        .into_iter()
        .zip(truths)
        .zip(raw)
        .map(|((shot, truth), raw)| {
            let count = &mut counts[usize::from(shot.split == Split::Test)];
            let name = format!("{}_{count:03}", shot.split);
            *count += 1;
            view(name, shot, truth, raw)
        });
    Scene {
        name: "builtin".to_owned(),
        views: views.collect(),
        classes: classes(),
        points,
        drawn: false,
        origin: DVec3::ZERO,
        up: DVec3::Z,
        unit: WorldUnit::Metre,
    }
}

/// The simulated raw labels of each shot. Errors run along the walk, with each test view among the training views near it.
fn raw_labels(shots: &[Shot], truths: &[Truth], options: &BuiltinOptions) -> Vec<LabelMap> {
    let mut order: Vec<usize> = (0..shots.len()).collect();
    order.sort_by(|&i, &j| shots[i].along.total_cmp(&shots[j].along).then(i.cmp(&j)));
    let labels: Vec<_> = order.iter().map(|&i| truths[i].labels.clone()).collect();
    let instances: Vec<_> = order.iter().map(|&i| &truths[i].instances[..]).collect();
    let seed = stream(options.seed, RoomStream::RawLabels).random();
    let raw = corrupt(&labels, &instances, &options.corruption, seed);
    let mut raw: Vec<(usize, LabelMap)> = order.into_iter().zip(raw).collect();
    raw.sort_by_key(|(i, _)| *i);
    raw.into_iter().map(|(_, raw)| raw).collect()
}

fn view(name: String, shot: Shot, truth: Truth, raw: LabelMap) -> View {
    let LabelMap { width, height, .. } = truth.labels;
    let instances = LabelMap {
        width,
        height,
        ids: truth.instances,
    };
    View {
        name,
        split: shot.split,
        camera: shot.camera,
        image: truth.image.into(),
        mask: None,
        truth: Some(truth.labels.into()),
        raw: Some(raw.into()),
        scores: None,
        segments: Vec::new(),
        corrected: None,
        instances: Some(instances.into()),
    }
}
