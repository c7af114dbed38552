//! `coseg edit`: objects of a labelled scene kept, removed, turned and moved.

use super::object_scene::{ObjectScene, ObjectSceneArgs};
use super::terminal;
use clap::Args;
use coseg::error::{Error, Result};
use coseg::gaussians::{Motion, ply};
use glam::{DQuat, DVec3};
use std::path::PathBuf;

const HELP: &str = "\
OBJECT is a label id or a name, as `coseg objects` lists them; all objects of a name are meant. First what is not kept
goes, then what is removed, then objects turn, then they move. View-dependent colours turn with their object. The new
file keeps its labels, and gets the names beside it as classes.json where there is none yet.

What a scene's photos never showed, such as the floor below a sofa, is not there when the object is gone.

Examples:
  coseg edit --scene runs/room/scene.ply --out without.ply --remove sofa,table
  coseg edit --scene runs/room/scene.ply --out lamp.ply --keep lamp
  coseg edit --scene runs/room/scene.ply --out moved.ply --turn chair=z,90 --move chair=0.5,0,0";

/// Arguments of `coseg edit`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct EditArgs {
    #[command(flatten)]
    input: ObjectSceneArgs,
    /// File to write
    #[arg(long, value_name = "FILE.ply")]
    out: PathBuf,
    /// Keep these objects alone; may be repeated
    #[arg(long, value_name = "OBJECT,...", value_delimiter = ',')]
    keep: Vec<String>,
    /// Remove these objects; may be repeated
    #[arg(long, value_name = "OBJECT,...", value_delimiter = ',')]
    remove: Vec<String>,
    /// Turn an object about an axis of the world, x, y or z, through the centre of its box; may be repeated
    #[arg(long, value_name = "OBJECT=AXIS,DEGREES", value_parser = parse_turn)]
    turn: Vec<(String, DQuat)>,
    /// Move an object, world units; may be repeated
    #[arg(long = "move", value_name = "OBJECT=X,Y,Z", value_parser = parse_move)]
    moves: Vec<(String, DVec3)>,
}

fn parse_turn(text: &str) -> std::result::Result<(String, DQuat), String> {
    let parse = || {
        let (object, turn) = text.rsplit_once('=')?;
        let (axis, degrees) = turn.split_once(',')?;
        let axis = match axis.trim() {
            "x" => DVec3::X,
            "y" => DVec3::Y,
            "z" => DVec3::Z,
            _ => return None,
        };
        let degrees = degrees.trim().parse::<f64>().ok().filter(|d| d.is_finite())?;
        Some((object.to_owned(), DQuat::from_axis_angle(axis, degrees.to_radians())))
    };
    parse().ok_or_else(|| "expected an object, x, y or z, and degrees, for instance chair=z,90".into())
}

fn parse_move(text: &str) -> std::result::Result<(String, DVec3), String> {
    let parse = || {
        let (object, offset) = text.rsplit_once('=')?;
        let values: Option<Vec<f64>> = offset.split(',').map(|v| v.trim().parse().ok()).collect();
        let offset = DVec3::from(<[f64; 3]>::try_from(values?).ok()?);
        offset.is_finite().then(|| (object.to_owned(), offset))
    };
    parse().ok_or_else(|| "expected an object and three numbers, for instance chair=0.5,0,0".into())
}

impl EditArgs {
    /// Edits and writes.
    pub fn run(self) -> Result<()> {
        let mut scene = self.input.read()?;
        let [kept, removed] =
            [(&self.keep, "--keep"), (&self.remove, "--remove")].map(|(list, flag)| ids(&scene, list, flag));
        let (kept, removed) = (kept?, removed?);
        let motions = self.motions(&scene)?;
        for (rows, motion) in &motions {
            motion.apply(&mut scene.ply.gaussians, rows);
        }
        let stays = |id: u16| (self.keep.is_empty() || kept.contains(&id)) && !removed.contains(&id);
        let rows: Vec<u32> = (0..).zip(&scene.labels).filter(|&(_, &id)| stays(id)).map(|(row, _)| row).collect();
        if rows.is_empty() {
            let mend = "keep an object, or remove fewer";
            return Err(Error::config("--keep, --remove", "no Gaussian left", "one or more", mend));
        }
        let labels: Vec<u16> = rows.iter().map(|&row| scene.labels[row as usize]).collect();
        ply::write(&self.out, &scene.ply.gaussians.select(&rows), scene.ply.origin, Some(&labels))?;
        let names = self.out.with_file_name("classes.json");
        if !scene.classes.is_empty() && !names.exists() {
            scene.classes.write(&names)?;
        }
        let (left, before) = (rows.len(), scene.labels.len());
        terminal::say(&format!("{}: {left} of {before} Gaussians, {} motions", self.out.display(), motions.len()));
        Ok(())
    }

    /// Rows and motions: turns before moves, each in the order of the command line.
    fn motions(&self, scene: &ObjectScene) -> Result<Vec<(Vec<u32>, Motion)>> {
        let mut motions = Vec::new();
        for (what, rotation) in &self.turn {
            for object in scene.find(what, "--turn")? {
                let motion = Motion { rotation: *rotation, pivot: object.center(), translation: DVec3::ZERO };
                motions.push((object.rows.clone(), motion));
            }
        }
        for (what, translation) in &self.moves {
            for object in scene.find(what, "--move")? {
                let motion = Motion { rotation: DQuat::IDENTITY, pivot: DVec3::ZERO, translation: *translation };
                motions.push((object.rows.clone(), motion));
            }
        }
        Ok(motions)
    }
}

/// Ids of the objects that `list` names.
fn ids(scene: &ObjectScene, list: &[String], flag: &str) -> Result<Vec<u16>> {
    let mut ids = Vec::new();
    for what in list {
        ids.extend(scene.find(what, flag)?.iter().map(|object| object.id));
    }
    Ok(ids)
}
