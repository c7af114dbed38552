//! A labelled PLY scene with the names of its labels: what commands about objects work on.

use clap::Args;
use coseg::data::{Classes, Limits};
use coseg::error::{Error, Result};
use coseg::gaussians::ply::{self, PlyScene};
use coseg::objects::{Object, inventory};
use std::path::PathBuf;

/// Arguments that name both.
#[derive(Args, Debug)]
pub struct ObjectSceneArgs {
    /// Scene in the 3DGS PLY convention with a `label` column, as train, vote and associate write it
    #[arg(long, value_name = "FILE.ply")]
    scene: PathBuf,
    /// Names of the labels [default: classes.json beside the scene, if it is there]
    #[arg(long, value_name = "FILE.json")]
    classes: Option<PathBuf>,
}

/// A labelled scene.
pub struct ObjectScene {
    pub ply: PlyScene,
    pub labels: Vec<u16>,
    /// Empty where no names are known.
    pub classes: Classes,
    /// Ascending by id.
    pub objects: Vec<Object>,
}

impl ObjectSceneArgs {
    /// Reads both.
    pub fn read(&self) -> Result<ObjectScene> {
        let mut ply = ply::read(&self.scene, &Limits::default())?;
        let Some(labels) = ply.labels.take() else {
            let mend = "give the scene labels with `coseg vote` or `coseg train`";
            return Err(Error::input(&self.scene, "column label", "nothing", "one label a Gaussian", mend));
        };
        let beside = self.scene.with_file_name("classes.json");
        let classes = match &self.classes {
            Some(path) => Classes::read(path)?,
            None if beside.is_file() => Classes::read(&beside)?,
            None => Classes::default(),
        };
        let objects = inventory(&ply.gaussians, &labels);
        Ok(ObjectScene { ply, labels, classes, objects })
    }
}

impl ObjectScene {
    /// The name of a label, `-` where none is known.
    pub fn name(&self, id: u16) -> &str {
        if self.classes.index(id).is_some() || (id == self.classes.ignore && !self.classes.is_empty()) {
            self.classes.name(id)
        } else {
            "-"
        }
    }

    /// The objects that `what` names: an id, or a name, which several may have. `flag` is where it was said.
    pub fn find(&self, what: &str, flag: &str) -> Result<Vec<&Object>> {
        let by_id = what.parse::<u16>().ok();
        let found: Vec<&Object> =
            self.objects.iter().filter(|o| Some(o.id) == by_id || self.name(o.id) == what).collect();
        if !found.is_empty() {
            return Ok(found);
        }
        let known: Vec<String> = self.objects.iter().map(|o| format!("{} {}", o.id, self.name(o.id))).collect();
        Err(Error::config(
            flag,
            what,
            format!("an id or a name of the scene: {}", known.join(", ")),
            "`coseg objects --scene FILE.ply` lists them",
        ))
    }
}
