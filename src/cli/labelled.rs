//! A trained scene and a folder with raw labels: the input of commands that label Gaussians.

use super::{BackendArgs, Settings};
use burn::tensor::Device;
use clap::Args;
use coseg::config::Config;
use coseg::data::{self, LoadOptions, Scene};
use coseg::error::{Result, ensure};
use coseg::files::{atomic, extension, own};
use coseg::runs::{CAMERAS, CLASSES, SCENE, load_both, scene_path};
use coseg::splat::ply::PlyScene;
use std::path::PathBuf;

/// Arguments that name both, and where to write.
#[derive(Args, Debug)]
pub struct LabelledArgs {
    /// Scene, a PLY, .spz, .sog or .splat file, or its folder
    #[arg(long, value_name = "FILE|DIR")]
    pub scene: PathBuf,
    /// Scene folder: photos, cameras, raw labels
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Folder to write to; made if absent
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub backend: BackendArgs,
    #[command(flatten)]
    settings: Settings,
}

impl LabelledArgs {
    /// The settings.
    pub fn config(&self) -> Result<Config> {
        self.settings.load(Some(&self.data))
    }

    /// Reads both, the scene relative to the origin of the Gaussians. Refuses an output folder, or one of its `folders`, that
    /// has files which `coseg` did not write.
    pub fn read(
        &self,
        config: &Config,
        device: &Device,
        folders: &[&str],
    ) -> Result<(Scene, PlyScene)> {
        ensure!(extension(&self.out) != "ply", argument "--out"; found "{}", self.out.display();
            expected "a folder, into which {SCENE} is written"; help "leave out the ending .ply");
        let options = LoadOptions::from(config);
        data::locate(&self.data, &options)?;
        let outputs = [self.out.as_path(), &self.out.join("labels")];
        data::check_outputs("--out", &outputs, Some((&self.data, &options)))?;
        let path = scene_path(&self.scene)?;
        ensure!(!atomic::same_file(&path, &self.out.join(SCENE)),
            argument "--out"; found "{}", self.out.display();
            expected "a folder other than that of the scene, which would be written over"; help "name a new folder");
        for name in [SCENE, CLASSES, CAMERAS] {
            own::check(self.out.join(name))?;
        }
        for name in folders {
            own::check_folder(self.out.join(name))?;
        }
        load_both(&self.data, &self.scene, config, device)
    }
}
