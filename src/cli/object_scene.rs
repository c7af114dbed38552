//! Arguments of commands that work on objects: a labelled scene, and where to write another.

use super::terminal;
use clap::Args;
use coseg::data::Classes;
use coseg::error::Result;
use coseg::files::extension;
use coseg::runs::{ObjectScene, read_scene, scene_output, scene_path};
use std::path::PathBuf;

/// Arguments that name the scene and its classes.
#[derive(Args, Debug)]
pub struct ObjectSceneArgs {
    /// Scene with labels: a PLY, .spz or .splat file, or a run folder
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

/// Arguments that name what a command writes.
#[derive(Args, Debug)]
pub struct OutArgs {
    /// PLY file to write, or a folder for a scene.ply
    #[arg(long, value_name = "FILE.ply|DIR")]
    out: PathBuf,
    /// Write over the scene itself, or over files that this command did not write
    #[arg(long)]
    force: bool,
}

impl OutArgs {
    /// The folder that the scene is written into.
    pub fn folder(&self) -> PathBuf {
        if self.out.is_dir() || extension(&self.out).is_empty() {
            return self.out.clone();
        }
        self.out.with_file_name("")
    }

    /// The .ply file to write, where a scene with labels of `classes` may be written there, see [`scene_output`]. Says so if it is
    /// written over.
    pub fn check(
        &self,
        input: &ObjectSceneArgs,
        scene: &ObjectScene,
        classes: &Classes,
    ) -> Result<PathBuf> {
        let out = self.file(input, scene, classes)?;
        if out.is_file() {
            terminal::note(&format!("writing over {}", out.display()));
        }
        Ok(out)
    }

    /// The same, without a word.
    pub fn file(
        &self,
        input: &ObjectSceneArgs,
        scene: &ObjectScene,
        classes: &Classes,
    ) -> Result<PathBuf> {
        let inputs = (scene.path.as_path(), input.classes.as_deref());
        scene_output(&self.out, self.force, inputs, classes)
    }
}
