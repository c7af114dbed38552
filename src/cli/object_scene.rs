//! A labelled PLY scene with the names of its labels: what commands about objects work on.

use super::scene_file::scene_path;
use clap::Args;
use coseg::data::{Classes, Limits, atomic};
use coseg::error::{Error, Result};
use coseg::objects::{Object, inventory};
use coseg::splat::ply;
use coseg::splat::ply::PlyScene;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Arguments that name both.
#[derive(Args, Debug)]
pub struct ObjectSceneArgs {
    /// Scene: a 3DGS PLY with a `label` column, as vote and associate write it, or a run folder
    #[arg(long, value_name = "FILE.ply|RUN")]
    scene: PathBuf,
    /// Names of the labels [default: classes.json beside the scene, if it is there]
    #[arg(long, value_name = "FILE.json")]
    classes: Option<PathBuf>,
}

/// Objects that an error names at most.
const NAMED: usize = 20;

/// A labelled scene.
pub struct ObjectScene {
    /// The PLY file.
    pub path: PathBuf,
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
        let path = scene_path(&self.scene)?;
        let ply = ply::read(&path, &Limits::default())?;
        ObjectScene::new(path, ply, self.classes.as_ref())
    }

    /// Where the names of labels `classes` go beside a scene written to `out`. Neither what is read, `scene` and the names given for
    /// it, nor the class table of other labels is written over.
    pub fn names_beside(
        &self,
        out: &Path,
        scene: &ObjectScene,
        classes: &Classes,
    ) -> Result<PathBuf> {
        let names = out.with_file_name("classes.json");
        let read = [Some(&scene.path), self.classes.as_ref()];
        if read
            .into_iter()
            .flatten()
            .any(|path| atomic::same_file(path, out))
            || out == names
        {
            let expected = "another file than the scene and its classes.json";
            return Err(Error::argument(
                "--out",
                out.display().to_string(),
                expected,
                "name a new file",
            ));
        }
        if !out
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("ply"))
        {
            let help = "end the name in .ply; other tools convert that to their formats";
            return Err(Error::argument(
                "--out",
                out.display().to_string(),
                "a .ply file",
                help,
            ));
        }
        if names.exists() && Classes::read(&names)? != *classes {
            let (found, help) = ("another class table", "write into another folder");
            return Err(Error::input(
                &names,
                "classes",
                found,
                "that of the scene's labels, or no file",
                help,
            ));
        }
        Ok(names)
    }
}

impl ObjectScene {
    /// What was read from `path`, with the names in the file `classes`, or else in the one beside it.
    pub fn new(path: PathBuf, mut ply: PlyScene, classes: Option<&PathBuf>) -> Result<Self> {
        let Some(labels) = ply.labels.take() else {
            let help = "give the scene labels with `coseg vote` or `coseg train`";
            return Err(Error::input(
                path,
                "column label",
                "nothing",
                "one label a Gaussian",
                help,
            ));
        };
        let beside = path.with_file_name("classes.json");
        let classes = match classes {
            Some(path) => Classes::read(path)?,
            None if beside.is_file() => Classes::read(&beside)?,
            None => Classes::default(),
        };
        if labels.is_empty() {
            let help = "name a scene that holds something";
            return Err(Error::input(
                path,
                "element vertex",
                "no Gaussian",
                "one or more",
                help,
            ));
        }
        let objects = inventory(&ply.gaussians, &labels);
        Ok(Self {
            path,
            ply,
            labels,
            classes,
            objects,
        })
    }

    /// Corners of a box around the boxes of the objects that `what` means, world units.
    pub fn bounds(&self, what: &str, flag: &str) -> Result<(DVec3, DVec3)> {
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let around = |(low, high): (DVec3, DVec3), object: &Object| {
            (low.min(object.low), high.max(object.high))
        };
        let (low, high) = self.find(what, flag)?.into_iter().fold(none, around);
        Ok((low + self.ply.origin, high + self.ply.origin))
    }

    /// The name of a label, where one is known.
    pub fn name(&self, id: u16) -> Option<&str> {
        self.classes.known_name(id)
    }

    /// The colour of a label in legends, sRGB 0..1.
    pub fn color(&self, id: u16) -> [f32; 3] {
        self.classes.legend_color(id).map(|v| f32::from(v) / 255.0)
    }

    /// The object with the id `what`, or else all that are called so, which for associated objects their class is too: `chair`
    /// for `chair 2`. `flag` is where it was said.
    pub fn find(&self, what: &str, flag: &str) -> Result<Vec<&Object>> {
        let what = what.trim();
        if let Some(object) = what
            .parse()
            .ok()
            .and_then(|id: u16| self.objects.iter().find(|o| o.id == id))
        {
            return Ok(vec![object]);
        }
        let found: Vec<&Object> = self
            .objects
            .iter()
            .filter(|o| self.is_called(o.id, what))
            .collect();
        if !found.is_empty() {
            return Ok(found);
        }
        let known = |o: &Object| {
            self.name(o.id)
                .map_or_else(|| o.id.to_string(), |name| format!("{} {name}", o.id))
        };
        let mut known: Vec<String> = self.objects.iter().take(NAMED).map(known).collect();
        if self.objects.len() > NAMED {
            known.push(format!("or one of {} more", self.objects.len() - NAMED));
        }
        let expected = format!("an id or a name of the scene: {}", known.join(", "));
        Err(Error::argument(
            flag,
            what,
            expected,
            "`coseg objects --scene FILE.ply` lists them",
        ))
    }

    /// Ids of the objects that `list` names; `flag` is where they were said.
    pub fn ids(&self, list: &[String], flag: &str) -> Result<Vec<u16>> {
        let mut ids = Vec::new();
        for what in list {
            ids.extend(self.find(what, flag)?.iter().map(|object| object.id));
        }
        Ok(ids)
    }

    fn is_called(&self, id: u16, what: &str) -> bool {
        let Some(name) = self.name(id) else {
            return false;
        };
        let numbered = self
            .classes
            .index(id)
            .is_some_and(|i| self.classes.entries[i].object_of.is_some_and(|of| of.thing));
        let class = name
            .rsplit_once(' ')
            .filter(|(_, number)| numbered && number.parse::<u32>().is_ok());
        name == what || class.is_some_and(|(class, _)| class == what)
    }
}
