//! `coseg vote`: labels for a scene that exists already.

use super::labelled::LabelledArgs;
use super::terminal;
use clap::Args;
use coseg::config::Association;
use coseg::data::{LabelRuns, Split};
use coseg::error::{Error, Result};
use coseg::metrics::{Void, label_scores};
use coseg::objects::{LabelMaps, LabelRule, vote};
use coseg::raster::{self, Projected};
use coseg::splat::ply;

const HELP: &str = "\
Each Gaussian takes the class with the largest summed alpha' T over the raw labels of the training views. Writes
scene.ply with a label column, and classes.json. Where test views have true labels, prints the scores. Ids that mean
something in their view alone, as those of instance masks, are for `coseg associate`.

Example:
  coseg vote --scene scene.ply --data scenes/living --out runs/voted --set data.raw_labels=labels_raw";

/// Arguments of `coseg vote`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct VoteArgs {
    #[command(flatten)]
    input: LabelledArgs,
}

impl VoteArgs {
    /// Votes, writes and scores.
    pub fn run(self) -> Result<()> {
        let config = self.input.config()?;
        if config.data.association != Association::None {
            let expected =
                "\"none\": a vote takes the ids of raw labels for classes, the same in every view";
            let help = "use `coseg associate`, which makes objects of segments and votes for these";
            return Err(Error::config(
                "data.association",
                "\"gaussians\"",
                expected,
                help,
            ));
        }
        let raster = raster::Settings::from(&config.raster);
        let device = self.input.device()?;
        let (scene, ply) = self.input.read(&config, &device)?;
        if !scene.split(Split::Train).any(|v| v.raw.is_some()) {
            let help = "add raw_label_path to the frames of a transforms.json, or name a folder with --set data.raw_labels=FOLDER";
            return Err(Error::input(
                &self.input.data,
                "raw_label_path",
                "nothing",
                "raw labels of training views",
                help,
            ));
        }
        let votes = vote(
            &ply.gaussians,
            scene.split(Split::Train),
            &scene.classes,
            &raster,
            &device,
        )?;
        let identities = votes.identities();
        let ids = identities.ids(&scene.classes);
        let path = self.input.out.join("scene.ply");
        ply::write(&path, &ply.gaussians, ply.origin, Some(&ids))?;
        scene.classes.write(&self.input.out.join("classes.json"))?;
        let unseen = ids.iter().filter(|&&id| id == scene.classes.ignore).count();
        terminal::say(&format!(
            "{}: {} Gaussians labelled, {unseen} without a vote",
            path.display(),
            ids.len() - unseen
        ));

        let maps = LabelMaps::new(
            &identities,
            &scene.classes,
            LabelRule::from(&config.segmentation),
        );
        let mut scored = Vec::new();
        for view in scene.split(Split::Test) {
            let Some(truth) = &view.truth else { continue };
            let projected = Projected::new(&ply.gaussians.splats(), &view.camera, &raster)?;
            scored.push((truth, LabelRuns::from(maps.of(&projected))));
        }
        let pairs = scored
            .iter()
            .map(|(truth, found)| (truth.map(), found.map()));
        let scores = label_scores(&scene.classes, pairs, Void::Wrong);
        if let (Some(miou), Some(per_view), Some(accuracy)) =
            (scores.miou, scores.miou_per_view, scores.accuracy)
        {
            terminal::say(&format!(
                "{} held-out views: mIoU {miou:.4} pooled, {per_view:.4} per view, accuracy {accuracy:.4}",
                scored.len()
            ));
        }
        Ok(())
    }
}
