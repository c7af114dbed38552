//! `coseg objects`: the objects of a labelled scene, and the one that a pixel shows.

use super::object_scene::ObjectSceneArgs;
use super::{terminal, values};
use clap::Args;
use coseg::data::NamedCamera;
use coseg::error::Result;
use coseg::objects::{Object, pick};
use coseg::raster::{Projected, Settings};
use coseg::runs::{ObjectScene, cameras_for, cameras_path, frame_with_pixel, rendering_beside};
use glam::DVec3;
use serde_json::json;
use std::path::PathBuf;

const HELP: &str = "\
Without --pixel: every label of the scene with its name, number of Gaussians, and the centre and size of its box in
world units. A box leaves out the outermost 1 % of the centres on each side, at least one if there are three or more.
--json: id, name, gaussians, and the corners low and high of the box.

With --frame and --pixel: the label that covers most of that pixel, its share of the pixel, and where its Gaussians are.
--json: id, name, share, point; null if there is no Gaussian.

Examples:
  coseg objects --scene runs/room
  coseg objects --scene runs/room --frame test_001 --pixel 240,180
  coseg objects --scene other/scene.ply --cameras scenes/room --frame test_001 --pixel 240,180 --json";

/// Arguments of `coseg objects`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct ObjectsArgs {
    #[command(flatten)]
    input: ObjectSceneArgs,
    /// Cameras, as `coseg render` takes them [default: cameras.json beside the scene]
    #[arg(
        long,
        value_name = "FILE.json|DIR",
        requires = "frame",
        requires = "pixel"
    )]
    cameras: Option<PathBuf>,
    /// Frame: its name or the path of its photo, with or without extension
    #[arg(long, value_name = "STEM", requires = "pixel")]
    frame: Option<String>,
    /// Column and row of a pixel, from 0 at the top left
    #[arg(long, value_name = "X,Y", requires = "frame", value_parser = values::pixel, allow_hyphen_values = true)]
    pixel: Option<[usize; 2]>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl ObjectsArgs {
    /// Lists, or picks.
    pub fn run(self) -> Result<()> {
        let scene = self.input.read()?;
        match (&self.frame, self.pixel) {
            (Some(frame), Some(pixel)) => self.pick(&scene, frame, pixel),
            _ => {
                self.list(&scene);
                Ok(())
            }
        }
    }

    fn list(&self, scene: &ObjectScene) {
        let origin = scene.ply.origin;
        if self.json {
            let entry = |o: &Object| {
                let [low, high] = [o.low, o.high].map(|corner| corner + origin);
                json!({"id": o.id, "name": scene.name(o.id), "gaussians": o.rows.len(), "low": low, "high": high})
            };
            let entries: Vec<_> = scene.objects.iter().map(entry).collect();
            terminal::say_lines(&format!("{:#}", json!(entries)));
            return;
        }
        let names = scene.objects.iter().map(|o| shown(scene, o.id));
        let width = names.map(|name| name.chars().count()).max();
        let width = width.unwrap_or(0).max(4);
        terminal::say(&format!(
            "{:>5}  {:width$}  {:>9}  {:>8} {:>8} {:>8}  {:>7} {:>7} {:>7}",
            "id", "name", "Gaussians", "centre x", "y", "z", "size x", "y", "z"
        ));
        for o in &scene.objects {
            let name = shown(scene, o.id);
            let count = o.rows.len();
            let center = three(o.center() + origin, 8);
            let size = three(o.high - o.low, 7);
            terminal::say(&format!(
                "{:>5}  {name:width$}  {count:>9}  {center}  {size}",
                o.id
            ));
        }
    }

    fn pick(&self, scene: &ObjectScene, frame: &str, [x, y]: [usize; 2]) -> Result<()> {
        let file = cameras_path(self.cameras.as_deref(), &scene.path)?;
        let frames = cameras_for(&scene.path, &file, None)?;
        let NamedCamera {
            name: frame,
            camera,
            ..
        } = frame_with_pixel(&frames, frame, [x, y])?;
        let camera = camera.moved(-scene.ply.origin);
        let settings = Settings::from(&rendering_beside(&scene.path).raster);
        let projected = Projected::new(&scene.ply.gaussians.splats(), &camera, &settings)?;
        let picked = pick(&projected, &scene.ply.gaussians, &scene.labels, [x, y]);
        let world = |point: DVec3| point + scene.ply.origin;
        let line = match picked {
            None if self.json => "null".to_owned(),
            None => format!("{frame} {x},{y}: no Gaussian"),
            Some(p) if self.json => {
                let point = world(p.point).to_array();
                format!(
                    "{:#}",
                    json!({"id": p.id, "name": scene.name(p.id), "share": p.weight, "point": point})
                )
            }
            Some(p) => {
                let at = world(p.point);
                format!(
                    "{frame} {x},{y}: {} {}, {:.0} % of the pixel, at x {:.2}, y {:.2}, z {:.2}",
                    p.id,
                    shown(scene, p.id),
                    100.0 * p.weight,
                    at.x,
                    at.y,
                    at.z
                )
            }
        };
        terminal::say_lines(&line);
        Ok(())
    }
}

/// The name of a label, or `-`.
fn shown(scene: &ObjectScene, id: u16) -> &str {
    scene.name(id).unwrap_or("-")
}

/// Three numbers, each at least `width` wide.
fn three(v: DVec3, width: usize) -> String {
    format!("{:>width$.2} {:>width$.2} {:>width$.2}", v.x, v.y, v.z)
}
