//! `coseg separate`: things of one label that do not touch become objects of their own.

use super::object_scene::EditedSceneArgs;
use super::terminal;
use clap::Args;
use coseg::error::Result;
use coseg::objects::{Edited, Separation};
use coseg::runs::Cameras;

const HELP: &str = "\
A scene that was trained on classes has one label for all chairs. Gaussians of one label that touch, directly or through
others, are a piece. The largest piece keeps its id, each other piece gets a new one, and they are called chair 1, chair 2
and so on, the largest first. Pieces that are small beside the largest are strays and join the nearest piece. Chairs that
touch each other stay one. The new file gets a classes.json beside it in which each object has its class: `coseg edit
--remove chair` still removes all of them, --remove \"chair 2\" one.

Examples:
  coseg separate --scene runs/room --out objects/scene.ply
  coseg separate --scene runs/room --out objects/scene.ply --only chair,table --smallest 0.1";

/// Arguments of `coseg separate`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct SeparateArgs {
    #[command(flatten)]
    scene: EditedSceneArgs,
    /// Separate only these labels, ids or names [default: all]
    #[arg(long, value_name = "OBJECT,...", value_delimiter = ',')]
    only: Vec<String>,
    /// Pieces with less than this share of the area of their label's largest are strays [default: 0.01]
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true)]
    smallest: Option<f64>,
    /// Pieces of fewer Gaussians than this are strays too [default: 10]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    fewest: Option<usize>,
    /// Opacity at which a Gaussian ends; a higher one separates more [default: 0.1]
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    level: Option<f64>,
}

impl SeparateArgs {
    /// Separates and writes.
    pub fn run(self) -> Result<()> {
        let mut scene = self.scene.from.read()?;
        let only = scene.ids(&self.only, "--only")?;
        let wanted = |id: u16| self.only.is_empty() || only.contains(&id);
        let mut rules = Separation::default();
        rules.smallest = self.smallest.unwrap_or(rules.smallest);
        rules.fewest = self.fewest.unwrap_or(rules.fewest);
        rules.level = self.level.unwrap_or(rules.level);
        let gaussians = std::mem::take(&mut scene.ply.gaussians);
        let separated = rules.apply(&gaussians, &scene.labels, &scene.classes, wanted)?;
        let edited = Edited {
            gaussians,
            labels: separated.labels,
            classes: separated.classes,
        };
        let out = self
            .scene
            .write(&scene, &edited, Cameras::Beside(&scene.path))?;
        let before = scene.objects.len();
        let mut after = before;
        for (id, pieces) in &separated.pieces {
            after += pieces.len() - 1;
            let name = scene.name(*id);
            let name = name.map_or_else(|| format!("label {id}"), str::to_owned);
            terminal::say(&format!("{name}: {} pieces", pieces.len()));
        }
        let out = out.display();
        terminal::say(&format!("{out}: {after} labels, {before} before"));
        Ok(())
    }
}
