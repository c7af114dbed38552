//! Label maps and scores of all photos of a scene folder.

use super::index::{self, Index};
use super::mapping::{ClassFile, Mapping};
use super::model::Network;
use super::run::Logits;
use super::turned::upright;
use crate::config::Association;
use crate::data::formats::folder::Problems;
use crate::data::formats::frame::Frame;
use crate::data::formats::layout;
use crate::data::formats::listing::Listing;
use crate::data::labels::scores;
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LoadOptions, MapGeometry, check_outputs};
use crate::error::Result;
use crate::progress::{Progress, Viewing};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Bytes of memory that photos in work take at most, apart from the network's weights.
const MAX_PHOTO_BYTES: usize = 700 << 20;
/// Bytes for each pixel of a photo: decoded, its label map, and both while they are encoded.
const PIXEL_BYTES: usize = 12;
/// Changes with the arithmetic: labels of another version are made again.
const VERSION: &str = "coseg label 2";

/// What to label, with what, and where to.
#[derive(Debug)]
pub struct Job<'a> {
    /// The scene folder.
    pub dir: &'a Path,
    /// How it is read; all frames that the options pick are labelled.
    pub options: &'a LoadOptions,
    /// The network.
    pub network: &'a Network,
    /// The user's classes; without them those of the network that occur.
    pub classes: Option<&'a ClassFile>,
    /// Classes of each cell of the scores.
    pub best: usize,
    /// The folder to write.
    pub out: &'a Path,
}

/// What was done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Labelled {
    /// Photos of the scene.
    pub photos: usize,
    /// Photos whose labels were there already.
    pub cached: usize,
    /// Classes in the class table.
    pub classes: usize,
}

/// Labels all photos of a scene folder: `NAME.png` and `scores/NAME.scores` for each view, `classes.json`, `geometry.json`, and
/// `label.json`, which lists what was written. Photos are read as they are stored. Labels that are there already and follow
/// from the same network, contract, classes and photo are kept.
///
/// # Errors
/// Those of the loader for frames and photos; as [`Mapping::of_user`]; [`crate::Error::Argument`] for a folder that the scene's files
/// lie in; [`crate::Error::Input`] for a folder with other files, and for files in it that were changed since; as
/// [`Network::run`]; [`crate::Error::Io`]; [`crate::Error::Stopped`].
pub fn label_scene(job: &Job<'_>, progress: &mut dyn Progress) -> Result<Labelled> {
    check_outputs("--out", &[job.out], Some((job.dir, job.options)))?;
    let listing = frames(job)?;
    let contract = &job.network.contract;
    let scene = &listing.classes;
    let mapping = match job.classes {
        Some(user) => Mapping::of_user(contract, user, scene)?,
        None => Mapping::all(contract),
    };
    let recipe = format!(
        "{VERSION}\n{}\n{contract:?}\n{}\n{}\n",
        job.network.digest,
        mapping.text(),
        job.best
    );
    let classes_file = job.classes.map(|user| user.file.display().to_string());
    let parts = [
        ("model", job.network.file.display().to_string()),
        ("contract", contract.file.display().to_string()),
        ("classes", classes_file.unwrap_or_default()),
    ];
    let meaning = format!("{}\n{}", mapping.text(), mapping.classes.text());
    let meaning = index::digest(meaning.as_bytes());
    let mut index = Index::open(job.out)?;
    let views = listing.frames.iter().map(|frame| frame.name.as_str());
    index.check_classes(&meaning, views)?;
    index.made_from(&parts);
    // Written before the maps: without this file, loading would have to guess their geometry.
    index.write(&[(
        MapGeometry::FILE.to_owned(),
        MapGeometry::Photos.text().into_bytes(),
    )])?;
    let work = Work {
        job,
        listing: &listing,
        recipe,
        meaning,
        mapping: &mapping,
        index: Mutex::new(index),
    };
    let cached = work.run(progress)?;
    let index = work.index.into_inner();
    let mut index = index.unwrap_or_else(PoisonError::into_inner);
    let mut classes = mapping.classes;
    let mut unseen = Vec::new();
    if mapping.keeps_occurring {
        let ids = index.ids();
        let all = classes.entries.iter().map(|class| class.id);
        unseen.extend(all.filter(|id| !ids.contains(id)));
        classes.entries.retain(|class| ids.contains(&class.id));
    }
    let table = classes.text_with_unseen(&unseen).into_bytes();
    index.write(&[(Classes::FILE.to_owned(), table)])?;
    Ok(Labelled {
        photos: listing.frames.len(),
        cached,
        classes: classes.len(),
    })
}

/// The frames of the scene. Its raw labels, if it has any, do not matter.
fn frames(job: &Job<'_>) -> Result<Listing> {
    let options = LoadOptions {
        // Raw labels in any format, with or without classes, pass as segments.
        association: Association::Gaussians,
        ..job.options.clone()
    };
    Problems::first_of(|problems| layout::list(job.dir, &options, problems))
}

/// The photos to label.
struct Work<'a> {
    job: &'a Job<'a>,
    listing: &'a Listing,
    mapping: &'a Mapping,
    /// Everything that labels follow from, except the photo.
    recipe: String,
    /// Digest of what ids mean.
    meaning: String,
    index: Mutex<Index>,
}

impl Work<'_> {
    /// Labels the photos, several at a time. Returns how many were labelled before.
    fn run(&self, progress: &mut dyn Progress) -> Result<usize> {
        let frames = &self.listing.frames;
        let mut viewing = Viewing::begin(progress, "labels", frames.len());
        let mut cached = 0;
        for batch in frames.chunks(self.workers()) {
            let each = batch.par_iter().with_max_len(1);
            let labelled: Vec<Result<bool>> = each.map(|frame| self.label(frame)).collect();
            for was_cached in labelled {
                cached += usize::from(was_cached?);
                viewing.advance(1)?;
            }
        }
        viewing.end();
        Ok(cached)
    }

    /// Photos that are labelled side by side.
    fn workers(&self) -> usize {
        let pixels = |frame: &Frame| frame.camera.width * frame.camera.height;
        let largest = self.listing.frames.iter().map(pixels).max().unwrap_or(0);
        let bytes = self.job.network.working_bytes() + PIXEL_BYTES * largest;
        (MAX_PHOTO_BYTES / bytes.max(1)).clamp(1, rayon::current_num_threads())
    }

    /// Labels a photo; true where its labels were there already.
    fn label(&self, frame: &Frame) -> Result<bool> {
        let (file, _) = frame.open(&self.listing.file)?;
        let photo: String = file
            .digest()
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        let key = index::digest(format!("{}{photo}", self.recipe).as_bytes());
        let name = frame.name.replace(['/', '\\'], "_");
        let names = [format!("{name}.png"), scores::name_of(&name)];
        {
            let index = self.index();
            if index.is_current(&frame.name, &key, &names) {
                return Ok(true);
            }
            names.iter().try_for_each(|name| index.check_own(name))?;
        }
        let logits = self.logits(file)?;
        let (map, scores) = logits.labels(self.mapping, self.job.best);
        let path = Path::new(&names[1]);
        let files = [
            (names[0].clone(), map.png()?),
            (names[1].clone(), scores.encode(path)?),
        ];
        let ids: BTreeSet<u16> = map.ids.iter().copied().collect();
        self.index()
            .add(&frame.name, [key, self.meaning.clone()], ids, &files)?;
        Ok(false)
    }

    /// What the network says about a photo, which it sees upright.
    fn logits(&self, photo: ImageFile) -> Result<Logits> {
        let network = self.job.network;
        match photo.orientation() {
            Some(orientation) => {
                let upright = upright(photo.decode_rgb()?, orientation);
                Ok(network.run(&upright)?.turned_back(orientation))
            }
            None => network.run(&photo.decode_rgb()?),
        }
    }

    fn index(&self) -> MutexGuard<'_, Index> {
        // A worker that fails leaves the index as it is on disk, or ahead of it.
        self.index.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
