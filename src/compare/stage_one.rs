//! The Gaussians of a scene that all of its cells share: trained once, or taken from a file.

use super::Options;
use super::cells::HELP;
use super::plan::{Plan, SceneFolder};
use crate::config::{BuildingConfig, Config};
use crate::error::{Result, bail};
use crate::files::{self, atomic};
use crate::pipeline::{self, load_scene};
use crate::progress::{Event, Progress};
use crate::provenance::Provenance;
use crate::splat::{Gaussians, ply};
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The Gaussians of a scene.
pub(super) struct SharedGaussians {
    /// The PLY in the folder of the comparison.
    pub file: PathBuf,
    /// The Gaussians of that file.
    pub gaussians: Gaussians,
}

impl SharedGaussians {
    /// The Gaussians of `scene`. Trains them or takes them from the file that `options` name, unless an earlier call did.
    ///
    /// # Errors
    /// [`crate::Error::Config`] and [`crate::Error::Input`] for Gaussians of other settings or photos, or from another file; those
    /// of [`pipeline::run`].
    pub fn of(
        scene: &SceneFolder,
        plan: &Plan,
        options: &Options,
        device: &Device,
        progress: &mut dyn Progress,
    ) -> Result<Self> {
        let folder = options.out.join("scenes").join(&scene.name);
        let record = folder.join("stage_one.json");
        let named = options.gaussians.get(&scene.name);
        let named = named.map(|path| files::absolute(path)).transpose()?;
        if record.exists() {
            let done: Record = files::json(&record, "what `coseg compare` says of stage one")?;
            done.check(&record, scene, plan, named.as_deref())?;
        } else {
            progress.event(&Event::Begun(format!("{}: Gaussians", scene.name)));
            let config = settings(plan, scene, named.as_deref())?;
            let outcome = pipeline::run(&config, &folder, device, progress)?;
            let done = Record {
                initial_scene: named,
                commit: options.commit.clone(),
                command: options.command.clone(),
                device: options.device.clone(),
                gaussians: outcome.gaussians.len(),
                psnr: outcome.test.psnr,
                ssim: outcome.test.ssim,
                seconds: outcome.seconds.building,
                provenance: Provenance::stage_one(&config, &outcome.scene),
            };
            atomic::write_json(&record, &done)?;
        }
        let file = folder.join("scene.ply");
        let gaussians = ply::read(&file)?.gaussians;
        Ok(Self { file, gaussians })
    }
}

/// Settings of stage one of `scene`, on the Gaussians of `file` if there is one.
fn settings(plan: &Plan, scene: &SceneFolder, file: Option<&Path>) -> Result<Config> {
    let mut config = plan.stage_one(scene)?;
    if let Some(file) = file {
        config.building = BuildingConfig::taking(file.to_owned());
    }
    Ok(config)
}

/// Where the Gaussians of a scene come from, as its folder records it.
#[derive(Serialize, Deserialize)]
struct Record {
    /// The file that they were taken from; absent where they were trained.
    // Tables of earlier commits are continued.
    #[serde(rename = "given")]
    initial_scene: Option<PathBuf>,
    commit: String,
    command: String,
    device: String,
    gaussians: usize,
    psnr: Option<f64>,
    ssim: Option<f64>,
    /// Seconds of stage one.
    seconds: f64,
    provenance: Provenance,
}

impl Record {
    /// Checks that the Gaussians belong to `plan` and, if `named` is given, come from that file. `path` is the file of the record.
    fn check(
        &self,
        path: &Path,
        scene: &SceneFolder,
        plan: &Plan,
        named: Option<&Path>,
    ) -> Result<()> {
        let origin = match &self.initial_scene {
            Some(file) => file.display().to_string(),
            None => "trained ones".to_owned(),
        };
        if let Some(named) = named.filter(|named| self.initial_scene.as_deref() != Some(named)) {
            bail!(path, "Gaussians"; found "{origin}"; expected "{}", named.display();
                help "leave out --gaussians for this scene, or choose another --out");
        }
        let config = settings(plan, scene, self.initial_scene.as_deref())?;
        let of_plan = Provenance::stage_one(&config, &load_scene(&config)?);
        of_plan.check(&self.provenance, false, path, Some(HELP))
    }
}
