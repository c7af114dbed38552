//! One view of the Gaussians: projected, sorted, binned; and the linear map that blending then is.

use super::blend;
use super::channel_blocks;
use super::disc_pixels::{count, count_used};
use super::footprint::Splat2;
use super::geometry::Viewpoint;
use super::labels;
use super::projection::{Visible, project};
use super::sh::visible_colours;
use super::tiles::{TileLists, depth_order, tile_lists};
use super::weights;
use crate::backend::Real;
use crate::data::mask::Mask;
use crate::error::Result;
use crate::ops::SparseMatrix;
use crate::raster::settings::{Settings, Splats, Stats};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use rayon::prelude::*;
use std::marker::PhantomData;

/// Gaussians that one task projects.
const CHUNK: usize = 1024;

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
    stats: Stats,
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
    /// whose projection overflows; [`Projected::stats`] counts them.
    ///
    /// # Errors
    /// [`crate::Error::Config`] for settings out of range; [`crate::Error::Argument`] for array lengths that disagree or an unusable
    /// camera;
    /// [`crate::Error::NonFinite`] for a NaN or an infinity in `splats`; [`crate::Error::Limit`] for tile lists beyond 2^32.
    pub fn new(splats: &Splats<'_, E>, camera: &Camera, settings: &Settings) -> Result<Self> {
        settings.check()?;
        splats.check()?;
        let viewpoint = Viewpoint::new(camera)?;
        let n = splats.len();
        let mut radii = vec![0; n];
        let chunks: Vec<(Vec<Visible>, Stats)> = radii
            .par_chunks_mut(CHUNK)
            .enumerate()
            .map(|(chunk, radii)| {
                let mut visible = Vec::with_capacity(radii.len());
                let stats = project(
                    splats,
                    chunk * CHUNK,
                    &viewpoint,
                    settings,
                    radii,
                    &mut visible,
                );
                (visible, stats)
            })
            .collect();
        let mut stats = Stats::default();
        for (_, s) in &chunks {
            stats.gaussians += s.gaussians;
            stats.visible += s.visible;
            stats.behind += s.behind;
            stats.off_screen += s.off_screen;
            stats.non_finite += s.non_finite;
            stats.zero_quaternions += s.zero_quaternions;
        }
        // Depths of the visible ones, and where in `chunks` they are.
        let (mut depths, mut places) = (
            Vec::with_capacity(stats.visible),
            Vec::with_capacity(stats.visible),
        );
        for (chunk, (visible, _)) in chunks.iter().enumerate() {
            depths.extend(visible.iter().map(|v| v.depth));
            places.extend((0..visible.len()).map(|i| (chunk * CHUNK + i) as u32));
        }
        let (mut ids, mut ordered): (Vec<u32>, Vec<Splat2>) = Default::default();
        depth_order(&depths)
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|i| {
                let place = places[i as usize] as usize;
                let Visible { id, splat, .. } = chunks[place / CHUNK].0[place % CHUNK];
                (id, splat)
            })
            .unzip_into_vecs(&mut ids, &mut ordered);
        let tiles = tile_lists(&ordered, viewpoint.size)?;
        stats.tile_entries = tiles.ranks.len();
        Ok(Self {
            viewpoint,
            settings: *settings,
            splats: ordered,
            ids,
            tiles,
            radii,
            stats,
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

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.splats[..])
            + size_of_val(&self.ids[..])
            + size_of_val(&self.radii[..])
            + self.tiles.bytes()
    }

    /// Image width and height, pixels.
    pub fn size(&self) -> [usize; 2] {
        self.viewpoint.size
    }

    /// `S = W s` (Eq. 3-4) and the transmittance: `values` is `[N, channels]`, the image `[H, W, channels]`.
    ///
    /// # Panics
    /// If `values` does not have `N * channels` entries.
    pub fn blend(&self, values: &[E], channels: usize) -> Blended<E> {
        assert_eq!(
            values.len(),
            self.len() * channels,
            "blend: values against Gaussians times channels"
        );
        match channels {
            0 => blend::blend::<E, 0>(self, &[], 0),
            1 => blend::blend::<E, 1>(self, &self.in_depth_order(values, 1, 1), 1),
            2 | 3 => {
                blend::blend::<E, 3>(self, &self.in_depth_order(values, channels, 3), channels)
            }
            4..=8 => {
                blend::blend::<E, 8>(self, &self.in_depth_order(values, channels, 8), channels)
            }
            9..=16 => {
                blend::blend::<E, 16>(self, &self.in_depth_order(values, channels, 16), channels)
            }
            17..=24 => {
                blend::blend::<E, 24>(self, &self.in_depth_order(values, channels, 24), channels)
            }
            _ => channel_blocks::blend(self, values, channels),
        }
    }

    /// [`Projected::blend`] of `values`, `[N, C]`, and the label of each pixel, `[H, W]`: that whose Gaussians have the largest
    /// summed alpha' T, ties to the lower one, and 0 where there are none. `labels` has one for each Gaussian.
    ///
    /// # Panics
    /// If `values` does not have `N * C` entries, or `labels` N.
    pub fn blend_labels<const C: usize>(
        &self,
        values: &[E],
        labels: &[u16],
    ) -> (Blended<E>, Vec<u16>) {
        assert_eq!(
            values.len(),
            self.len() * C,
            "blend_labels: values against Gaussians times channels"
        );
        assert_eq!(
            labels.len(),
            self.len(),
            "blend_labels: one label a Gaussian"
        );
        let labels: Vec<u16> = self.ids.iter().map(|&id| labels[id as usize]).collect();
        labels::blend::<E, C>(self, &self.in_depth_order(values, C, C), &labels)
    }

    /// `W^T y`: `image` is `[H, W, channels]`, the result `[N, channels]`; the adjoint of [`Projected::blend`].
    ///
    /// # Panics
    /// If `image` does not have `H * W * channels` entries.
    pub fn blend_adjoint(&self, image: &[E], channels: usize) -> Vec<E> {
        let [w, h] = self.size();
        assert_eq!(
            image.len(),
            w * h * channels,
            "blend_adjoint: image against pixels times channels"
        );
        let sums = match channels {
            0 => return Vec::new(),
            1 => blend::adjoint::<E, 1>(self, image),
            3 => blend::adjoint::<E, 3>(self, image),
            _ => channel_blocks::adjoint(self, image, channels),
        };
        self.in_scene_order(&sums, channels)
    }

    /// `W^T 1`: the sum of alpha' T over all pixels, `[N]`.
    pub fn weight_sums(&self) -> Vec<E> {
        let [w, h] = self.size();
        self.blend_adjoint(&vec![E::one(); w * h], 1)
    }

    /// `W` itself: rows are `pixels` (row-major indices; all when `None`), columns the N Gaussians, entries front to back.
    ///
    /// Values are exactly the weights that [`Projected::blend`] applies, rounded to `f32`.
    ///
    /// # Panics
    /// If a pixel index is outside the image.
    pub fn weights(&self, pixels: Option<&[u32]>) -> SparseMatrix {
        weights::weights(self, pixels)
    }

    /// Algorithm 1's counter: pixels whose centre lies within [`Projected::radii`] of the projected centre, in the image.
    pub fn counts(&self) -> Vec<u32> {
        self.used_counts(None)
    }

    /// [`Projected::counts`] of the pixels that `mask`, of the camera's size, uses.
    pub fn used_counts(&self, mask: Option<&Mask>) -> Vec<u32> {
        let disc = |(splat, &id): (&Splat2, &u32)| (splat.center, self.radii[id as usize]);
        let discs: Vec<_> = self
            .splats
            .par_iter()
            .zip(&self.ids)
            .with_min_len(CHUNK)
            .map(disc)
            .collect();
        let mut visible = vec![0; discs.len()];
        let before = mask.map(|mask| used_before(mask, self.size()));
        let chunks = visible.par_chunks_mut(CHUNK).zip(discs.par_chunks(CHUNK));
        chunks.for_each(|(counts, discs)| match &before {
            Some(before) => count_used(discs, self.size(), before, counts),
            None => count(discs, self.size(), counts),
        });
        let mut counts = vec![0; self.len()];
        for (count, &id) in visible.into_iter().zip(&self.ids) {
            counts[id as usize] = count;
        }
        counts
    }

    /// `ceil(3 sqrt(lambda_max))` of the 2D covariance in pixels, `[N]`; 0 = culled.
    pub fn radii(&self) -> &[u32] {
        &self.radii
    }

    /// What was culled and why.
    pub fn stats(&self) -> Stats {
        self.stats
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

/// A picture of the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// Colour, `[H, W, 3]`, background included, not clamped.
    pub rgb: Vec<f32>,
    /// What shows of the background, `[H, W]`.
    pub transmittance: Vec<f32>,
    /// What was culled and why.
    pub stats: Stats,
}

/// For each row how many pixels are used before each one, and at last in all, `[height, width + 1]`.
fn used_before(mask: &Mask, [width, height]: [usize; 2]) -> Vec<u32> {
    let mut before = Vec::with_capacity(height * (width + 1));
    for row in 0..height {
        let mut sum = 0;
        before.push(sum);
        before.extend((row * width..(row + 1) * width).map(|pixel| {
            sum += u32::from(mask.uses(pixel));
            sum
        }));
    }
    before
}

/// Renders the colours of `gaussians` seen by `camera` over `background`.
///
/// # Errors
/// As [`Projected::new`], and [`crate::Error::NonFinite`] for the SH coefficients.
pub fn render(
    gaussians: &Gaussians,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
) -> Result<Rendered> {
    let projected = Projected::new(&gaussians.splats(), camera, settings)?;
    let blended = projected.blend(&projected.colours(gaussians, camera)?, 3);
    let Blended {
        image,
        transmittance,
    } = blended.over(background);
    Ok(Rendered {
        rgb: image,
        transmittance,
        stats: projected.stats(),
    })
}

impl Projected<f32> {
    /// Colours of `gaussians`, whose projection this is, seen by `camera`, `[N, 3]`; zeros where they are culled.
    ///
    /// # Errors
    /// [`crate::Error::NonFinite`] for the SH coefficients.
    pub(crate) fn colours(&self, gaussians: &Gaussians, camera: &Camera) -> Result<Vec<f32>> {
        let (degree, center) = (gaussians.sh_degree, camera.center.to_array());
        visible_colours(
            gaussians.means.as_flattened(),
            &gaussians.sh,
            degree,
            degree,
            center,
            self.radii(),
        )
    }
}

impl Blended<f32> {
    /// Three channels, the colours, with what shows of `background`.
    pub(crate) fn over(mut self, background: [f32; 3]) -> Self {
        for (pixel, &t) in self.image.chunks_exact_mut(3).zip(&self.transmittance) {
            for (value, &b) in pixel.iter_mut().zip(&background) {
                *value += t * b;
            }
        }
        self
    }
}
