//! `coseg eval`: the scores of a run.

use super::run_folder::RunFolder;
use super::terminal;
use clap::Args;
use coseg::config::{Association, Config, Variant};
use coseg::data::{Classes, LabelMap, LabelRuns, Limits, Scene, Split, View};
use coseg::error::{Error, Result};
use coseg::metrics::{
    ImageScores, InstanceScores, SemanticScores, Void, instance_scores, label_scores,
};
use coseg::objects::{Identities, LabelMaps, LabelRule, Semantics, hard_label_map};
use coseg::raster::{Projected, Settings, render};
use coseg::report::{RowScores, TestScores};
use coseg::splat::ply;
use coseg::splat::ply::PlyScene;
use std::collections::BTreeMap;
use std::path::PathBuf;

const HELP: &str = "\
Prints PSNR and SSIM of the run's scene on the held-out views and, where these have true labels, mIoU (all views in
one confusion matrix, and the mean over views), accuracy and the IoU of each class, 0 to 1, of the stored identities. Of
a run with data.association: scores of its objects against true instances, and, where they have classes, against true
labels, an object counting as its class. --json has the names of metrics.json.

Examples:
  coseg eval runs/living
  coseg eval runs/living --data elsewhere/living --json";

/// Arguments of `coseg eval`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct EvalArgs {
    /// Folder that `coseg train` wrote
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Scene folder, where it has moved or another one is meant [default: the run's own]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What the held-out views show.
struct Found<'s> {
    images: BTreeMap<String, ImageScores>,
    /// Of the views that have truth.
    labels: Vec<(&'s View, LabelRuns)>,
}

/// What labels are rendered from.
enum Stored {
    Identities(Identities),
    Labels(Vec<u16>),
}

impl EvalArgs {
    /// Scores the run.
    pub fn run(self) -> Result<()> {
        let run = RunFolder::existing(&self.run)?;
        let mut config = run.config(&[])?;
        if let Some(dir) = &self.data {
            config.data.dir = Some(dir.clone());
        }
        let ply = ply::read(&run.scene_path(), &Limits::default())?;
        let scene = coseg::pipeline::load_scene(&config)?.with_origin(ply.origin);
        let stored = stored(&run, &ply)?;
        let classes = run.classes()?;
        let named = |classes: &Classes| {
            classes
                .entries
                .iter()
                .map(|c| (c.id, c.name.clone()))
                .collect::<Vec<_>>()
        };
        let associated = config.data.association != Association::None;
        if !associated
            && ![&scene.classes, &classes].iter().any(|c| c.is_empty())
            && named(&scene.classes) != named(&classes)
        {
            let found = format!("{} classes, not those of the run", scene.classes.len());
            let help = "give the scene that was trained on, or one with the same classes.json";
            return Err(Error::argument(
                "--data",
                found,
                format!("the {} classes of the run", classes.len()),
                help,
            ));
        }
        let Found { images, labels } = score(&scene, &ply, stored.as_ref(), &classes, &config)?;
        // Classes that association found are objects; true labels are of other classes.
        let objects = config.data.association != Association::None;
        let instances = objects.then(|| {
            let known = labels
                .iter()
                .filter_map(|(view, found)| Some((view.instances.as_ref()?, found)));
            instance_scores(known.map(|(truth, found)| (truth.map(), found.map())))
        });
        let semantics = Semantics::of(&scene).filter(|_| objects && stored.is_some());
        let semantic = semantics.map(|semantics| semantics.score(&classes, &labels));
        let labels = label_scores(
            &scene.classes,
            labels
                .iter()
                .filter(|_| !objects)
                .filter_map(|(view, found)| Some((view.truth.as_ref()?.map(), found.map()))),
            Void::Wrong,
        );
        let views = scene.split(Split::Test).count();
        if self.json {
            let row = RowScores {
                instances,
                semantic,
                ..RowScores::from(&labels)
            };
            let labels = stored.and(stored_row(&config)).map(|name| (name, row));
            let mean = ImageScores::mean(&images.values().copied().collect::<Vec<_>>());
            let test = TestScores {
                psnr: mean.psnr,
                ssim: mean.ssim,
                views: images,
                labels: labels.into_iter().collect(),
            };
            let json = serde_json::json!({ "scene": scene.name, "gaussians": ply.gaussians.len(), "held_out": views, "test": test });
            terminal::say(&json.to_string());
            return Ok(());
        }
        let images = ImageScores::mean(&images.into_values().collect::<Vec<_>>());
        terminal::say(&format!(
            "{}: {} Gaussians, {views} held-out views",
            scene.name,
            ply.gaussians.len()
        ));
        let of_objects =
            |pick: fn(&InstanceScores) -> Option<f64>| instances.as_ref().and_then(pick);
        let by_class = |pick: fn(&SemanticScores) -> Option<f64>| semantic.as_ref().and_then(pick);
        let figures = [
            ("PSNR", images.psnr, " dB", 2),
            ("SSIM", images.ssim, "", 4),
            ("mIoU pooled", labels.miou, "", 4),
            ("mIoU per view", labels.miou_per_view, "", 4),
            ("accuracy", labels.accuracy, "", 4),
            ("object accuracy", of_objects(|s| s.accuracy), "", 4),
            ("object mIoU", of_objects(|s| s.miou), "", 4),
            ("PQ", of_objects(|s| s.panoptic.pq), "", 4),
            ("class mIoU", by_class(|s| s.miou), "", 4),
            ("per view", by_class(|s| s.miou_per_view), "", 4),
            ("class accuracy", by_class(|s| s.accuracy), "", 4),
            ("PQ by class", by_class(|s| s.panoptic?.all.pq), "", 4),
            ("PQ of things", by_class(|s| s.panoptic?.things.pq), "", 4),
            ("PQ of stuff", by_class(|s| s.panoptic?.stuff.pq), "", 4),
        ];
        for (name, value, unit, decimals) in figures {
            if let Some(value) = value {
                terminal::say(&format!("{name:>14}  {value:.decimals$}{unit}"));
            }
        }
        for (id, iou) in &labels.per_class {
            terminal::say(&format!(
                "{:>14}  {iou:.4}  IoU of {id} {}",
                "",
                scene.classes.name(*id)
            ));
        }
        for class in semantic.iter().flat_map(|s| &s.per_class) {
            terminal::say(&format!(
                "{:>14}  {:.4}  IoU of {} {}",
                "", class.iou, class.id, class.name
            ));
        }
        Ok(())
    }
}

/// The row whose identities a run with these settings stores.
fn stored_row(config: &Config) -> Option<Variant> {
    let rows = config.segmentation.rows();
    rows.iter()
        .find(|row| **row == Variant::Ours)
        .or_else(|| rows.iter().rfind(|row| **row != Variant::Raw))
        .copied()
}

/// The identities of the run, or else the labels in its PLY; nothing when it has neither.
fn stored(run: &RunFolder, ply: &PlyScene) -> Result<Option<Stored>> {
    let path = run.identities_path();
    if !path.is_file() {
        return Ok(ply.labels.clone().map(Stored::Labels));
    }
    let identities = Identities::read(&path)?;
    let (rows, n) = (
        identities.scores.len() / identities.classes.max(1),
        ply.gaussians.len(),
    );
    if rows != n {
        let help = "the two files are of different runs; train again";
        return Err(Error::input(
            &path,
            "scores",
            format!("{rows} rows"),
            format!("{n}, as in scene.ply"),
            help,
        ));
    }
    Ok(Some(Stored::Identities(identities)))
}

/// The labels that a projection shows.
type Shown<'a> = dyn Fn(&Projected<f32>) -> LabelMap + 'a;

/// Image scores of each view, and the rendered labels of the views that have truth.
fn score<'s>(
    scene: &'s Scene,
    ply: &PlyScene,
    stored: Option<&Stored>,
    classes: &Classes,
    config: &Config,
) -> Result<Found<'s>> {
    let settings = Settings::from(&config.raster);
    let rule = LabelRule::from(&config.segmentation);
    let shown = stored.map(|stored| -> Box<Shown<'_>> {
        match stored {
            Stored::Identities(identities) => {
                let maps = LabelMaps::new(identities, classes, rule);
                Box::new(move |projected| maps.of(projected))
            }
            Stored::Labels(ids) => {
                Box::new(move |projected| hard_label_map(projected, ids, rule.min_coverage))
            }
        }
    });
    let bar = terminal::bar("eval", scene.split(Split::Test).count() as u64);
    let (mut images, mut labels) = (BTreeMap::new(), Vec::new());
    for view in scene.split(Split::Test) {
        let View {
            camera,
            truth,
            instances,
            ..
        } = view;
        let rendered = render(&ply.gaussians, camera, &settings, config.raster.background)?;
        images.insert(
            view.name.clone(),
            ImageScores::of_view(&rendered.rgb, view)?,
        );
        if let (true, Some(shown)) = (truth.is_some() || instances.is_some(), &shown) {
            let projected = Projected::new(&ply.gaussians.splats(), camera, &settings)?;
            labels.push((view, shown(&projected).into()));
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Found { images, labels })
}
