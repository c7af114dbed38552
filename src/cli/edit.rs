//! `coseg edit`: objects of a labelled scene kept, removed, turned, moved and painted.

use super::object_scene::{ObjectScene, ObjectSceneArgs};
use super::terminal;
use super::values::numbers;
use clap::Args;
use coseg::error::{Result, ensure};
use coseg::objects::Object;
use coseg::splat::{Gaussians, Motion};
use glam::{DQuat, DVec3};
use std::path::PathBuf;

const HELP: &str = "\
OBJECT is a label id or a name, as `coseg objects` lists them. A name means all objects with that name; a class means all
associated objects of that class (chair: chair 1, chair 2). A name with a comma needs its id. The order is: keep, remove,
turn, move. Turns are counter-clockwise as seen from the tip of the axis. An axis can be a direction, as the viewer writes
it (chair=0.02:-0.98:0.17,30): few COLMAP scenes have an upright axis. The axis goes through the middle of the object's
box, and view-dependent colours turn with their object. The new file keeps its labels; classes.json and cameras.json are
copied beside it.

A scene has nothing where no photo looked, such as on the floor below a sofa that you remove.

Examples:
  coseg edit --scene runs/room/scene.ply --out without/scene.ply --remove sofa,table
  coseg edit --scene runs/room/scene.ply --out lamp/scene.ply --keep lamp
  coseg edit --scene runs/room/scene.ply --out moved/scene.ply --turn chair=z,90 --move chair=0.5,0,0
  coseg edit --scene runs/room/scene.ply --out painted/scene.ply --paint";

/// The farthest that objects move, in diagonals of the scene: positions are f32.
const MAX_MOVE: f64 = 100.0;

/// Arguments of `coseg edit`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct EditArgs {
    #[command(flatten)]
    input: ObjectSceneArgs,
    /// PLY file to write
    #[arg(long, value_name = "FILE.ply")]
    out: PathBuf,
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
        let (object, turn) = text.rsplit_once('=')?;
        let (axis, degrees) = turn.split_once(',')?;
        let axis = match axis.trim() {
            "x" => DVec3::X,
            "y" => DVec3::Y,
            "z" => DVec3::Z,
            direction => vector(direction, ':')?.try_normalize()?,
        };
        let [degrees] = numbers::<f64, 1>(degrees, ',').filter(|[d]| d.is_finite())?;
        let turn = DQuat::from_axis_angle(axis, degrees.to_radians());
        Some((object.to_owned(), turn))
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
        let mut scene = self.input.read()?;
        let kept = scene.ids(&self.keep, "--keep")?;
        let removed = scene.ids(&self.remove, "--remove")?;
        self.input.check_out(&self.out, &scene, &scene.classes)?;
        let stays =
            |id: u16| (self.keep.is_empty() || kept.contains(&id)) && !removed.contains(&id);
        let motions = self.motions(&scene, &stays)?;
        for (rows, motion) in &motions {
            motion.apply(&mut scene.ply.gaussians, rows);
        }
        let rows: Vec<u32> = (0..)
            .zip(&scene.labels)
            .filter(|&(_, &id)| stays(id))
            .map(|(row, _)| row)
            .collect();
        ensure!(!rows.is_empty(), argument "--keep, --remove"; found "no Gaussian left"; expected "one or more";
            help "keep an object, or remove fewer");
        let labels: Vec<u16> = rows.iter().map(|&row| scene.labels[row as usize]).collect();
        let mut gaussians = scene.ply.gaussians.select(&rows);
        if self.paint {
            let colors: Vec<_> = labels.iter().map(|&id| scene.color(id)).collect();
            gaussians = gaussians.painted(&colors);
        }
        scene.write(&self.out, &gaussians, &labels, &scene.classes)?;
        terminal::say(&format!(
            "{}: {} of {} Gaussians; turns and moves: {}",
            self.out.display(),
            rows.len(),
            scene.labels.len(),
            motions.len()
        ));
        Ok(())
    }

    /// Rows and motions of the objects that stay: first turns, then moves, in the order of the command line.
    fn motions(
        &self,
        scene: &ObjectScene,
        stays: &dyn Fn(u16) -> bool,
    ) -> Result<Vec<(Vec<u32>, Motion)>> {
        let still = Motion {
            rotation: DQuat::IDENTITY,
            pivot: DVec3::ZERO,
            translation: DVec3::ZERO,
        };
        let mut motions = Vec::new();
        let mut add = |what: &str, flag: &str, motion: &dyn Fn(&Object) -> Motion| {
            let staying = scene
                .find(what, flag)?
                .into_iter()
                .filter(|object| stays(object.id));
            let before = motions.len();
            motions.extend(staying.map(|object| (object.rows.clone(), motion(object))));
            ensure!(motions.len() > before, argument "{flag}"; found "{what}";
                expected "an object that is neither removed nor left out"; help "leave it out, or keep the object");
            Ok(())
        };
        for (what, rotation) in &self.turn {
            add(what, "--turn", &|object| Motion {
                rotation: *rotation,
                pivot: object.center(),
                ..still
            })?;
        }
        let farthest = MAX_MOVE * diagonal(&scene.ply.gaussians);
        for (what, translation) in &self.moves {
            ensure!(farthest <= 0.0 || translation.length() <= farthest,
                argument "--move"; found "{what}={translation}"; expected "at most {farthest:.3e} world units";
                help "move by less: positions that far away lose digits");
            add(what, "--move", &|_| Motion {
                translation: *translation,
                ..still
            })?;
        }
        Ok(motions)
    }
}

/// Diagonal of the box around all centres.
fn diagonal(gaussians: &Gaussians) -> f64 {
    let centres = gaussians
        .means
        .iter()
        .map(|mean| DVec3::from(mean.map(f64::from)));
    let corners = centres
        .map(|c| (c, c))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    corners.map_or(0.0, |(low, high)| (high - low).length())
}
