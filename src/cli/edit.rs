//! `coseg edit`: keeps, removes, turns, moves and paints objects of a labelled scene, and applies edits of the viewer.

use super::object_scene::EditedSceneArgs;
use super::terminal;
use super::values::numbers;
use clap::Args;
use coseg::error::{Result, ensure};
use coseg::objects::{Editing, Edits};
use coseg::runs::{Cameras, ObjectEdits, turn};
use glam::{DQuat, DVec3};
use std::path::PathBuf;

const HELP: &str = "\
OBJECT is a label id or a name, as `coseg objects` lists them; capitals do not matter where only one name fits. A name means
all objects with that name; a class means all associated objects of that class (chair: chair 1, chair 2). A name with a
comma needs its id. The order is: keep, remove, turn, move. Turns are counter-clockwise as seen from the tip of the axis. An
axis can be a direction, as the viewer writes it (chair=0.02:-0.98:0.17,30): few COLMAP scenes have an upright axis. The
axis goes through the middle of the object's box, and view-dependent colours turn with their object. The new file keeps its
labels; classes.json and cameras.json are copied beside it.

--edits applies what was done in a page of `coseg view` and saved there: names, colours, labels of single Gaussians,
deletions and moves (docs/edits.md). It belongs to one scene file, and no other is accepted.

A scene is empty where no photo looked, such as on the floor below a sofa that you remove.

Examples:
  coseg edit --scene runs/room/scene.ply --out without/scene.ply --remove sofa,table
  coseg edit --scene runs/room/scene.ply --out lamp/scene.ply --keep lamp
  coseg edit --scene runs/room/scene.ply --out moved/scene.ply --turn chair=z,90 --move chair=0.5,0,0
  coseg edit --scene runs/room/scene.ply --out painted/scene.ply --paint
  coseg edit --scene runs/room --edits edits.json --out edited";

/// Arguments of `coseg edit`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct EditArgs {
    #[command(flatten)]
    scene: EditedSceneArgs,
    /// Apply the edits that the viewer saved
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["keep", "remove", "turn", "moves"])]
    edits: Option<PathBuf>,
    /// Keep only these objects; may be repeated
    #[arg(long, value_name = "OBJECT,...", value_delimiter = ',')]
    keep: Vec<String>,
    /// Remove these objects; may be repeated
    #[arg(long, value_name = "OBJECT,...", value_delimiter = ',')]
    remove: Vec<String>,
    /// Turn an object about the world's x, y or z, or a direction X:Y:Z; may be repeated
    #[arg(long, value_name = "OBJECT=AXIS,DEGREES", value_parser = parse_turn)]
    turn: Vec<(String, DQuat)>,
    /// Move an object, world units; may be repeated
    #[arg(long = "move", value_name = "OBJECT=X,Y,Z", value_parser = parse_move)]
    moves: Vec<(String, DVec3)>,
    /// Colour every Gaussian by its object, for viewers that do not read labels
    #[arg(long)]
    paint: bool,
}

fn parse_turn(text: &str) -> std::result::Result<(String, DQuat), String> {
    let parse = || {
        let (object, about) = text.rsplit_once('=')?;
        let (axis, degrees) = about.split_once(',')?;
        let axis = match axis.trim() {
            "x" => DVec3::X,
            "y" => DVec3::Y,
            "z" => DVec3::Z,
            direction => vector(direction, ':')?,
        };
        let [degrees] = numbers::<f64, 1>(degrees, ',')?;
        Some((object.to_owned(), turn(axis, degrees)?))
    };
    let expected = "expected an object, x, y, z or a direction, and degrees, for instance chair=z,90 or chair=0.1:-0.99:0.05,90";
    parse().ok_or_else(|| expected.into())
}

fn parse_move(text: &str) -> std::result::Result<(String, DVec3), String> {
    let parse = || {
        let (object, offset) = text.rsplit_once('=')?;
        Some((object.to_owned(), vector(offset, ',')?))
    };
    parse().ok_or_else(|| "expected an object and three numbers, for instance chair=0.5,0,0".into())
}

/// Three finite numbers.
fn vector(text: &str, separator: char) -> Option<DVec3> {
    let vector = DVec3::from(numbers::<f64, 3>(text, separator)?);
    vector.is_finite().then_some(vector)
}

impl EditArgs {
    /// Edits and writes.
    pub fn run(self) -> Result<()> {
        let objects = ObjectEdits {
            keep: self.keep,
            remove: self.remove,
            turns: self.turn,
            moves: self.moves,
        };
        ensure!(self.paint || self.edits.is_some() || !objects.is_empty(), argument "coseg edit"; found "no operation";
            expected "--edits, --keep, --remove, --turn, --move or --paint";
            help "say what to change; `coseg edit --help` has examples");
        // Edits may be the first labels of a scene.
        let mut scene = if self.edits.is_some() {
            self.scene.from.read_or_unlabelled()?
        } else {
            self.scene.from.read()?
        };
        let gaussians = std::mem::take(&mut scene.ply.gaussians);
        let editing = Editing::new(gaussians, scene.labels.clone(), scene.classes.clone());
        let (mut edited, done) = match &self.edits {
            Some(file) => {
                let edits = Edits::read(file)?;
                let done = format!("edits: {}", edits.operations.len());
                (scene.edited(editing, &edits)?, done)
            }
            None => objects.apply(&scene, editing)?,
        };
        if self.paint {
            let classes = &edited.classes;
            let color = |&id: &u16| classes.legend_color(id).map(|v| f32::from(v) / 255.0);
            let colors: Vec<_> = edited.labels.iter().map(color).collect();
            edited.gaussians = edited.gaussians.painted(&colors);
        }
        let out = self
            .scene
            .write(&scene, &edited, Cameras::Beside(&scene.path))?;
        let (left, all) = (edited.labels.len(), scene.labels.len());
        let mut said = format!("{}: {left} of {all} Gaussians", out.display());
        if !done.is_empty() {
            said += &format!("; {done}");
        }
        if self.paint {
            said += "; painted in the colours of their labels";
        }
        terminal::say(&said);
        Ok(())
    }
}
