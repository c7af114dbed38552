//! The label maps of a frame, as the camera of its view sees them.

use super::frame::{Frame, Geometry};
use super::listing::Listing;
use crate::data::labels::label_map::expect_file;
use crate::data::labels::raw::RawMap;
use crate::data::labels::scores;
use crate::data::mask::Mask;
use crate::data::photos::image_file::{ImageFile, proportional};
use crate::data::{LabelMap, LoadOptions, ViewScores};
use crate::error::Result;
use std::path::Path;

/// A frame with its geometry and mask, by which its label maps are read.
pub(crate) struct FrameLabels<'a> {
    pub listing: &'a Listing,
    pub frame: &'a Frame,
    pub geometry: Geometry,
    /// Maps are unlabelled where it leaves pixels out.
    pub mask: Option<Mask>,
}

impl<'a> FrameLabels<'a> {
    /// Opens the photo of a frame and reads its mask.
    pub fn open(
        listing: &'a Listing,
        frame: &'a Frame,
        options: &'a LoadOptions,
    ) -> Result<(ImageFile, Self)> {
        let (file, geometry) = frame.open(&listing.file)?;
        let geometry = geometry.limited_to(options.max_side);
        let labels = Self {
            listing,
            frame,
            mask: frame.read_mask(&geometry)?,
            geometry,
        };
        Ok((file, labels))
    }

    /// The true labels, in class ids.
    pub fn truth(&self) -> Result<Option<LabelMap>> {
        let Some(path) = &self.frame.truth else {
            return Ok(None);
        };
        let mut map = self.read_grey(path)?;
        if let Some(ids) = &self.listing.truth_ids {
            map.translate(path, ids)?;
        }
        let classes = &self.listing.classes;
        map.check_ids(path, classes, "")?;
        Ok(Some(self.in_view(path, map, classes.ignore)))
    }

    /// The true instances.
    pub fn instances(&self) -> Result<Option<LabelMap>> {
        let path = self.frame.instances.as_ref();
        path.map(|path| Ok(self.in_view(path, self.read_grey(path)?, 0)))
            .transpose()
    }

    /// The raw labels.
    pub fn raw(&self) -> Result<Option<RawMap>> {
        let Some(path) = &self.frame.raw else {
            return Ok(None);
        };
        let camera = &self.geometry.camera;
        let check_size = |file: &ImageFile| self.check_size(path, file);
        let raw = self.listing.raw.read(
            self.frame.raw_file(path),
            (camera.width, camera.height),
            &self.listing.classes,
            &check_size,
        )?;
        let map = self.in_view(path, raw.map, self.listing.unlabelled());
        Ok(Some(RawMap { map, ..raw }))
    }

    /// The scores of the raw labels, where they lie beside the map.
    pub fn scores(&self) -> Option<ViewScores> {
        let ids = self.listing.raw.score_ids.clone()?;
        let map = self.frame.raw.as_ref()?;
        let file = scores::path_of(map).filter(|file| file.is_file())?;
        Some(ViewScores {
            file,
            map: map.clone(),
            ids,
            placement: self.geometry.placement(self.listing.geometries.of(map)),
        })
    }

    /// A grey label map of the size of its file.
    fn read_grey(&self, path: &Path) -> Result<LabelMap> {
        expect_file(path, &self.frame.image)?;
        let file = ImageFile::open(path)?;
        self.check_size(path, &file)?;
        LabelMap::decode(path, &file)
    }

    /// The map that was read from `path`, as the view's camera sees it. Masked pixels have the id `unlabelled`.
    fn in_view(&self, path: &Path, map: LabelMap, unlabelled: u16) -> LabelMap {
        let mut map = self.geometry.labels(map, self.listing.geometries.of(path));
        if let Some(mask) = &self.mask {
            mask.fill(&mut map.ids, 1, unlabelled);
        }
        map
    }

    /// Refuses a label file at `path` unless it has the size of the stored or of the reduced photo. Where maps are resampled, the
    /// same proportions are enough.
    fn check_size(&self, path: &Path, file: &ImageFile) -> Result<()> {
        let declared = self.listing.geometries.of(path).is_some();
        if !declared && self.geometry.is_reduced_size(file.size) {
            return Ok(());
        }
        let size = (self.geometry.camera.width, self.geometry.camera.height);
        let resampled = declared || self.listing.resample_labels || self.frame.resizable;
        if resampled && proportional(file.size, size) {
            return Ok(());
        }
        let photo = || ImageFile::open(&self.frame.image).ok()?.exif_orientation();
        let exif = file.lies_across(size).then(photo).flatten();
        let whose = exif.map_or("its photo".to_owned(), |exif| {
            format!("its photo as it is stored, whose EXIF orientation is {exif}")
        });
        let help = "where maps were made from smaller copies of the photos, put a file geometry.json with {\"maps\": \"photos\"} beside \
            them; else scale the map, without blending ids";
        file.expect_size(size, &whose, help)
    }
}
