//! `coseg vote`: labels for Gaussians by a vote of raw label maps.

use super::labelled::LabelledArgs;
use super::{held_out, terminal};
use clap::Args;
use coseg::config::Association;
use coseg::data::Split;
use coseg::error::{Result, bail, ensure};
use coseg::objects::{pooled_vote, refined_vote, vote};
use coseg::pipeline::{HeldOut, Inputs};
use coseg::raster::Settings;
use coseg::splat::ply;

const HELP: &str = "\
Each Gaussian takes the class of most of its pixels: the one with the largest sum of blending weights (alpha' T) over the raw
labels of the training views. Writes scene.ply with a label column, and classes.json. Where test views have true labels,
prints the scores. Ids must mean the same in every view: for instance masks use `coseg associate`.

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
        ensure!(config.data.association == Association::None,
            setting "data.association"; found "\"gaussians\"";
            expected "\"none\": the votes are for classes that are the same in every view";
            help "use `coseg associate`, which makes objects of segments and votes for these");
        let settings = Settings::from(&config.raster);
        let device = self.input.device()?;
        let (scene, ply) = self.input.read(&config, &device, &[])?;
        if scene.labelled().next().is_none() {
            bail!(&self.input.data, "raw_label_path"; found "nothing"; expected "raw labels of training views";
                help "add raw_label_path to the frames of a transforms.json, or name a folder with --set data.raw_labels=FOLDER");
        }
        let gaussians = &ply.gaussians;
        let views = || scene.split(Split::Train);
        let classes = &scene.classes;
        let identities = if self.pooled {
            let votes = vote(gaussians, views(), classes, &settings, &device)?;
            let refined = refined_vote(gaussians, views(), classes, &settings, &device)?;
            let exponent = config.segmentation.prior_exponent;
            pooled_vote(gaussians, &votes, &refined, exponent)?.identities
        } else {
            vote(gaussians, views(), classes, &settings, &device)?.identities()
        };
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
        let inputs = Inputs::new(&scene, &ply.gaussians, &config, &device);
        let views = HeldOut::new(&inputs);
        let scores = views.score(&identities, &inputs)?;
        held_out::print(&scores, &format!("{} held-out views", views.len()));
        Ok(())
    }
}
