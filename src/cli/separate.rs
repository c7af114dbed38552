//! `coseg separate`: things of one label that do not touch become objects of their own.

use super::object_scene::ObjectSceneArgs;
use super::scene_file::bring_cameras;
use super::terminal;
use clap::Args;
use coseg::error::Result;
use coseg::objects::Separation;
use coseg::splat::ply;
use std::path::PathBuf;

const HELP: &str = "\
A scene that was trained on classes has one label for all chairs. Gaussians of one label that touch, and those that they
touch in turn, are a piece; the largest piece keeps its id, each other one gets a new id, and they are called chair 1,
chair 2 and so on from the largest. Pieces that are small beside the largest are strays and join the nearest piece. Chairs
that touch each other stay one. The new file gets its classes.json beside it, where each object says its class:
`coseg edit --remove chair` still means all of them, --remove \"chair 2\" one.

Examples:
  coseg separate --scene runs/room --out objects/scene.ply
  coseg separate --scene runs/room --out objects/scene.ply --only chair,table --smallest 0.1";

/// Arguments of `coseg separate`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct SeparateArgs {
    #[command(flatten)]
    input: ObjectSceneArgs,
    /// File to write
    #[arg(long, value_name = "FILE.ply")]
    out: PathBuf,
    /// Separate these labels alone, ids or names [default: all]
    #[arg(long, value_name = "OBJECT,...", value_delimiter = ',')]
    only: Vec<String>,
    /// Pieces with less than this share of the area of their label's largest are strays [default: 0.01]
    #[arg(long, value_name = "SHARE")]
    smallest: Option<f64>,
    /// Pieces of fewer Gaussians than this are strays too [default: 10]
    #[arg(long, value_name = "N")]
    fewest: Option<usize>,
    /// Opacity at which a Gaussian ends; higher tells more apart [default: 0.1]
    #[arg(long, value_name = "X")]
    level: Option<f64>,
}

impl SeparateArgs {
    /// Separates and writes.
    pub fn run(self) -> Result<()> {
        let scene = self.input.read()?;
        let only = scene.ids(&self.only, "--only")?;
        let wanted = |id: u16| self.only.is_empty() || only.contains(&id);
        let mut rules = Separation::default();
        rules.smallest = self.smallest.unwrap_or(rules.smallest);
        rules.fewest = self.fewest.unwrap_or(rules.fewest);
        rules.level = self.level.unwrap_or(rules.level);
        let found = rules.apply(&scene.ply.gaussians, &scene.labels, &scene.classes, wanted)?;
        let names = self.input.names_beside(&self.out, &scene, &found.classes)?;
        ply::write(
            &self.out,
            &scene.ply.gaussians,
            scene.ply.origin,
            Some(&found.labels),
        )?;
        found.classes.write(&names)?;
        bring_cameras(&scene.path, &self.out)?;
        for (id, pieces) in &found.pieces {
            let name = scene
                .name(*id)
                .map_or_else(|| format!("label {id}"), str::to_owned);
            terminal::say(&format!("{name}: {} pieces", pieces.len()));
        }
        let before = scene.objects.len();
        let after = before
            + found
                .pieces
                .values()
                .map(|pieces| pieces.len() - 1)
                .sum::<usize>();
        terminal::say(&format!(
            "{}: {after} labels, {before} before",
            self.out.display()
        ));
        Ok(())
    }
}
