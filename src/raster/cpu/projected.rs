//! One view of the Gaussians: projected, sorted, binned.

use super::footprint::Splat2;
use super::geometry::Viewpoint;
use super::projection::{Visible, project};
use super::tiles::{TileLists, depth_order, tile_lists};
use crate::backend::Real;
use crate::error::Result;
use crate::raster::settings::{Settings, Splats};
use crate::splat::camera::Camera;
use rayon::prelude::*;
use std::marker::PhantomData;

/// Gaussians that one task projects.
pub(super) const CHUNK: usize = 1024;

/// One view: projection and tile lists, computed once and shared by all passes.
#[derive(Clone, Debug)]
pub struct Projected<E> {
    pub(in crate::raster) viewpoint: Viewpoint,
    pub(in crate::raster) settings: Settings,
    /// Visible Gaussians front to back.
    pub(in crate::raster) splats: Vec<Splat2>,
    /// Index of each in the scene.
    pub(in crate::raster) ids: Vec<u32>,
    pub(in crate::raster) tiles: TileLists,
    radii: Vec<u32>,
    scalar: PhantomData<E>,
}

/// A blended image.
#[derive(Clone, Debug, PartialEq)]
pub struct Blended<E> {
    /// `sum_i alpha'_i T_i s_i`, `[H, W, C]`, without background.
    pub image: Vec<E>,
    /// What is left of the background, `[H, W]`, in (0, 1].
    pub transmittance: Vec<E>,
}

impl<E: Real> Projected<E> {
    /// Projects and sorts `splats` for `camera`.
    ///
    /// Culled: Gaussians at or before the near plane, with an alpha_min ellipse that is empty or outside the image, or
    /// whose projection overflows.
    ///
    /// # Errors
    /// [`crate::Error::Config`] for settings out of range; [`crate::Error::Argument`] for array lengths that disagree or an unusable
    /// camera;
    /// [`crate::Error::NonFinite`] for a NaN or an infinity in `splats`; [`crate::Error::Limit`] for tile lists of more than 2^28 entries.
    pub fn new(splats: &Splats<'_, E>, camera: &Camera, settings: &Settings) -> Result<Self> {
        settings.check()?;
        splats.check()?;
        let viewpoint = Viewpoint::new(camera)?;
        let n = splats.len();
        let mut radii = vec![0; n];
        let chunks: Vec<Vec<Visible>> = radii
            .par_chunks_mut(CHUNK)
            .enumerate()
            .map(|(chunk, radii)| project(splats, chunk * CHUNK, &viewpoint, settings, radii))
            .collect();
        // Depths of the visible ones, and where in `chunks` they are.
        let count = chunks.iter().map(Vec::len).sum();
        let mut depths = Vec::with_capacity(count);
        let mut places = Vec::with_capacity(count);
        for (chunk, visible) in chunks.iter().enumerate() {
            depths.extend(visible.iter().map(|v| v.depth));
            places.extend((0..visible.len()).map(|i| (chunk * CHUNK + i) as u32));
        }
        let (mut ids, mut ordered): (Vec<u32>, Vec<Splat2>) = Default::default();
        depth_order(&depths)
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|i| {
                let place = places[i as usize] as usize;
                let Visible { id, splat, .. } = chunks[place / CHUNK][place % CHUNK];
                (id, splat)
            })
            .unzip_into_vecs(&mut ids, &mut ordered);
        let tiles = tile_lists(&ordered, viewpoint.size)?;
        Ok(Self {
            viewpoint,
            settings: *settings,
            splats: ordered,
            ids,
            tiles,
            radii,
            scalar: PhantomData,
        })
    }

    /// Number of Gaussians given, visible or not.
    pub fn len(&self) -> usize {
        self.radii.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.radii.is_empty()
    }

    /// Image width and height, pixels.
    pub fn size(&self) -> [usize; 2] {
        self.viewpoint.size
    }

    /// `ceil(3 sqrt(lambda_max))` of the 2D covariance in pixels, `[N]`; 0 = culled.
    pub fn radii(&self) -> &[u32] {
        &self.radii
    }

    /// Entries of all tile lists.
    pub fn tile_entries(&self) -> usize {
        self.tiles.ranks.len()
    }

    /// Position in depth order of each Gaussian of the scene, `u32::MAX` for a culled one.
    pub(super) fn ranks(&self) -> Vec<u32> {
        let mut ranks = vec![u32::MAX; self.len()];
        for (rank, &id) in (0..).zip(&self.ids) {
            ranks[id as usize] = rank;
        }
        ranks
    }

    /// Rows of `values` `[N, channels]` of the visible Gaussians, front to back, each padded with zeros to `width`.
    pub(in crate::raster) fn in_depth_order(
        &self,
        values: &[E],
        channels: usize,
        width: usize,
    ) -> Vec<E> {
        let mut out = vec![E::zero(); self.ids.len() * width];
        if width == 0 {
            return out;
        }
        out.par_chunks_mut(width * CHUNK)
            .zip(self.ids.par_chunks(CHUNK))
            .for_each(|(out, ids)| {
                for (out, &id) in out.chunks_exact_mut(width).zip(ids) {
                    out[..channels].copy_from_slice(&values[id as usize * channels..][..channels]);
                }
            });
        out
    }

    /// The inverse of [`Projected::in_depth_order`]; rows of culled Gaussians are zero.
    pub(in crate::raster) fn in_scene_order(&self, rows: &[E], channels: usize) -> Vec<E> {
        let mut out = vec![E::zero(); self.len() * channels];
        if channels == 0 {
            return out;
        }
        for (row, &id) in rows.chunks_exact(channels).zip(&self.ids) {
            out[id as usize * channels..][..channels].copy_from_slice(row);
        }
        out
    }
}
