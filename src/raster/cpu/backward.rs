//! The handwritten backward pass.
//!
//! Front to back, with the forward pass's own transmittances. For a pixel let `d_i = dL/dS . s_i`; then
//! `dL/dalpha'_i = T_i d_i - R_i / (1 - alpha'_i)` with `R_i = sum_(j > i) w_j d_j + dL/dT T`: what is left of
//! `dL/dS . S + dL/dT T` after the first `i` Gaussians. One running scalar per pixel, whatever the number of channels.
//!
//! AbsGS (Ye et al. 2024) asks for the absolute values of the gradients of the projected centres before they are summed
//! over the pixels. The kernels do so when `ABSOLUTE`, and are otherwise those without.

use super::blend::tile_image;
use super::channel_blocks;
use super::footprint::{Buffer, Footprint, Rule, STRIPS, Splat2, UNIT, fresh_transmittance};
use super::geometry::{Moments, Splat3, project_backward};
use super::projected::{Blended, Projected};
use super::tile_loop::{LOOK, Pass, Tile, gather_rows, sum_over_tiles, walk};
use crate::backend::Real;
use crate::backend::simd::{Kernel, dispatch};
use crate::backend::vector::{LANES, Vector};
use crate::raster::settings::Splats;
use rayon::prelude::*;

/// Gaussians that one task handles.
const CHUNK: usize = 512;
/// Gaussians whose sums are read together.
const NEAR: usize = 16;

/// Gradients of all that [`Projected::blend`] depends on; rows of culled Gaussians are zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatGradients<E> {
    /// `[N, 3]`.
    pub means: Vec<E>,
    /// `[N, 3]`.
    pub log_scales: Vec<E>,
    /// `[N, 4]`.
    pub rotations: Vec<E>,
    /// `[N]`.
    pub opacity_logits: Vec<E>,
    /// Of the blended values, `[N, C]`.
    pub values: Vec<E>,
    /// Of the projected centres, in units of half the image: `(dL/du W/2, dL/dv H/2)`, `[N, 2]`.
    pub screen: Vec<E>,
    /// Sums of the absolute values of what single pixels add to `screen`, `[N, 2]`; empty unless asked for.
    pub screen_absolute: Vec<E>,
}

/// Sums of a row besides those of the values, for each Gaussian: moments, and the two of absolute values.
pub(in crate::raster) const fn geometry_sums(absolute: bool) -> usize {
    if absolute { 8 } else { 6 }
}

/// By how much the kernels' `u` and `v` grow as the centre moves by a pixel: `u` along x, `u` along y, `v` along y.
#[inline(always)]
pub(in crate::raster) fn drift<E: Real>(s: &Splat2) -> [E; 3] {
    [UNIT * s.du, -UNIT * s.du * s.slope, UNIT * s.dv].map(E::of)
}

/// What the backward pass over a tile reads besides the projection.
#[derive(Clone, Copy)]
pub(in crate::raster) struct PixelGradients<'a, E> {
    /// What was rendered, `[H, W, C]`, background included.
    pub image: &'a [E],
    pub transmittance: &'a [E],
    pub d_image: &'a [E],
    pub d_transmittance: Option<&'a [E]>,
}

impl<E: Real> PixelGradients<'_, E> {
    /// `d_image . image + d_transmittance transmittance` of a pixel: the part of the loss's differential that is still
    /// to be shared out before the first Gaussian.
    #[inline(always)]
    pub fn budget(&self, pixel: usize, channels: usize) -> E {
        let at = pixel * channels;
        let mut sum = self
            .d_transmittance
            .map_or(E::zero(), |d| d[pixel] * self.transmittance[pixel]);
        for c in 0..channels {
            sum += self.d_image[at + c] * self.image[at + c];
        }
        sum
    }
}

struct BackwardTile<'a, E, const C: usize, const ABSOLUTE: bool> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    /// `[visible, C]`.
    values: &'a [E],
    pixels: PixelGradients<'a, E>,
    /// `[entries, geometry_sums + C]`: moments, gradients of the values, and sums of absolute values.
    sums: &'a mut [E],
}

struct BackwardPass<'a, E, V, const C: usize, const ABSOLUTE: bool> {
    rule: Rule<V>,
    values: &'a [E],
    splats: &'a [Splat2],
    t: Buffer<E>,
    /// `R` of every pixel.
    rest: Buffer<E>,
    d_image: [Buffer<E>; C],
    /// `dL/dalpha' alpha'` of the present Gaussian.
    g: Buffer<E>,
    /// Values of the next Gaussians, and [`drift`] of each when `ABSOLUTE`.
    near: [[E; C]; LOOK],
    drifts: [[E; 3]; LOOK],
    sums: &'a mut [E],
}

impl<E: Real, V: Vector<E>, const C: usize, const ABSOLUTE: bool> Pass<E, V>
    for BackwardPass<'_, E, V, C, ABSOLUTE>
{
    #[inline(always)]
    fn transmittance(&self) -> &Buffer<E> {
        &self.t
    }

    #[inline(always)]
    fn gather(&mut self, ranks: &[u32]) {
        gather_rows(self.values, ranks, &mut self.near);
        if ABSOLUTE {
            for (drift_of, &rank) in self.drifts.iter_mut().zip(ranks) {
                *drift_of = drift(&self.splats[rank as usize]);
            }
        }
    }

    #[inline(always)]
    fn take(&mut self, next: usize, entry: usize, footprint: &Footprint<E>) {
        let value = self.near[next].map(V::splat);
        let mut d_value = [V::splat(E::zero()); C];
        footprint.for_each(|strip| {
            let (mut alpha, mut t) = (footprint.alpha(strip, &self.rule), V::load(&self.t[strip]));
            let weight = self.rule.absorb(&mut alpha, &mut t);
            t.store(&mut self.t[strip]);
            let mut d = V::splat(E::zero());
            for c in 0..C {
                let g = V::load(&self.d_image[c][strip]);
                d = g.fma(value[c], d);
                d_value[c] = weight.fma(g, d_value[c]);
            }
            let own = weight.mul(d);
            let rest = V::load(&self.rest[strip]).sub(own);
            rest.store(&mut self.rest[strip]);
            let g = rest.fnma(alpha.div(self.rule.one().sub(alpha)), own);
            self.rule.below_cap(alpha, g).store(&mut self.g[strip]);
        });
        // A second loop, because the sums of both do not fit into 16 registers.
        let mut moments = [V::splat(E::zero()); 6];
        let mut minus_absolute = [V::splat(E::zero()); 2];
        let [u_x, u_y, v_y] = self.drifts[next].map(V::splat);
        footprint.for_each(|strip| {
            let (g, u, v) = (
                V::load(&self.g[strip]),
                footprint.u::<V>(strip),
                V::splat(footprint.v(strip)),
            );
            let (gu, gv) = (g.mul(u), g.mul(v));
            let [m, m_u, m_v, m_uu, m_uv, m_vv] = &mut moments;
            *m = m.add(g);
            *m_u = m_u.add(gu);
            *m_v = m_v.add(gv);
            *m_uu = gu.fma(u, *m_uu);
            *m_uv = gu.fma(v, *m_uv);
            *m_vv = gv.fma(v, *m_vv);
            if ABSOLUTE {
                let [x, y] = &mut minus_absolute;
                *x = x.add(gu.mul(u_x).minus_abs());
                *y = y.add(gv.fma(v_y, gu.mul(u_y)).minus_abs());
            }
        });
        let width = geometry_sums(ABSOLUTE) + C;
        let sums = &mut self.sums[entry * width..][..width];
        for (to, sum) in sums.iter_mut().zip(moments.into_iter().chain(d_value)) {
            *to = sum.total();
        }
        if ABSOLUTE {
            for (to, sum) in sums[6 + C..].iter_mut().zip(minus_absolute) {
                *to = -sum.total();
            }
        }
    }
}

impl<E: Real, const C: usize, const ABSOLUTE: bool> Kernel<E> for BackwardTile<'_, E, C, ABSOLUTE> {
    type Output = ();
    #[inline(always)]
    fn run<V: Vector<E>>(self) {
        let Self {
            p,
            tile,
            values,
            pixels,
            sums,
        } = self;
        let mut pass = BackwardPass::<E, V, C, ABSOLUTE> {
            rule: Rule::new::<E>(&p.settings),
            values,
            splats: &p.splats,
            t: fresh_transmittance(tile, p.size()),
            rest: [[E::zero(); LANES]; STRIPS],
            d_image: tile_image(pixels.d_image, tile, p.size()),
            g: [[E::zero(); LANES]; STRIPS],
            near: [[E::zero(); C]; LOOK],
            drifts: [[E::zero(); 3]; LOOK],
            sums,
        };
        for (to, from, len) in tile.rows(p.size()) {
            for x in 0..len {
                pass.rest.as_flattened_mut()[to + x] = pixels.budget(from + x, C);
            }
        }
        walk(p, tile, &mut pass);
    }
}

/// Six sums of kernels as [`Moments`].
fn moments<E: Real>(m: &[E]) -> Moments {
    let (first, second) = (UNIT.recip(), (UNIT * UNIT).recip());
    Moments {
        one: m[0].wide(),
        u: first * m[1].wide(),
        v: first * m[2].wide(),
        uu: second * m[3].wide(),
        uv: second * m[4].wide(),
        vv: second * m[5].wide(),
    }
}

fn fused<E: Real, const C: usize, const ABSOLUTE: bool>(
    p: &Projected<E>,
    values: &[E],
    pixels: PixelGradients<'_, E>,
) -> Vec<E> {
    let values = p.in_depth_order(values, C, C);
    sum_over_tiles(p, geometry_sums(ABSOLUTE) + C, |tile, sums| {
        dispatch(BackwardTile::<E, C, ABSOLUTE> {
            p,
            tile,
            values: &values,
            pixels,
            sums,
        });
    })
}

/// Rows of `geometry_sums + lanes` for every visible Gaussian, front to back.
fn pixel_sums<E: Real, const ABSOLUTE: bool>(
    p: &Projected<E>,
    values: &[E],
    lanes: usize,
    pixels: PixelGradients<'_, E>,
) -> Vec<E> {
    match lanes {
        1 => fused::<E, 1, ABSOLUTE>(p, values, pixels),
        3 => fused::<E, 3, ABSOLUTE>(p, values, pixels),
        _ => channel_blocks::backward::<E, ABSOLUTE>(p, values, lanes, pixels),
    }
}

impl<E: Real> Projected<E> {
    /// Gradients of a loss `L` through [`Projected::blend`] and the projection.
    ///
    /// `splats` and `values` (`[N, channels]`) are what was rendered, `forward` what came out (a background may have been
    /// added to its image: `image + T b`, and `d_image` is then taken to reach `T` through it), `d_image` `[H, W, channels]`
    /// and `d_transmittance` `[H, W]` are dL/d(output).
    ///
    /// # Panics
    /// If the lengths disagree.
    pub fn backward(
        &self,
        splats: &Splats<'_, E>,
        values: &[E],
        channels: usize,
        forward: &Blended<E>,
        d_image: &[E],
        d_transmittance: Option<&[E]>,
    ) -> SplatGradients<E> {
        let pixels = PixelGradients {
            image: &forward.image,
            transmittance: &forward.transmittance,
            d_image,
            d_transmittance,
        };
        self.backward_slices(splats, values, channels, pixels, false)
    }

    pub(in crate::raster) fn backward_slices(
        &self,
        splats: &Splats<'_, E>,
        values: &[E],
        channels: usize,
        pixels: PixelGradients<'_, E>,
        absolute: bool,
    ) -> SplatGradients<E> {
        let [w, h] = self.size();
        let n = self.len();
        assert_eq!(
            values.len(),
            n * channels,
            "backward: values against Gaussians times channels"
        );
        assert_eq!(splats.len(), n, "backward: splats against Gaussians");
        assert_eq!(
            pixels.image.len(),
            w * h * channels,
            "backward: image against pixels times channels"
        );
        assert_eq!(
            pixels.d_image.len(),
            w * h * channels,
            "backward: d_image against pixels times channels"
        );
        assert_eq!(
            pixels.transmittance.len(),
            w * h,
            "backward: transmittance against pixels"
        );
        assert!(
            pixels.d_transmittance.is_none_or(|d| d.len() == w * h),
            "backward: d_transmittance against pixels"
        );
        // Without channels there is still the transmittance: one channel of zeros.
        let nothing = if channels == 0 {
            vec![E::zero(); n.max(w * h)]
        } else {
            Vec::new()
        };
        let (pixels, values, lanes) = match channels {
            0 => {
                let image = &nothing[..w * h];
                (
                    PixelGradients {
                        image,
                        d_image: image,
                        ..pixels
                    },
                    &nothing[..n],
                    1,
                )
            }
            _ => (pixels, values, channels),
        };
        let mut out;
        if absolute {
            let sums = pixel_sums::<E, true>(self, values, lanes, pixels);
            let stride = geometry_sums(true) + lanes;
            out = self.to_parameters(splats, &sums, channels, stride);
            out.screen_absolute = self.screen_absolute(&sums, stride);
        } else {
            let sums = pixel_sums::<E, false>(self, values, lanes, pixels);
            out = self.to_parameters(splats, &sums, channels, geometry_sums(false) + lanes);
        }
        out
    }

    /// [`SplatGradients::screen_absolute`] from the last two of each row of `stride` sums.
    fn screen_absolute(&self, sums: &[E], stride: usize) -> Vec<E> {
        // The derivative of u^2 is 2 u, and the kernels' u and v are both longer by the unit than those of alpha'.
        let scale = self.size().map(|s| E::of(s as f64 / (UNIT * UNIT)));
        let rows = sums.chunks_exact(stride).flat_map(|row| {
            let [x, y] = [row[stride - 2], row[stride - 1]];
            [x * scale[0], y * scale[1]]
        });
        self.in_scene_order(&rows.collect::<Vec<E>>(), 2)
    }

    /// Gradients of the parameters from `sums`: a row of `stride` a visible Gaussian, moments and then values.
    fn to_parameters(
        &self,
        splats: &Splats<'_, E>,
        sums: &[E],
        channels: usize,
        stride: usize,
    ) -> SplatGradients<E> {
        let n = self.len();
        let mut ranks = vec![u32::MAX; n];
        for (&id, rank) in self.ids.iter().zip(0..) {
            ranks[id as usize] = rank;
        }
        let zeros = |width: usize| vec![E::zero(); n * width];
        let mut out = SplatGradients {
            means: zeros(3),
            log_scales: zeros(3),
            rotations: zeros(4),
            opacity_logits: zeros(1),
            values: zeros(channels),
            screen: zeros(2),
            screen_absolute: Vec::new(),
        };
        let half = self.size().map(|s| s as f64 / 2.0);
        // chunks_mut(0) panics; without channels no row has values.
        let value_rows = CHUNK * channels.max(1);
        let mut values: Vec<&mut [E]> = out.values.chunks_mut(value_rows).collect();
        values.resize_with(n.div_ceil(CHUNK), Default::default);
        out.means
            .par_chunks_mut(CHUNK * 3)
            .zip(out.log_scales.par_chunks_mut(CHUNK * 3))
            .zip(out.rotations.par_chunks_mut(CHUNK * 4))
            .zip(out.opacity_logits.par_chunks_mut(CHUNK))
            .zip(out.screen.par_chunks_mut(CHUNK * 2))
            .zip(values)
            .zip(ranks.par_chunks(CHUNK))
            .enumerate()
            .for_each(
                |(
                    chunk,
                    ((((((means, log_scales), rotations), logits), screen), values), ranks),
                )| {
                    let visible: Vec<_> = ranks
                        .iter()
                        .copied()
                        .enumerate()
                        .filter(|(_, rank)| *rank != u32::MAX)
                        .collect();
                    for visible in visible.chunks(NEAR) {
                        // All reads of far memory first, so that they wait for each other as little as possible.
                        let mut near = [(Splat2::default(), Moments::default()); NEAR];
                        for (near, &(row, rank)) in near.iter_mut().zip(visible) {
                            let (rank, sums) =
                                (rank as usize, &sums[rank as usize * stride..][..stride]);
                            *near = (self.splats[rank], moments(sums));
                            values[channels * row..][..channels]
                                .copy_from_slice(&sums[6..6 + channels]);
                        }
                        for ((projected, moments), &(row, _)) in near.iter().zip(visible) {
                            let splat = Splat3::read(splats, chunk * CHUNK + row);
                            let g = project_backward(
                                &splat,
                                &self.viewpoint,
                                projected,
                                moments,
                                self.settings.low_pass,
                            );
                            write(&mut means[3 * row..], g.mean);
                            write(&mut log_scales[3 * row..], g.log_scale);
                            write(&mut rotations[4 * row..], g.rotation);
                            write(
                                &mut screen[2 * row..],
                                [g.center[0] * half[0], g.center[1] * half[1]],
                            );
                            logits[row] = E::of(g.logit);
                        }
                    }
                },
            );
        out
    }
}

/// `values` at the start of `to`.
#[inline(always)]
fn write<E: Real, const K: usize>(to: &mut [E], values: [f64; K]) {
    to[..K].copy_from_slice(&values.map(E::of));
}
