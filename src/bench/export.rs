//! What is measured, as files: other renderers can be timed on the same Gaussians and cameras.

use super::Bench;
use crate::data::formats::transforms::write_cameras;
use crate::data::{NamedCamera, Split};
use crate::error::Result;
use crate::splat::ply;
use glam::DVec3;
use std::path::{Path, PathBuf};

impl Bench {
    /// Writes the Gaussians and cameras that [`super::Section::Channels`] renders into `dir`: `gaussians_N.ply` for each number
    /// N of them, `cameras_WxH.json` for each size. Gives the paths.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; those of [`super::Subject::gaussians`].
    pub fn export(&self, dir: &Path) -> Result<Vec<PathBuf>> {
        let mut written = Vec::new();
        for &count in &self.effort.memory {
            let gaussians = self.subject.gaussians(count)?;
            let path = dir.join(format!("gaussians_{}.ply", gaussians.len()));
            ply::write(&path, &gaussians, DVec3::ZERO, None)?;
            written.push(path);
        }
        for [width, height] in [self.effort.size, self.effort.channels_size] {
            let cameras = self.subject.cameras(self.effort.views, [width, height]);
            let named = |(i, camera)| NamedCamera {
                name: format!("view_{i}"),
                split: Split::Train,
                camera,
            };
            let path = dir.join(format!("cameras_{width}x{height}.json"));
            write_cameras(
                &path,
                &cameras
                    .into_iter()
                    .enumerate()
                    .map(named)
                    .collect::<Vec<_>>(),
            )?;
            written.push(path);
        }
        Ok(written)
    }
}
