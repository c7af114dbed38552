//! The contents of a scene folder of any layout, before anything is decoded.

use super::block::{AGAIN, Block, Region};
use super::dataparser::Similarity;
use super::depth::Depth;
use super::folder::{Folder, Problems};
use super::frame::Frame;
use super::label_folder::choose_raw_files;
use crate::config::Layout;
use crate::data::labels::map_geometry::MapGeometries;
use crate::data::labels::raw::{self, RawFile, RawLabels};
use crate::data::{Classes, LoadOptions, Split, WorldUnit};
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files::check_views;
use crate::splat::camera::spread;
use glam::DVec3;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The frames of a folder and everything known about them.
#[derive(Default)]
pub(crate) struct Listing {
    /// How the folder is laid out; `auto` only in the default.
    pub layout: Layout,
    /// The file that lists the frames, for messages.
    pub file: PathBuf,
    /// The frames that are read, in file order or by name.
    pub frames: Vec<Frame>,
    /// Class table; empty without labels, and where it could not be read.
    pub classes: Classes,
    /// The class table is that of a whole dataset: only classes that occur in the scene are kept.
    pub occurring_classes: bool,
    /// Class id of each id in the true labels, where they hold ids of another table; `None` for ids that the other table lacks.
    /// Length 65536.
    pub truth_ids: Option<Vec<Option<u16>>>,
    /// How the raw labels are stored.
    pub raw: RawLabels,
    /// Which cameras the label maps belong to, where their folders say so.
    pub geometries: MapGeometries,
    /// Label maps of a different size than their photos are resampled.
    pub resample_labels: bool,
    /// The initial cloud, in the world of the files.
    pub cloud: Cloud,
    /// How another program had moved the poses before it wrote them.
    pub applied: Similarity,
    /// How the poses were moved from the world of the files, where they were.
    pub moved: Option<Similarity>,
    /// The region of a block, where the folder is one: the cloud is thinned out outside it.
    pub region: Option<Region>,
    /// The extent of the cameras of the whole scene, where the folder is a block.
    pub whole_extent: Option<f64>,
    /// Whether +z is up in the world. If not, up is estimated from the cameras.
    pub z_up: bool,
    /// Why no frame has raw labels, where the usual folder for them is there.
    pub no_label_file: Option<Error>,
    /// Sentences on what is left out or assumed.
    pub notices: Vec<String>,
}

/// Where the initial cloud comes from.
#[derive(Default)]
pub(crate) enum Cloud {
    #[default]
    None,
    /// A PLY file.
    Ply(PathBuf),
    /// `points3D` of a COLMAP model.
    Colmap(PathBuf),
    /// Depth images.
    Depth(Depth),
}

impl Listing {
    /// A listing without a cloud. Its class table is the folder's. Where labels need one and the folder has none, it is the table
    /// of the `dataset`. Raw labels are added by [`Listing::with_raw_labels`].
    pub fn new(
        folder: Folder<'_>,
        file: PathBuf,
        mut frames: Vec<Frame>,
        dataset: Option<Classes>,
        problems: &mut Problems,
    ) -> Self {
        let Folder { dir, options, .. } = folder;
        choose_raw_files(dir, options, &mut frames);
        let labelled = if frames.iter().any(|frame| frame.truth.is_some()) {
            Some("")
        } else {
            raw::requires_classes(dir, options, &raw_files(&frames))
        };
        let own = dir.join("classes.json").is_file();
        let dataset = dataset.filter(|_| labelled.is_some() && !own);
        let occurring_classes = dataset.is_some();
        let classes = dataset.map_or_else(|| read_classes(dir, labelled), Ok);
        Self {
            layout: folder.layout,
            file,
            frames,
            classes: problems.ok(classes).unwrap_or_default(),
            occurring_classes,
            ..Self::default()
        }
    }

    /// Determines how the raw labels are stored. If that fails, a fault is recorded and they are left out.
    pub fn with_raw_labels(
        mut self,
        dir: &Path,
        options: &LoadOptions,
        problems: &mut Problems,
    ) -> Self {
        let detected = RawLabels::detect(dir, options, &raw_files(&self.frames), &self.classes);
        let Some((raw, vocabulary)) = problems.ok(detected) else {
            return self.without_raw_labels();
        };
        // One file may hold the shapes of all photos.
        if let Some(drawings) = raw.drawings() {
            let frames = self.frames.iter_mut();
            let undrawn = frames.filter(|frame| !drawings.contains_key(&frame.name));
            undrawn.for_each(|frame| frame.raw = None);
        }
        self.raw = raw;
        if let Some(vocabulary) = vocabulary {
            self.occurring_classes |= self.classes.is_empty();
            self.classes = vocabulary.classes;
            self.notices.extend(vocabulary.notice);
        }
        self
    }

    /// The listing in the world of nerfstudio's file.
    pub fn moved(mut self, world: Similarity) -> Self {
        let world = world.after(&self.applied);
        for frame in self.frames.iter_mut().filter(|frame| frame.posed) {
            frame.camera = world.camera(&frame.camera);
        }
        if let Cloud::Depth(depth) = &mut self.cloud {
            depth.scale /= world.scale;
        }
        self.z_up = false;
        self.moved = Some(world);
        self
    }

    /// The same frames without raw labels.
    pub fn without_raw_labels(mut self) -> Self {
        self.frames.iter_mut().for_each(|frame| frame.raw = None);
        self
    }

    /// What `block` of this scene lists, or fewer frames where `options` say so. `file` is the file of the block.
    pub fn of_block(
        mut self,
        block: &Block,
        file: &Path,
        options: &LoadOptions,
        problems: &mut Problems,
    ) -> Self {
        self.whole_extent = Some(self.spread().1);
        let train = block.train.iter().map(|name| (&**name, Split::Train));
        let test = block.test.iter().map(|name| (&**name, Split::Test));
        let mut splits: HashMap<&str, Split> = train.chain(test).collect();
        self.frames.retain_mut(|frame| {
            let split = splits.remove(&*frame.name);
            frame.split = split.unwrap_or(frame.split);
            split.is_some()
        });
        if let Some(name) = splits.keys().min() {
            problems.push(invalid!(file, "train, test";
                found "{} frames that {} does not have, such as {name}", splits.len(), self.file.display();
                expected "frames of the scene"; help "{AGAIN}: it has changed"));
        }
        let splits: Vec<_> = self.frames.iter().map(|frame| Some(frame.split)).collect();
        let mut picked = vec![false; splits.len()];
        for (i, _) in options.pick(&splits) {
            picked[i] = true;
        }
        let mut picked = picked.into_iter();
        self.frames.retain(|_| picked.next().unwrap_or(true));
        self.region = Some(block.region());
        self
    }

    /// Refuses a listing without training views, or with more views than the limits allow.
    pub fn check_sizes(&self) -> Result<()> {
        let views = self.frames.len();
        check_views(&self.file, views)?;
        ensure!(self.frames.iter().any(|frame| frame.split == Split::Train),
            &self.file, "frames"; found "{views} test frames"; expected "at least one training view";
            help "mark frames \"train\", or use more of them");
        Ok(())
    }

    /// Whether a person drew the labels of a held-out photo: it is scored against them, as nothing learns from it.
    pub fn scores_against_drawing(&self, frame: &Frame) -> bool {
        let is_drawn = self.raw.drawings().is_some() && frame.raw.is_some();
        is_drawn && !self.raw.are_segments && frame.split == Split::Test
    }

    /// The id of pixels without a raw label.
    pub fn unlabelled(&self) -> u16 {
        if self.raw.are_segments {
            0
        } else {
            self.classes.ignore
        }
    }

    /// Mean of the camera centres.
    pub fn origin(&self) -> DVec3 {
        self.spread().0
    }

    /// Mean of the camera centres, and the largest distance from it.
    pub fn spread(&self) -> (DVec3, f64) {
        spread(self.frames.iter().map(|frame| frame.camera.center))
    }

    /// The assumed size of a world unit.
    pub fn unit(&self) -> WorldUnit {
        if self.layout != Layout::Colmap && self.moved.is_none() {
            return WorldUnit::Metre;
        }
        WorldUnit::Arbitrary {
            extent: self.whole_extent.unwrap_or_else(|| self.spread().1),
        }
    }
}

/// The raw labels of the frames that have some.
fn raw_files<'a>(frames: &'a [Frame]) -> Vec<RawFile<'a>> {
    let file = |frame: &'a Frame| Some(frame.raw_file(frame.raw.as_deref()?));
    frames.iter().filter_map(file).collect()
}

/// `classes.json` of a scene folder. Only scenes without labels may lack it; for others, `labelled` is added to the help.
fn read_classes(dir: &Path, labelled: Option<&str>) -> Result<Classes> {
    let path = dir.join("classes.json");
    match labelled {
        _ if path.is_file() => {
            let classes = Classes::read(&path)?;
            ensure!(!classes.is_empty(), &path, "classes"; found "no class"; expected "one or more";
                help "list the classes: {{\"0\": \"void\", \"1\": \"wall\", ..}}, or remove the file");
            Ok(classes)
        }
        None => Ok(Classes::default()),
        Some(or) => {
            bail!(&path, "file"; found "nothing"; expected "a class table, as frames have labels";
                help "list the classes: {{\"0\": \"void\", \"1\": \"wall\", ..}}{or}")
        }
    }
}
