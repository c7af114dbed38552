//! `coseg edit`: objects of a labelled scene kept, removed, turned, moved and painted.

use super::object_scene::{ObjectScene, ObjectSceneArgs};
use super::scene_file::bring_cameras;
use super::terminal;
use clap::Args;
use coseg::error::{Error, Result};
use coseg::objects::Object;
use coseg::splat::{Gaussians, Motion, ply};
use glam::{DQuat, DVec3};
use std::path::PathBuf;

const HELP: &str = "\
OBJECT is a label id or a name, as `coseg objects` lists them; all objects of a name are meant, and of associated
objects a class names all of its (chair: chair 1, chair 2). A name with a comma needs its id. First what is not kept
goes, then what is removed; of what is left objects turn, then they move. Turns are counter-clockwise as seen from the
tip of the axis, which may be a direction as the viewer tells it (chair=0.02:-0.98:0.17,30): few COLMAP scenes have
an axis of the world upright. The axis goes through the middle of the object's box; view-dependent colours turn with
their object. The new file keeps its labels, and gets their names beside it as classes.json, and a copy of the scene's
cameras.json, unless they are there.

What a scene's photos never showed, such as the floor below a sofa, is not there when the object is gone.

Examples:
  coseg edit --scene runs/room/scene.ply --out without/scene.ply --remove sofa,table
  coseg edit --scene runs/room/scene.ply --out lamp/scene.ply --keep lamp
  coseg edit --scene runs/room/scene.ply --out moved/scene.ply --turn chair=z,90 --move chair=0.5,0,0
  coseg edit --scene runs/room/scene.ply --out painted/scene.ply --paint";

/// How far objects move at most, in diagonals of the scene: positions are f32.
const FARTHEST: f64 = 100.0;

/// Arguments of `coseg edit`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct EditArgs {
    #[command(flatten)]
    input: ObjectSceneArgs,
    /// PLY file to write
    #[arg(long, value_name = "FILE.ply")]
    out: PathBuf,
    /// Keep these objects alone; may be repeated
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
    /// Colour every Gaussian as its object, so that viewers that read no labels show them
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
            direction => numbers(direction, ':')?.try_normalize()?,
        };
        let degrees = degrees
            .trim()
            .parse::<f64>()
            .ok()
            .filter(|d| d.is_finite())?;
        Some((
            object.to_owned(),
            DQuat::from_axis_angle(axis, degrees.to_radians()),
        ))
    };
    let expected = "expected an object, x, y, z or a direction, and degrees, for instance chair=z,90 or chair=0.1:-0.99:0.05,90";
    parse().ok_or_else(|| expected.into())
}

/// Three finite numbers.
fn numbers(text: &str, separator: char) -> Option<DVec3> {
    let values: Option<Vec<f64>> = text
        .split(separator)
        .map(|v| v.trim().parse().ok())
        .collect();
    let values = DVec3::from(<[f64; 3]>::try_from(values?).ok()?);
    values.is_finite().then_some(values)
}

fn parse_move(text: &str) -> std::result::Result<(String, DVec3), String> {
    let parse = || {
        let (object, offset) = text.rsplit_once('=')?;
        Some((object.to_owned(), numbers(offset, ',')?))
    };
    parse().ok_or_else(|| "expected an object and three numbers, for instance chair=0.5,0,0".into())
}

impl EditArgs {
    /// Edits and writes.
    pub fn run(self) -> Result<()> {
        let mut scene = self.input.read()?;
        let [kept, removed] = [
            scene.ids(&self.keep, "--keep")?,
            scene.ids(&self.remove, "--remove")?,
        ];
        let names = self.input.names_beside(&self.out, &scene, &scene.classes)?;
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
        if rows.is_empty() {
            let help = "keep an object, or remove fewer";
            return Err(Error::argument(
                "--keep, --remove",
                "no Gaussian left",
                "one or more",
                help,
            ));
        }
        let labels: Vec<u16> = rows.iter().map(|&row| scene.labels[row as usize]).collect();
        let mut gaussians = scene.ply.gaussians.select(&rows);
        if self.paint {
            gaussians =
                gaussians.painted(&labels.iter().map(|&id| scene.color(id)).collect::<Vec<_>>());
        }
        ply::write(&self.out, &gaussians, scene.ply.origin, Some(&labels))?;
        if !scene.classes.is_empty() && !names.exists() {
            scene.classes.write(&names)?;
        }
        bring_cameras(&scene.path, &self.out)?;
        let (left, before, out) = (rows.len(), scene.labels.len(), self.out.display());
        terminal::say(&format!(
            "{out}: {left} of {before} Gaussians, {} turns and moves",
            motions.len()
        ));
        Ok(())
    }

    /// Rows and motions of objects that stay: turns before moves, each in the order of the command line.
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
            if motions.len() == before {
                let help = "leave it out, or keep the object";
                return Err(Error::argument(
                    flag,
                    what,
                    "an object that is neither removed nor left out",
                    help,
                ));
            }
            Ok(())
        };
        for (what, rotation) in &self.turn {
            add(what, "--turn", &|object| Motion {
                rotation: *rotation,
                pivot: object.center(),
                ..still
            })?;
        }
        let farthest = FARTHEST * diagonal(&scene.ply.gaussians);
        for (what, translation) in &self.moves {
            if farthest > 0.0 && translation.length() > farthest {
                let (found, expected) = (
                    format!("{what}={translation}"),
                    format!("at most {farthest:.3e} world units"),
                );
                let help = "positions so far off would lose their digits: move by less";
                return Err(Error::argument("--move", found, expected, help));
            }
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
