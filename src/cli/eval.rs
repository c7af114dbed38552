//! `coseg eval`: the scores of a run.

use super::{held_out, terminal};
use clap::Args;
use coseg::backend::device::open_cpu;
use coseg::config::{Association, Config, Variant};
use coseg::data::{Class, Classes, Split};
use coseg::error::{Result, bail};
use coseg::metrics::ImageScores;
use coseg::objects::Semantics;
use coseg::pipeline::{
    HeldOut, Pictures, SegmentationInputs, compare_with_photos, load_scene, stored_corrections,
};
use coseg::report::{TestScores, VariantScores};
use coseg::runs::{RunFolder, SCENE, identities_beside};
use coseg::splat::ply;
use std::collections::BTreeMap;
use std::path::PathBuf;

const HELP: &str = "\
Prints PSNR and SSIM of the run's scene on the held-out views. Where these have true labels, prints mIoU (all views in
one confusion matrix, and the mean over views), accuracy and the IoU of each class, 0 to 1. Where a run associated
objects, scores them against true instances and, where segments have classes, against true labels. --json uses the names
of metrics.json.

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
    /// Scene folder, if it has moved or you want another one [default: that of the run]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl EvalArgs {
    /// Scores the run.
    pub fn run(self) -> Result<()> {
        let run = RunFolder::existing(&self.run)?;
        if let Some(command) = run.unfinished() {
            terminal::note(&format!("the run was stopped; continue it: {command}"));
        }
        let config = run.config_for(self.data.as_deref(), &[])?;
        let is_elsewhere = self.data.is_some();
        let ply = ply::read(&run.file(SCENE))?;
        let mut scene = load_scene(&config)?.with_origin(ply.origin);
        let classes = run.classes()?;
        let mut semantics = None;
        let is_associated = config.data.association != Association::None;
        if is_associated {
            // True labels hold ids of classes, and the labels of this run ids of objects.
            semantics = Semantics::of(&scene);
            scene.views.iter_mut().for_each(|view| view.truth = None);
        }
        if is_associated {
            scene.classes.clone_from(&classes);
        } else {
            if stored_corrections(run.path())?.is_none() {
                expect_classes(&scene.classes, &classes)?;
            }
            scene.drop_unused_classes(&classes);
            // With corrections by a person, classes may be new or renamed.
            scene.classes.put(&classes);
        }
        let device = open_cpu()?;
        if is_elsewhere {
            compare_with_photos(&run.file(SCENE), &ply.gaussians, &scene, &config, &device)?;
        }
        let inputs = SegmentationInputs {
            semantics: semantics.as_ref(),
            ..SegmentationInputs::new(&scene, &ply.gaussians, &config, &device)
        };
        // Read before the slow part, so that a fault is reported at once.
        let identities = identities_beside(&run.file(SCENE), ply.gaussians.len(), classes.len())?;
        let identities = identities.map(|own| own.for_classes(&classes, &scene.classes));
        let views = image_scores(&inputs)?;
        let score = |identities| HeldOut::new(&inputs).score(&identities);
        let labels = identities.map(score).transpose()?;
        let mean = ImageScores::mean(&views.values().copied().collect::<Vec<_>>());
        if self.json {
            let held_out = views.len();
            let rows = labels
                .and_then(|scores| Some((stored_row(&config)?, VariantScores::from(&scores))));
            let test = TestScores {
                psnr: mean.psnr,
                ssim: mean.ssim,
                views,
                labels: rows.into_iter().collect(),
            };
            let json = serde_json::json!({
                "scene": scene.name, "gaussians": ply.gaussians.len(), "held_out": held_out, "test": test,
            });
            terminal::say(&json.to_string());
            return Ok(());
        }
        terminal::say(&format!(
            "{}: {} Gaussians, {} held-out views",
            scene.name,
            ply.gaussians.len(),
            views.len()
        ));
        if let (Some(psnr), Some(ssim)) = (mean.psnr, mean.ssim) {
            terminal::say(&format!("images: PSNR {psnr:.2} dB, SSIM {ssim:.4}"));
        }
        if let Some(scores) = labels {
            held_out::print(&scores, if is_associated { "objects" } else { "labels" });
            held_out::print_classes(&scores, &scene.classes);
        }
        Ok(())
    }
}

/// Refuses a scene that has not all classes of the run, with the same names.
fn expect_classes(scene: &Classes, run: &Classes) -> Result<()> {
    if scene.is_empty() {
        return Ok(());
    }
    let differs = |class: &&Class| scene.known_name(class.id) != Some(&class.name);
    if let Some(Class { id, name, .. }) = run.entries.iter().find(differs) {
        let found = scene.known_name(*id).unwrap_or("nothing");
        bail!(argument "--data"; found "{found} as class {id}"; expected "{name}, as in the classes of the run";
            help "give the scene that was trained on, or one with the same classes.json");
    }
    Ok(())
}

/// The row whose identities a run with these settings stores.
fn stored_row(config: &Config) -> Option<Variant> {
    let rows = config.segmentation.rows();
    rows.iter()
        .find(|row| **row == Variant::Ours)
        .or_else(|| rows.iter().rfind(|row| **row != Variant::Raw))
        .copied()
}

/// Scores of the rendered colours of each held-out view.
fn image_scores(inputs: &SegmentationInputs) -> Result<BTreeMap<String, ImageScores>> {
    let bar = terminal::bar("eval", inputs.scene.split(Split::Test).count() as u64);
    let pictures = Pictures::new(inputs.gaussians, inputs.config, inputs.device)?;
    let views = inputs.scene.split(Split::Test).map(|view| {
        let (_, scores) = pictures.of(view)?;
        bar.inc(1);
        Ok((view.name.clone(), scores))
    });
    let views = views.collect();
    bar.finish_and_clear();
    views
}
