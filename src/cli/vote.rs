//! `coseg vote`: labels for Gaussians by a vote of raw label maps.

use super::labelled::LabelledArgs;
use super::{held_out, terminal};
use clap::Args;
use coseg::data::Classes;
use coseg::error::Result;
use coseg::pipeline::{HeldOut, SegmentationInputs};
use coseg::runs::{Cameras, SCENE, SideFiles, check_vote, vote, write_scene};

const HELP: &str = "\
Each Gaussian takes the class of most of its pixels: the one with the largest sum of blending weights (alpha' T) over the raw
labels of the training views. Writes scene.ply with a label column, classes.json and cameras.json. Where test views have true
labels, prints the scores. Ids must mean the same in every view; if they do not, as in instance masks, use `coseg associate`.

Example:
  coseg vote --scene scene.ply --data scenes/living --out runs/voted --set data.raw_labels=labels_raw";

/// Arguments of `coseg vote`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct VoteArgs {
    #[command(flatten)]
    input: LabelledArgs,
    /// Pool the votes over patches of one surface, corrected for classes named too often
    #[arg(long)]
    pooled: bool,
}

impl VoteArgs {
    /// Votes, writes and scores.
    pub fn run(self) -> Result<()> {
        let config = self.input.config()?;
        check_vote(&config)?;
        let device = self.input.backend.open()?;
        let (mut scene, ply) = self.input.read(&config, &device, &[])?;
        scene.drop_unused_classes(&Classes::default());
        let (path, cameras) = (self.input.out.join(SCENE), scene.cameras());
        let beside = SideFiles {
            scenes: &[&path],
            classes: Some(&scene.classes),
            cameras: Cameras::Used(&cameras),
        };
        beside.check(None)?;
        let identities = vote(&scene, &ply.gaussians, self.pooled, &config, &device)?;
        let ids = identities.ids(&scene.classes);
        let scene_of = (&ply.gaussians, ply.origin);
        write_scene(&path, scene_of, Some(&ids), &beside)?;
        let unseen = ids.iter().filter(|&&id| id == scene.classes.ignore).count();
        terminal::say(&format!(
            "{}: {} Gaussians labelled, {unseen} without a vote",
            path.display(),
            ids.len() - unseen
        ));
        let inputs = SegmentationInputs::new(&scene, &ply.gaussians, &config, &device);
        let views = HeldOut::new(&inputs);
        let scores = views.score(&identities)?;
        held_out::print(&scores, &format!("{} held-out views", views.len()));
        Ok(())
    }
}
