//! A labelled PLY scene with the names of its labels: what commands about objects work on.

use super::scene_file::{CLASSES, SCENE, classes_beside, copy_cameras, read_scene, scene_path};
use clap::Args;
use coseg::data::{Classes, LoadOptions, check_output_file, locate};
use coseg::error::{Error, Result, bail, ensure, invalid};
use coseg::files::{atomic, extension, own, sha256};
use coseg::objects::{Edited, Editing, Edits, Object, inventory};
use coseg::splat::ply::PlyScene;
use coseg::splat::{Gaussians, ply};
use glam::DVec3;
use std::path::{Path, PathBuf};

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

/// Objects that an error lists at most.
const MAX_LISTED: usize = 20;

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
        let ply = read_scene(&path)?;
        ObjectScene::new(path, ply, self.classes.as_ref())
    }

    /// Reads both. Gaussians of a scene without labels are unlabelled.
    pub fn read_or_unlabelled(&self) -> Result<ObjectScene> {
        let path = scene_path(&self.scene)?;
        let mut ply = read_scene(&path)?;
        let ignore = classes_beside(&path, self.classes.as_deref())?.ignore;
        let unlabelled = vec![ignore; ply.gaussians.len()];
        ply.labels.get_or_insert(unlabelled);
        ObjectScene::new(path, ply, self.classes.as_ref())
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
    /// The .ply file to write, where a scene with labels of `classes` may be written there, see [`check_output`].
    pub fn check(
        &self,
        input: &ObjectSceneArgs,
        scene: &ObjectScene,
        classes: &Classes,
    ) -> Result<PathBuf> {
        let is_folder = self.out.is_dir() || extension(&self.out).is_empty();
        let out = if is_folder {
            self.out.join(SCENE)
        } else {
            self.out.clone()
        };
        check_output(&out, self.force, input, &scene.path, classes)?;
        ensure!(extension(&out) == "ply", argument "--out"; found "{}", out.display(); expected "a .ply file";
            help "end the name in .ply; `coseg export` writes other formats");
        Ok(out)
    }
}

/// Refuses to write a scene with labels of `classes` to `out`, made from the scene at `path`. Without `force` it must overwrite
/// neither an input nor a file that this command did not write.
pub fn check_output(
    out: &Path,
    force: bool,
    input: &ObjectSceneArgs,
    path: &Path,
    classes: &Classes,
) -> Result<()> {
    let names = out.with_file_name(CLASSES);
    let is_written = |path: &PathBuf| atomic::same_file(path, out);
    if input.classes.as_ref().is_some_and(is_written) || out == names {
        bail!(argument "--out"; found "{}", out.display();
            expected "another file than the scene and its classes.json"; help "name a new file");
    }
    ensure!(force || !atomic::same_file(path, out), argument "--out"; found "{}", out.display();
        expected "another file than the scene"; help "name a new file, or write over the scene by --force");
    let folder = out.parent().unwrap_or_else(|| Path::new(""));
    check_output_file("--out", out, (folder, &LoadOptions::default()))?;
    if force {
        own::allow(out);
        // The class table of a folder with photos is the truth of that scene.
        if locate(folder, &LoadOptions::default()).is_err() {
            own::allow(&names);
        }
    }
    ensure!(has_table(&names, classes)? || own::check(&names).is_ok(),
        &names, "classes"; found "another class table"; expected "that of the scene's labels, or no file";
        help "write into another folder, or write over it by --force, except in a folder with photos");
    ensure!(own::check(out).is_ok(), argument "--out"; found "{}, which this command did not write", out.display();
        expected "a new file, or one that this command wrote"; help "name another file, or write over it by --force");
    Ok(())
}

/// Whether the file `names` is there and has `classes`, or neither is.
pub fn has_table(names: &Path, classes: &Classes) -> Result<bool> {
    if !names.exists() {
        return Ok(classes.is_empty());
    }
    Ok(Classes::read(names)? == *classes)
}

/// Makes the file `names` say what the labels of a new scene mean. Without `classes` an older file goes.
pub fn write_classes(classes: &Classes, names: &Path) -> Result<()> {
    if has_table(names, classes)? {
        return Ok(());
    }
    if classes.is_empty() {
        return atomic::remove(names);
    }
    classes.write(names)
}

impl ObjectScene {
    /// A scene read from `path`, with the names in the file `classes`, or else in the one beside it.
    pub fn new(path: PathBuf, mut ply: PlyScene, classes: Option<&PathBuf>) -> Result<Self> {
        let Some(labels) = ply.labels.take() else {
            return Err(without_labels(&path));
        };
        let classes = classes_beside(&path, classes.map(PathBuf::as_path))?;
        let objects = inventory(&ply.gaussians, &labels);
        Ok(Self {
            path,
            ply,
            labels,
            classes,
            objects,
        })
    }

    /// The scene after `edits`, which must belong to its file.
    pub fn edited(&self, mut editing: Editing, edits: &Edits) -> Result<Edited> {
        edits.apply(&mut editing, &sha256(&self.path)?, self.ply.origin)?;
        editing.finish("--edits")
    }

    /// Writes a scene made from this one, with `classes` as classes.json and a copy of the cameras beside it.
    pub fn write(
        &self,
        out: &Path,
        gaussians: &Gaussians,
        labels: &[u16],
        classes: &Classes,
    ) -> Result<()> {
        ply::write(out, gaussians, self.ply.origin, Some(labels))?;
        write_classes(classes, &out.with_file_name(CLASSES))?;
        copy_cameras(&self.path, out)
    }

    /// Corners of a box around the objects called `what`, world units.
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

    /// The object with the id `what`, or all objects with that name or, for associated objects, that class: `chair` finds
    /// `chair 2`. `flag` is the option that errors name.
    pub fn find(&self, what: &str, flag: &str) -> Result<Vec<&Object>> {
        let what = what.trim();
        let id: Option<u16> = what.parse().ok();
        if let Some(object) = self.objects.iter().find(|o| Some(o.id) == id) {
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
        let listed = |o: &Object| format!("{} {}", o.id, self.name(o.id).unwrap_or_default());
        let listed = self.objects.iter().take(MAX_LISTED).map(listed);
        let mut listed: Vec<String> = listed.map(|name| name.trim_end().to_owned()).collect();
        if self.objects.len() > MAX_LISTED {
            listed.push(format!(
                "or one of {} more",
                self.objects.len() - MAX_LISTED
            ));
        }
        Err(invalid!(argument "{flag}"; found "{what}";
            expected "an id or a name of the scene: {}", listed.join(", ");
            help "`coseg objects --scene FILE.ply` lists them"))
    }

    /// Ids of the objects in `list`, see [`Self::find`].
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
        let class = self.classes.index(id).map(|i| &self.classes.entries[i]);
        let is_numbered = class.is_some_and(|class| class.object_of.is_some_and(|of| of.thing));
        let class = name
            .rsplit_once(' ')
            .filter(|(_, number)| is_numbered && number.parse::<u32>().is_ok());
        name == what || class.is_some_and(|(class, _)| class == what)
    }
}

/// The error of a scene that needs a label column.
pub fn without_labels(path: &Path) -> Error {
    invalid!(path, "column label"; found "nothing"; expected "one label for each Gaussian";
        help "give the scene labels with `coseg vote` or `coseg train`")
}
