//! `coseg prune`: a scene without the Gaussians that its photos do not need.

use super::labelled::LabelledArgs;
use super::terminal;
use clap::{ArgGroup, Args};
use coseg::data::Classes;
use coseg::error::{Result, ensure};
use coseg::pipeline::{Keep, prune, score_images};
use coseg::runs::{Cameras, SCENE, SideFiles, classes_beside, scene_path, write_scene};

const HELP: &str = "\
Measures what each Gaussian adds to the pictures of the training views, and leaves out those that add least. Works on scenes of
other trainers too. Writes scene.ply, with labels where the scene has some, classes.json and cameras.json. Prints the PSNR of
some training views, and of the held-out views if there are some. The Gaussians that stay are not trained again. A thousand
steps of training win back most of what was lost, even where half of the Gaussians or more are left out:
  coseg train --data DIR --set building.gaussians=OUT/scene.ply --set building.iterations=1000 --set building.max_gaussians=N
N is the number of Gaussians that stay.

Examples:
  coseg prune --scene runs/room --data scenes/room --out runs/small --keep 0.5
  coseg prune --scene point_cloud.ply --data scenes/room --out runs/small --within 0.1";

/// Arguments of `coseg prune`.
#[derive(Args, Debug)]
#[command(after_help = HELP, group = ArgGroup::new("how many").required(true))]
pub struct PruneArgs {
    #[command(flatten)]
    input: LabelledArgs,
    /// Keep this share of the Gaussians, above 0, at most 1
    #[arg(
        long,
        value_name = "SHARE",
        group = "how many",
        allow_negative_numbers = true
    )]
    keep: Option<f64>,
    /// Keep as few Gaussians as lower the mean PSNR of the training views by no more than this, dB
    #[arg(long, value_name = "DB", group = "how many", value_parser = decibels, allow_negative_numbers = true)]
    within: Option<f64>,
}

impl PruneArgs {
    /// Measures, leaves out, writes and scores.
    pub fn run(self) -> Result<()> {
        let keep = self.how_many()?;
        let config = self.input.config()?;
        let device = self.input.backend.open()?;
        let (scene, ply) = self.input.read(&config, &device, &[])?;
        let from = scene_path(&self.input.scene)?;
        let classes = match &ply.labels {
            Some(_) => classes_beside(&from, None)?,
            None => Classes::default(),
        };
        ensure!(!ply.gaussians.is_empty(), &from, "element vertex"; found "no Gaussian"; expected "one or more";
            help "name a scene that is not empty");
        let (path, cameras) = (self.input.out.join(SCENE), scene.cameras());
        let beside = SideFiles {
            scenes: &[&path],
            classes: ply.labels.as_ref().map(|_| &classes),
            cameras: Cameras::Used(&cameras),
        };
        beside.check(None)?;
        let pruning = prune(&ply.gaussians, &scene, keep, &config, &device)?;
        let gaussians = ply.gaussians.select(&pruning.kept);
        let labels = ply.labels.as_ref().map(|labels| {
            let kept = pruning.kept.iter().map(|&i| labels[i as usize]);
            kept.collect::<Vec<u16>>()
        });
        let scene_of = (&gaussians, ply.origin);
        write_scene(&path, scene_of, labels.as_deref(), &beside)?;
        terminal::say(&format!(
            "{}: {} of {} Gaussians, PSNR of training views {:.2} dB, {:.2} dB before",
            path.display(),
            gaussians.len(),
            ply.gaussians.len(),
            pruning.after,
            pruning.before,
        ));
        let before = score_images(&ply.gaussians, &scene, &config, &device)?.psnr;
        let after = score_images(&gaussians, &scene, &config, &device)?.psnr;
        if let (Some(before), Some(after)) = (before, after) {
            terminal::say(&format!(
                "held-out views: PSNR {after:.2} dB, {before:.2} dB before"
            ));
        }
        Ok(())
    }

    /// The checked choice. The command line has exactly one of the two.
    fn how_many(&self) -> Result<Keep> {
        if let Some(share) = self.keep {
            ensure!(share > 0.0 && share <= 1.0, argument "--keep"; found "{share}";
                expected "a number above 0, at most 1"; help "0.5 keeps half of the Gaussians");
            return Ok(Keep::Share(share));
        }
        let loss = self.within.unwrap_or_default();
        ensure!(loss >= 0.0 && loss.is_finite(), argument "--within"; found "{loss}";
            expected "a number of 0 or more"; help "0.1 allows a tenth of a decibel");
        Ok(Keep::Within(loss))
    }
}

/// A number that may end with its unit.
fn decibels(text: &str) -> std::result::Result<f64, std::num::ParseFloatError> {
    text.strip_suffix("dB").unwrap_or(text).trim_end().parse()
}
