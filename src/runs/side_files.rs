//! What the scenes of one folder share: classes.json, the names of their labels, and cameras.json, their views.

use super::scene_file::{CAMERAS, CLASSES};
use crate::data::formats::transforms;
use crate::data::{Classes, NamedCamera};
use crate::error::{Result, ensure};
use crate::files::{self, atomic, own};
use crate::splat::formats::is_scene;
use std::path::{Path, PathBuf};

/// Where the cameras of a new scene come from.
#[derive(Clone, Copy, Debug)]
pub enum Cameras<'a> {
    /// From the file beside this scene, if it is there.
    Beside(&'a Path),
    /// These, which a command used.
    Used(&'a [NamedCamera]),
}

impl Cameras<'_> {
    /// The content of the new file; `None` where there are no cameras.
    fn content(&self) -> Result<Option<Vec<u8>>> {
        match self {
            Self::Beside(scene) => {
                let file = scene.with_file_name(CAMERAS);
                file.is_file().then(|| files::read(&file)).transpose()
            }
            Self::Used(cameras) => Ok(Some(transforms::cameras_text(cameras).into_bytes())),
        }
    }
}

/// The files beside new scenes, which other scenes in the folder share.
#[derive(Clone, Copy, Debug)]
pub struct SideFiles<'a> {
    /// The new scenes, of one folder.
    pub scenes: &'a [&'a Path],
    /// What their labels mean; `None` where they have no labels.
    pub classes: Option<&'a Classes>,
    /// Their views.
    pub cameras: Cameras<'a>,
}

impl SideFiles<'_> {
    fn file(&self, name: &str) -> Option<PathBuf> {
        Some(self.scenes.first()?.with_file_name(name))
    }

    /// Another scene in the folder, by its name.
    fn other(&self) -> Option<String> {
        let folder = files::folder(self.scenes.first()?);
        let ours: Vec<_> = self.scenes.iter().map(|scene| scene.file_name()).collect();
        let is_other = |name: &str, path: &Path| {
            is_scene(path) && path.is_file() && !ours.contains(&Some(name.as_ref()))
        };
        files::names(folder, is_other).into_iter().next()
    }

    /// Refuses names or cameras that would replace those of another scene in the folder, and used cameras that would replace a file
    /// which this command did not write. `force` is the option by which they may be replaced; `None` for commands without it.
    ///
    /// # Errors
    /// [`crate::Error::Input`] naming the file; [`crate::Error::Argument`]; as [`Classes::read`].
    pub fn check(&self, force: Option<bool>) -> Result<()> {
        let Some((table, views)) = self.file(CLASSES).zip(self.file(CAMERAS)) else {
            return Ok(());
        };
        let other = self.other();
        let has_cameras = self.has_cameras(&views)?;
        if force == Some(true) {
            if !has_cameras && (other.is_some() || matches!(self.cameras, Cameras::Used(_))) {
                own::allow(&views);
            }
            return Ok(());
        }
        if let Some(other) = other {
            let has_names = match self.classes {
                Some(classes) => !table.exists() || has_table(&table, classes)?,
                None => true,
            };
            let or = force.map_or("", |_| ", or write over them with --force");
            ensure!(has_names, &table, "classes"; found "those of {other}"; expected "those of the new scene";
                help "name another folder{or}");
            ensure!(has_cameras, &views, "cameras"; found "those of {other}"; expected "those of the new scene";
                help "name another folder{or}");
        }
        if !has_cameras && matches!(self.cameras, Cameras::Used(_)) {
            own::check_argument("--out", &views)?;
        }
        Ok(())
    }

    /// Whether the file `views` need not change.
    fn has_cameras(&self, views: &Path) -> Result<bool> {
        Ok(match self.cameras.content()? {
            Some(content) if views.is_file() => files::read(views)? == content,
            _ => true,
        })
    }

    /// Writes both files. What the new scenes lack is removed, unless it is of another scene. Cameras that this program did not write
    /// stay, but for used ones.
    ///
    /// # Errors
    /// As [`Classes::read`]; [`crate::Error::Io`].
    pub fn write(&self) -> Result<()> {
        let Some((table, views)) = self.file(CLASSES).zip(self.file(CAMERAS)) else {
            return Ok(());
        };
        let is_shared = self.other().is_some();
        match self.classes {
            Some(classes) => write_classes(classes, &table)?,
            None if is_shared => {}
            None => write_classes(&Classes::default(), &table)?,
        }
        let stays = match self.cameras {
            Cameras::Beside(scene) => {
                let from = scene.with_file_name(CAMERAS);
                atomic::same_file(&from, &views) || own::check(&views).is_err()
            }
            Cameras::Used(_) => self.has_cameras(&views)? && views.is_file(),
        };
        match self.cameras.content()? {
            _ if stays => Ok(()),
            Some(content) => atomic::write_bytes(&views, &content),
            None if is_shared => Ok(()),
            None => atomic::remove(&views),
        }
    }
}

/// Whether the file `names` has the table `classes`. Without the file: whether `classes` is empty.
///
/// # Errors
/// As [`Classes::read`].
pub fn has_table(names: &Path, classes: &Classes) -> Result<bool> {
    if !names.exists() {
        return Ok(classes.is_empty());
    }
    Ok(Classes::read(names)? == *classes)
}

/// Makes the file `names` say what the labels of a new scene mean. Without `classes` an older file is removed.
///
/// # Errors
/// As [`Classes::read`]; [`crate::Error::Io`].
fn write_classes(classes: &Classes, names: &Path) -> Result<()> {
    if has_table(names, classes)? {
        return Ok(());
    }
    if classes.is_empty() {
        return atomic::remove(names);
    }
    classes.write(names)
}
