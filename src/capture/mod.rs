//! Photos or a video without poses, made into a scene folder (`coseg from-photos`).

mod masks;
mod photos;
mod poses;
mod program;
mod video;

use self::masks::Masks;
use self::photos::Photos;
use self::poses::{Folders, Solver};
use crate::data::photos::{is_heic, is_photo};
use crate::error::{Error, Result, bail, ensure, in_order};
use crate::files::{self, atomic, file_name, names, own};
use crate::progress::{Progress, Viewing};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs;
use std::path::{Path, PathBuf};

/// Says what the scene folder was made from, and how far that got.
const RECORD: &str = "from-photos.json";
/// Files of ffmpeg and COLMAP, below the scene folder until it is done.
const WORK: &str = ".from-photos";

/// What to make a scene folder from.
#[derive(Clone, Copy, Debug)]
pub struct Capture<'a> {
    /// A folder of photos, or a video.
    pub source: &'a Path,
    /// A folder of masks named as the photos: PNG, black where COLMAP and training leave a photo out.
    pub masks: Option<&'a Path>,
    /// Frames to take from a video.
    pub frames: usize,
    /// The Python whose pycolmap is used; without it `colmap` with CUDA, the pycolmap of `python3`, or another `colmap`.
    pub python: Option<&'a Path>,
}

/// What a scene folder was made from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Made {
    /// Folder or video.
    pub source: PathBuf,
    /// SHA-256 of names, sizes and times of the photos or the video, and of the masks, and of the number of frames.
    pub input: String,
    /// Photos in `images`; 0 until all are there.
    pub photos: usize,
    /// Photos for which a mask was given. If there are any, `masks` has a file for each photo.
    #[serde(default)]
    pub masks: usize,
    /// The program that found the poses; `None` until they are found.
    pub poses: Option<String>,
}

/// A scene folder while it is made.
struct Room {
    folder: PathBuf,
    record: PathBuf,
    images: PathBuf,
    masks: PathBuf,
    work: PathBuf,
}

impl Capture<'_> {
    /// Makes the scene folder `out`: photos without EXIF orientation in `images`, or frames of the video, their masks in `masks`, and
    /// COLMAP models in `sparse`. A folder that was begun is continued: finished steps are not repeated.
    ///
    /// # Errors
    /// [`Error::Missing`] for the source or a program that is not there; [`Error::Argument`] for a folder with other files, or one
    /// made from other photos; [`Error::Input`] for photos of several sizes or that cannot be placed, and for masks of other
    /// proportions; [`Error::Program`]; [`Error::Io`]; [`Error::Stopped`].
    pub fn make(&self, out: &Path, progress: &mut dyn Progress) -> Result<Made> {
        let photos = self.photos()?;
        let masks = self.masks(photos.as_deref())?;
        let input = self.input(photos.as_deref(), masks.as_ref())?;
        // COLMAP and ffmpeg would take names that start with a dash as options.
        let room = Room::new(files::absolute(out)?);
        let mut made = room.begun(&input)?;
        let solver = made.poses.is_none().then(|| Solver::find(self.python));
        let solver = solver.transpose()?;
        let photos = photos.filter(|_| made.photos == 0).map(Photos::look);
        let photos = photos.transpose()?;
        if let (Some(masks), Some(photos)) = (&masks, &photos) {
            masks.check(photos, progress)?;
        }
        made.source = files::absolute(self.source)?;
        made.input = input;
        atomic::write_json(&room.record, &made)?;
        if made.photos == 0 {
            let photos = match photos {
                Some(photos) => photos,
                None => self.video_frames(&room, progress)?,
            };
            room.copy(&photos, masks.as_ref(), progress)?;
            made.photos = photos.all.len();
            made.masks = masks.map_or(0, |masks| masks.0.len());
            atomic::write_json(&room.record, &made)?;
        }
        if let Some(solver) = solver {
            room.solve(&solver, &made, progress)?;
            made.poses = Some(solver.to_string());
            atomic::write_json(&room.record, &made)?;
        }
        // A folder that cannot be removed does no harm.
        let _ = fs::remove_dir_all(&room.work);
        Ok(made)
    }

    /// The photos of a folder; `None` for a video.
    fn photos(&self) -> Result<Option<Vec<PathBuf>>> {
        if !self.source.exists() {
            let help = "give a folder of photos, or a video";
            return Err(Error::missing("file or folder", self.source, help));
        }
        ensure!(!self.source.is_file() || !(is_photo(self.source) || is_heic(self.source)), self.source, "name"; found "a photo";
            expected "a folder of photos, or a video"; help "name the folder of the photo");
        let is_folder = self.source.is_dir();
        is_folder.then(|| photos::list(self.source)).transpose()
    }

    /// Frames of the video, in the working folder.
    fn video_frames(&self, room: &Room, progress: &mut dyn Progress) -> Result<Photos> {
        let folder = room.work.join("frames");
        make_empty(&folder)?;
        let video = files::absolute(self.source)?;
        video::frames(&video, self.frames, &folder, progress)?;
        Photos::look(photos::list(&folder)?)
    }

    /// The masks of the photos, where they are given.
    fn masks(&self, photos: Option<&[PathBuf]>) -> Result<Option<Masks>> {
        let Some(dir) = self.masks else {
            return Ok(None);
        };
        let Some(photos) = photos else {
            bail!(argument "--masks"; found "masks of a video"; expected "masks of photos";
                help "take photos from the video with `coseg from-photos` without masks, and then give its folder images");
        };
        Masks::list(dir, photos).map(Some)
    }

    /// [`Made::input`] for these photos and masks, or for the video.
    fn input(&self, photos: Option<&[PathBuf]>, masks: Option<&Masks>) -> Result<String> {
        let video = [self.source.to_owned()];
        let frames = photos.map_or(self.frames, <[PathBuf]>::len);
        let mut digest = Sha256::new();
        let files = photos.unwrap_or(&video);
        let of_photo = |photo: &PathBuf| masks?.0.get(photo);
        for file in files.iter().chain(files.iter().filter_map(of_photo)) {
            let failed = |e| Error::io(file, "look at", e);
            let there = fs::metadata(file).map_err(failed)?;
            let size = there.len();
            let time = there.modified().map_err(failed)?;
            digest.update(format!("{:?} {size} {time:?}\n", file.file_name()));
        }
        digest.update(format!("{frames}"));
        Ok(format!("{:x}", digest.finalize()))
    }
}

impl Room {
    fn new(folder: PathBuf) -> Self {
        Self {
            record: folder.join(RECORD),
            images: folder.join("images"),
            masks: folder.join("masks"),
            work: folder.join(WORK),
            folder,
        }
    }

    /// How far the folder has come; it may also be new or empty. Refuses one that was made from another `input`.
    fn begun(&self, input: &str) -> Result<Made> {
        let out = self.folder.display();
        if !self.record.is_file() {
            let others = names(&self.folder, |name, _| !name.starts_with('.'));
            ensure!(others.is_empty(), argument "--out"; found "{out}, which holds {}", others.join(", ");
                expected "a new folder, or one that this command began"; help "name another folder");
            return Ok(Made::default());
        }
        own::check(&self.record)?;
        let made: Made = files::json(&self.record, "the record that `coseg from-photos` wrote")?;
        let has_photos = self.images.exists();
        ensure!(made.photos == 0 || has_photos, argument "--out"; found "{out}, whose images are gone";
            expected "the folder as this command left it"; help "name another folder");
        ensure!(made.input == input || !has_photos, argument "--out";
            found "{out}, made from {}, other files, masks or frames", made.source.display();
            expected "a new folder, or one made from the same files"; help "name another folder");
        Ok(made)
    }

    /// Writes the photos into `images`, without EXIF orientation, and the mask of each into `masks` if masks are given.
    ///
    /// # Errors
    /// [`Error::Input`] where a photo or its mask cannot be read; [`Error::Io`]; [`Error::Stopped`].
    fn copy(
        &self,
        photos: &Photos,
        masks: Option<&Masks>,
        progress: &mut dyn Progress,
    ) -> Result<()> {
        let mut viewing = Viewing::begin(progress, "photos", photos.all.len());
        for some in photos.all.chunks(rayon::current_num_threads()) {
            in_order(some.par_iter().map(|photo| {
                if let Some(masks) = masks {
                    masks.write(photo, photos.turn(photo), &self.masks)?;
                }
                let name = file_name(&photo.path).unwrap_or_default();
                atomic::write_bytes(self.images.join(name), &photos.upright(photo)?)
            }))?;
            viewing.advance(some.len())?;
        }
        viewing.end();
        Ok(())
    }

    /// Finds the poses of the photos.
    fn solve(&self, solver: &Solver, made: &Made, progress: &mut dyn Progress) -> Result<()> {
        let folders = Folders {
            images: &self.images,
            masks: (made.masks > 0).then_some(&*self.masks),
            work: &self.work,
            models: &self.folder.join("sparse"),
        };
        solver.run(&folders, made.photos, progress)
    }
}

/// Makes the folder, without what an earlier try left in it.
fn make_empty(folder: &Path) -> Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(|e| Error::io(folder, "remove", e))?;
    }
    fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create folder", e))
}
