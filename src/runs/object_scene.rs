//! A labelled scene with the names of its labels, and where such a scene may be written.

use super::scene_file::{
    CLASSES, FEATURE_COLORS, SCENE, classes_beside, copy_beside, unfinished_run,
};
use super::side_files::{Cameras, SideFiles, has_table};
use crate::data::labels::classes::plain;
use crate::data::{Class, Classes, check_outputs};
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files::{self, atomic, extension, own, sha256};
use crate::objects::{Edited, Editing, Edits, Object, color_apart, inventory};
use crate::splat::formats::{has_labels_beside, label_path};
use crate::splat::ply::PlyScene;
use crate::splat::{Gaussians, bounds, ply};
use glam::DVec3;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Objects that an error lists at most.
const MAX_LISTED: usize = 20;

/// A labelled scene.
#[derive(Clone, Debug)]
pub struct ObjectScene {
    /// The file that it was read from.
    pub path: PathBuf,
    /// The Gaussians and their origin. Its labels are in [`ObjectScene::labels`] alone.
    pub ply: PlyScene,
    /// One id for each Gaussian.
    pub labels: Vec<u16>,
    /// Names of the labels; empty where none are known.
    pub classes: Classes,
    /// What the labels stand for, ascending by id.
    pub objects: Vec<Object>,
}

/// The .ply file that `--out` means: `out` itself, or scene.ply in that folder. A scene with labels of `classes` may be written
/// there, see [`check_output`].
///
/// # Errors
/// As [`check_output`]; [`Error::Argument`] for another extension.
pub fn scene_output(
    out: &Path,
    force: bool,
    inputs: (&Path, Option<&Path>),
    classes: &Classes,
) -> Result<PathBuf> {
    let is_folder = out.is_dir() || extension(out).is_empty();
    let out = if is_folder {
        out.join(SCENE)
    } else {
        out.to_owned()
    };
    check_output(&out, force, inputs, classes)?;
    ensure!(extension(&out) == "ply", argument "--out"; found "{}", out.display(); expected "a .ply file";
        help "end the name in .ply; `coseg export` writes other formats");
    Ok(out)
}

/// Refuses to write a scene with labels of `classes` to `out`, made from the scene at `path` and the class table in the file
/// `table`, if one was given. The folder must hold no files of a scene of photos. Without `force` it must overwrite neither an input
/// nor a file that this command did not write.
///
/// # Errors
/// [`Error::Argument`] or [`Error::Input`] naming what is in the way; [`Error::Io`].
pub fn check_output(
    out: &Path,
    force: bool,
    (path, table): (&Path, Option<&Path>),
    classes: &Classes,
) -> Result<()> {
    let names = out.with_file_name(CLASSES);
    if table.is_some_and(|table| atomic::same_file(table, out)) || out == names {
        bail!(argument "--out"; found "{}", out.display();
            expected "a file other than the scene and its classes.json"; help "name a new file");
    }
    ensure!(force || !atomic::same_file(path, out), argument "--out"; found "{}", out.display();
        expected "a file other than the scene"; help "name a new file, or write over the scene with --force");
    check_outputs("--out", &[files::folder(out)], None)?;
    if force {
        own::allow(out);
        own::allow(&names);
    }
    ensure!(has_table(&names, classes)? || own::check(&names).is_ok(),
        &names, "classes"; found "another class table"; expected "that of the scene's labels, or no file";
        help "write into another folder, or add --force");
    ensure!(own::check(out).is_ok(), argument "--out"; found "{}, which this command did not write", out.display();
        expected "a new file, or one that this command wrote"; help "name another file, or write over it with --force");
    Ok(())
}

/// Writes Gaussians, relative to an origin, with `labels` to `out`, and the files beside it.
///
/// # Errors
/// As [`ply::write`] and [`SideFiles::write`].
pub fn write_scene(
    out: &Path,
    (gaussians, origin): (&Gaussians, DVec3),
    labels: Option<&[u16]>,
    beside: &SideFiles,
) -> Result<()> {
    ply::write(out, gaussians, origin, labels)?;
    beside.write()
}

impl ObjectScene {
    /// A scene read from `path`, with the names in the file `classes`, or else in the one beside it.
    ///
    /// # Errors
    /// [`Error::Input`] for a scene without labels; as [`Classes::read`].
    pub fn new(path: PathBuf, ply: PlyScene, classes: Option<&Path>) -> Result<Self> {
        if ply.labels.is_none() {
            return Err(without_labels(&path));
        }
        Self::or_unlabelled(path, ply, classes)
    }

    /// As [`Self::new`], but Gaussians of a scene without labels are unlabelled.
    ///
    /// # Errors
    /// As [`Classes::read`].
    pub fn or_unlabelled(path: PathBuf, mut ply: PlyScene, classes: Option<&Path>) -> Result<Self> {
        let classes = classes_beside(&path, classes)?;
        let unlabelled = || classes.unlabelled(ply.gaussians.len());
        let labels = ply.labels.take().unwrap_or_else(unlabelled);
        Ok(Self::with_labels(path, ply, labels, classes))
    }

    /// The scene `ply` of the file `path` with these labels.
    ///
    /// # Panics
    /// If `labels` does not have one id for each Gaussian.
    pub fn with_labels(path: PathBuf, ply: PlyScene, labels: Vec<u16>, classes: Classes) -> Self {
        Self {
            objects: inventory(&ply.gaussians, &labels),
            path,
            ply,
            labels,
            classes,
        }
    }

    /// The scene in which the Gaussians `rows` have the label called `name`, for each of `objects` that has rows, and these labels.
    /// A label that is not there yet is made, with a colour of its own. `flag` is the option that errors name.
    ///
    /// # Errors
    /// [`Error::Argument`] where no label is free; as [`color_apart`].
    pub fn named(
        &self,
        objects: &[(&str, &[u32])],
        flag: &str,
    ) -> Result<(Vec<Option<u16>>, Edited)> {
        let gaussians = self.ply.gaussians.clone();
        let mut editing = Editing::new(gaussians, self.labels.clone(), self.classes.clone());
        let mut ids = Vec::with_capacity(objects.len());
        let mut made = BTreeSet::new();
        for (name, rows) in objects {
            if rows.is_empty() {
                ids.push(None);
                continue;
            }
            let known = self
                .classes
                .entries
                .iter()
                .find(|class| class.name == *name);
            let free = || (1..=u16::MAX).find(|id| !editing.is_known(*id));
            let id = known.map_or_else(free, |class| Some(class.id));
            let Some(id) = id else {
                bail!(argument "{flag}"; found "a scene with all labels in use"; expected "a free label";
                    help "name an object that is there");
            };
            if known.is_none() {
                editing.entry(id).name = (*name).to_owned();
                made.insert(id);
            }
            editing.assign(rows, id);
            ids.push(Some(id));
        }
        let mut edited = editing.finish(flag)?;
        if !made.is_empty() {
            let classes = &mut edited.classes;
            color_apart(&edited.gaussians, &edited.labels, classes, &made)?;
        }
        Ok((ids, edited))
    }

    /// The scene after `edits`, which must belong to its file.
    ///
    /// # Errors
    /// As [`Edits::apply`] and [`Editing::finish`].
    pub fn edited(&self, mut editing: Editing, edits: &Edits) -> Result<Edited> {
        edits.apply(&mut editing, &sha256(&self.path)?, self.ply.origin)?;
        editing.finish("--edits")
    }

    /// Writes a scene made from this one, with its classes as classes.json and `cameras` as cameras.json beside it, where these would
    /// replace none of another scene, or with `force`. A scene.ply from which no Gaussian was removed has a copy of the image features
    /// too.
    ///
    /// # Errors
    /// As [`SideFiles::check`] and [`write_scene`].
    pub fn write(&self, out: &Path, edited: &Edited, cameras: Cameras, force: bool) -> Result<()> {
        let beside = SideFiles {
            scenes: &[out],
            classes: Some(&edited.classes),
            cameras,
        };
        beside.check(Some(force))?;
        let gaussians = (&edited.gaussians, self.ply.origin);
        write_scene(out, gaussians, Some(&edited.labels), &beside)?;
        // The features in a folder are those of its scene.ply.
        if out.file_name().is_none_or(|name| name != SCENE) {
            return Ok(());
        }
        let keeps_all = edited.labels.len() == self.labels.len();
        if keeps_all {
            return copy_beside(FEATURE_COLORS, &self.path, out);
        }
        // Those of an earlier scene.
        let features = out.with_file_name(FEATURE_COLORS);
        match own::check(&features) {
            Ok(()) => atomic::remove(&features),
            Err(_) => Ok(()),
        }
    }

    /// Corners of a box around the objects called `what`, world units.
    ///
    /// # Errors
    /// As [`ObjectScene::find`].
    pub fn bounds(&self, what: &str, flag: &str) -> Result<(DVec3, DVec3)> {
        let found = self.find(what, flag)?;
        let corners = found.iter().flat_map(|object| [object.low, object.high]);
        let (low, high) = bounds(corners).unwrap_or_default();
        Ok((low + self.ply.origin, high + self.ply.origin))
    }

    /// The name of a label, where one is known.
    pub fn name(&self, id: u16) -> Option<&str> {
        self.classes.known_name(id)
    }

    /// The object with the id `what`, or all objects with that name or, for associated objects, that class: `chair` finds
    /// `chair 2`. Where none is written so, capitals do not matter, nor `-` and `_`, if only one name is meant. `flag` is the option
    /// that errors name.
    ///
    /// # Errors
    /// [`Error::Argument`] with the names that there are.
    pub fn find(&self, what: &str, flag: &str) -> Result<Vec<&Object>> {
        let what = what.trim();
        let id: Option<u16> = what.parse().ok();
        if let Some(object) = self.objects.iter().find(|o| Some(o.id) == id) {
            return Ok(vec![object]);
        }
        let exact = self.called(|name| name == what);
        if !exact.is_empty() {
            return Ok(exact.into_iter().map(|(object, _)| object).collect());
        }
        let alike = self.called(|name| plain(name) == plain(what));
        let names: BTreeSet<&str> = alike.iter().map(|(_, name)| *name).collect();
        if names.len() == 1 {
            return Ok(alike.into_iter().map(|(object, _)| object).collect());
        }
        let found = if !names.is_empty() {
            let names: Vec<&str> = names.into_iter().collect();
            format!("{what}, which may mean {}", names.join(" or "))
        } else if self.is_class(what) {
            format!("{what}, which no Gaussian has")
        } else {
            what.to_owned()
        };
        Err(invalid!(argument "{flag}"; found "{found}";
            expected "an id or a name of the scene: {}", self.listed();
            help "`coseg objects --scene FILE.ply` lists them"))
    }

    /// Whether `what` is the id or the name of a class, or of an object, of the table.
    fn is_class(&self, what: &str) -> bool {
        let is_named = |name: &str| plain(name) == plain(what);
        let is_meant = |class: &Class| {
            class.id.to_string() == what || is_named(&class.name) || is_named(class.base_name())
        };
        self.classes.entries.iter().any(is_meant)
    }

    /// The first objects, for an error.
    fn listed(&self) -> String {
        let listed = |o: &Object| format!("{} {}", o.id, self.name(o.id).unwrap_or_default());
        let listed = self.objects.iter().take(MAX_LISTED).map(listed);
        let mut listed: Vec<String> = listed.map(|name| name.trim_end().to_owned()).collect();
        let more = self.objects.len().saturating_sub(MAX_LISTED);
        if more > 0 {
            listed.push(format!("or one of {more} more"));
        }
        listed.join(", ")
    }

    /// Ids of the objects in `list`, see [`Self::find`].
    ///
    /// # Errors
    /// As [`ObjectScene::find`].
    pub fn ids(&self, list: &[String], flag: &str) -> Result<Vec<u16>> {
        let mut ids = Vec::new();
        for what in list {
            ids.extend(self.find(what, flag)?.iter().map(|object| object.id));
        }
        Ok(ids)
    }

    /// Objects whose name `is_meant`, or else whose class, each with that.
    fn called(&self, is_meant: impl Fn(&str) -> bool) -> Vec<(&Object, &str)> {
        let objects = self.objects.iter();
        let found = objects.filter_map(|object| {
            let class = self.classes.index(object.id);
            let class = class.map(|i| self.classes.entries[i].base_name());
            let mut names = [self.name(object.id), class].into_iter().flatten();
            Some((object, names.find(|name| is_meant(name))?))
        });
        found.collect()
    }
}

/// The error of a scene that needs a label column.
pub fn without_labels(path: &Path) -> Error {
    if let Some(command) = unfinished_run(files::folder(path)) {
        return invalid!(path, "column label"; found "nothing, as the run was stopped"; expected "one label for each Gaussian";
            help "continue it: {command}");
    }
    const HELP: &str = "give the scene labels with `coseg vote` or `coseg train`";
    let (field, help) = if has_labels_beside(path) {
        let beside = label_path(path);
        let name = beside.file_name().unwrap_or_default().display();
        let help = format!("put {name}, which `coseg export` wrote, beside the file, or {HELP}");
        ("labels", help)
    } else {
        ("column label", HELP.to_owned())
    };
    invalid!(path, "{field}"; found "nothing"; expected "one label for each Gaussian"; help "{help}")
}
