//! Which camera label maps belong to, as a file beside them says.

use crate::error::{Error, Result};
use crate::files::{self, atomic};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};

/// Which camera the label maps of a folder belong to, as `geometry.json` in it says.
///
/// Without that file maps belong to the stored photos. Maps of exactly the size that `data.max_side` reduces a photo to are taken
/// for maps of the loaded scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MapGeometry {
    /// The camera of a view of the loaded scene, a pinhole, whatever the size of the map.
    Undistorted,
    /// The camera of the stored photo with its lens distortion, whatever the size of the map.
    Photos,
}

/// The file.
#[derive(Deserialize)]
struct File {
    maps: MapGeometry,
}

impl MapGeometry {
    /// The name of the file.
    pub const FILE: &str = "geometry.json";

    /// Writes `{"maps": "undistorted"}` or `{"maps": "photos"}` into `geometry.json` of `folder`, which is made if absent.
    ///
    /// # Errors
    /// [`crate::Error::Io`].
    pub fn write(self, folder: &Path) -> Result<()> {
        atomic::write_bytes(folder.join(Self::FILE), self.text().as_bytes())
    }

    /// The content of the file.
    pub(crate) fn text(self) -> String {
        format!("{}\n", serde_json::json!({ "maps": self }))
    }

    fn read(path: &Path) -> Result<Self> {
        let expected = "{\"maps\": \"undistorted\"} for maps that coseg wrote, or {\"maps\": \"photos\"} for maps of photos";
        files::json::<File>(path, expected).map(|file| file.maps)
    }
}

/// What the folders of a scene's label maps say.
#[derive(Default)]
pub(crate) struct MapGeometries(HashMap<PathBuf, MapGeometry>);

impl MapGeometries {
    /// Reads the geometry of each folder that `maps` lie in. `fault` receives the errors in their files.
    pub fn read<'a>(maps: impl Iterator<Item = &'a PathBuf>, mut fault: impl FnMut(Error)) -> Self {
        let folders: BTreeSet<&Path> = maps.map(|map| files::folder(map)).collect();
        let files = folders
            .into_iter()
            .filter(|folder| folder.join(MapGeometry::FILE).is_file());
        let read = |folder: &Path| {
            let geometry = MapGeometry::read(&folder.join(MapGeometry::FILE));
            Some((folder.to_owned(), geometry.map_err(&mut fault).ok()?))
        };
        Self(files.filter_map(read).collect())
    }

    /// The camera of a map, or of a photo's folder of masks, where its folder says so.
    pub fn of(&self, map: &Path) -> Option<MapGeometry> {
        self.0.get(files::folder(map)).copied()
    }
}
