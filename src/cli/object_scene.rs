//! Arguments of commands that work on objects: a labelled scene, and where to write another.

use super::terminal;
use clap::Args;
use coseg::data::Classes;
use coseg::error::Result;
use coseg::files::{extension, folder};
use coseg::objects::Edited;
use coseg::runs::{Cameras, ObjectScene, read_scene, scene_output, scene_path};
use std::path::PathBuf;

/// Arguments that name the scene and its classes.
#[derive(Args, Debug)]
pub struct ObjectSceneArgs {
    /// Scene with labels: a PLY, .spz, .sog or .splat file, or a run folder
    #[arg(long, value_name = "FILE|RUN")]
    pub scene: PathBuf,
    /// Names of the labels [default: classes.json beside the scene, if it is there]
    #[arg(long, value_name = "FILE.json")]
    pub classes: Option<PathBuf>,
}

impl ObjectSceneArgs {
    /// Reads both.
    pub fn read(&self) -> Result<ObjectScene> {
        let path = scene_path(&self.scene)?;
        let ply = read_scene(&path)?;
        ObjectScene::new(path, ply, self.classes.as_deref())
    }

    /// Reads both. Gaussians of a scene without labels are unlabelled.
    pub fn read_or_unlabelled(&self) -> Result<ObjectScene> {
        let path = scene_path(&self.scene)?;
        let ply = read_scene(&path)?;
        ObjectScene::or_unlabelled(path, ply, self.classes.as_deref())
    }
}

/// Arguments that name a scene, and where the one that a command makes of it is written.
#[derive(Args, Debug)]
pub struct EditedSceneArgs {
    #[command(flatten)]
    pub from: ObjectSceneArgs,
    /// PLY file to write, or a folder for a scene.ply
    #[arg(long, value_name = "FILE.ply|DIR")]
    out: PathBuf,
    /// Write over the scene itself, or over files that this command did not write
    #[arg(long)]
    force: bool,
}

impl EditedSceneArgs {
    /// The folder that the scene is written into.
    pub fn folder(&self) -> PathBuf {
        if self.out.is_dir() || extension(&self.out).is_empty() {
            return self.out.clone();
        }
        folder(&self.out).to_owned()
    }

    /// The .ply file to write, where a scene with labels of `classes` may be written there, see [`scene_output`].
    pub fn file(&self, scene: &ObjectScene, classes: &Classes) -> Result<PathBuf> {
        let inputs = (scene.path.as_path(), self.from.classes.as_deref());
        scene_output(&self.out, self.force, inputs, classes)
    }

    /// Writes what was made of `scene`, with `cameras`, and returns the .ply file. Says so if that is written over.
    pub fn write(&self, scene: &ObjectScene, edited: &Edited, cameras: Cameras) -> Result<PathBuf> {
        let out = self.file(scene, &edited.classes)?;
        if out.is_file() {
            terminal::note(&format!("writing over {}", out.display()));
        }
        scene.write(&out, edited, cameras, self.force)?;
        Ok(out)
    }
}
