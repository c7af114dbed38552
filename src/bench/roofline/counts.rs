//! The exact counts of views that the model of work is fed.

use super::model::Counts;
use crate::error::Result;
use crate::raster::{PairCounts, Projected, Settings, TilePairs};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;

impl Counts {
    /// Of the view of `camera`.
    pub fn of(gaussians: &Gaussians, camera: &Camera, settings: &Settings) -> Result<Self> {
        let projected = Projected::new(&gaussians.splats(), camera, settings)?;
        let (
            stats,
            PairCounts {
                evaluated,
                contributing,
            },
        ) = (projected.stats(), projected.count_pairs());
        let [width, height] = projected.size();
        let edge = TilePairs::<f32>::EDGE;
        Ok(Self {
            gaussians: stats.gaussians as f64,
            visible: stats.visible as f64,
            entries: stats.tile_entries as f64,
            tiles: (width.div_ceil(edge) * height.div_ceil(edge)) as u32,
            pixels: (width * height) as f64,
            evaluated: evaluated as f64,
            contributing: contributing as f64,
        })
    }

    /// Of several views.
    pub fn of_views(
        gaussians: &Gaussians,
        cameras: &[Camera],
        settings: &Settings,
    ) -> Result<Vec<Self>> {
        cameras
            .iter()
            .map(|camera| Self::of(gaussians, camera, settings))
            .collect()
    }
}
