//! Which camera label maps are of, as a file beside them says.

use crate::data::formats::frame::{Frame, reduced};
use crate::data::formats::listing::{Listing, Problems};
use crate::data::photos::image_file::ImageFile;
use crate::data::{LoadOptions, atomic};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};

/// The file's name.
const FILE: &str = "geometry.json";

/// Which camera the label maps of a folder are of: what `geometry.json` in it says.
///
/// Without that file maps are of the photos, but for those of the very size that [`LoadOptions::max_side`] reduces a photo to,
/// which are taken for maps of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MapGeometry {
    /// That of a view of the loaded scene, a pinhole: nothing is left to be taken out of them, whatever their size.
    Undistorted,
    /// That of the photo as it lies there, lens and all, whatever their size.
    Photos,
}

/// The file.
#[derive(Serialize, Deserialize)]
struct File {
    maps: MapGeometry,
}

impl MapGeometry {
    /// Writes `{"maps": "undistorted"}` or `{"maps": "photos"}` into `geometry.json` of `folder`, which is made if absent.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write(self, folder: &Path) -> Result<()> {
        atomic::write(folder.join(FILE), |out| {
            serde_json::to_writer(&mut *out, &File { maps: self })?;
            std::io::Write::write_all(out, b"\n")
        })
    }

    fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        let file: Result<File, _> = serde_json::from_str(&text);
        file.map(|file| file.maps).map_err(|e| {
            let expected =
                "{\"maps\": \"undistorted\"} of maps that coseg wrote, or {\"maps\": \"photos\"} of maps of photos";
            let help = "say one of the two, or take the file away";
            Error::input(path, format!("line {}", e.line()), e.to_string(), expected, help)
        })
    }
}

/// What the folders of a scene's label maps say.
#[derive(Default)]
pub(crate) struct MapGeometries(HashMap<PathBuf, MapGeometry>);

impl MapGeometries {
    /// Of the folders that the maps of `frames` lie in.
    pub fn read(frames: &[Frame], problems: &mut Problems) -> Self {
        let maps = frames
            .iter()
            .flat_map(|frame| [&frame.truth, &frame.raw, &frame.instances])
            .flatten();
        let folders: BTreeSet<&Path> = maps.filter_map(|map| map.parent()).collect();
        let mut said = HashMap::new();
        for folder in folders {
            let path = folder.join(FILE);
            if path.is_file()
                && let Some(geometry) = problems.keep(MapGeometry::read(&path))
            {
                said.insert(folder.to_owned(), geometry);
            }
        }
        Self(said)
    }

    /// What is said of a map, or of a photo's folder of masks.
    pub fn of(&self, map: &Path) -> Option<MapGeometry> {
        self.0.get(map.parent()?).copied()
    }
}

/// What is said where a map's size alone tells that the distortion of the lens is taken out of it. Looks at the first raw
/// labels of a photo that has some distortion.
pub(crate) fn told_by_size(listing: &Listing, options: &LoadOptions) -> Option<String> {
    let mut bent = listing
        .frames
        .iter()
        .filter(|frame| !frame.lens.is_pinhole() && !frame.scales);
    let (map, size) = bent.find_map(|frame| {
        let size = reduced((frame.camera.width, frame.camera.height), options.max_side)?;
        Some((frame.raw.as_ref().filter(|map| map.is_file())?, size))
    })?;
    let unsaid = listing.geometries.of(map).is_none();
    // A file that cannot be read is told of where it is read.
    let file = ImageFile::open(map, &options.limits)
        .ok()
        .filter(|file| unsaid && file.size == size)?;
    let (width, height) = file.size;
    Some(format!(
        "{}: label maps of {width}x{height} pixels, to which photos are reduced, are taken for maps that coseg wrote, without \
         lens distortion; where they are of photos that were reduced and no more, write {{\"maps\": \"photos\"}} into {}",
        map.display(),
        map.with_file_name(FILE).display()
    ))
}
