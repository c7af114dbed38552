//! The handwritten backward pass.
//!
//! Front to back, with the forward pass's own transmittances. For a pixel let `d_i = dL/dS . s_i`; then
//! `dL/dalpha'_i = T_i d_i - R_i / (1 - alpha'_i)`. `R_i = sum_(j > i) w_j d_j + dL/dT T` is the rest of
//! `dL/dS . S + dL/dT T` after the first `i` Gaussians. One running scalar per pixel, whatever the number of channels.
//!
//! AbsGS (Ye et al. 2024) sums the absolute values of each pixel's gradient of the projected centres. The kernels add these
//! sums when `ABSOLUTE`.

use super::blend::tile_image;
use super::channel_blocks;
use super::footprint::{Buffer, Footprint, Rule, Splat2, Tile, fresh_transmittance};
use super::moments::{MOMENTS, Moments, drift};
use super::parameter_gradients::SplatGradients;
use super::pixel_gradients::{PixelGradients, geometry_sums};
use super::projected::Projected;
use super::tile_loop::{LIVE_CHECK_INTERVAL, Pass, gather_rows, sum_over_tiles, walk};
use crate::backend::Real;
use crate::backend::simd::{Kernel, Lanes};
use crate::raster::settings::Splats;

/// Sums of a list entry, at most.
const MAX_SUMS: usize = 11;

struct BackwardTile<'a, E, const C: usize, const ABSOLUTE: bool> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    /// `[visible, C]`.
    values: &'a [E],
    pixels: PixelGradients<'a, E>,
    /// `[entries, geometry_sums + C]`: moments, gradients of the values, and sums of absolute values.
    sums: &'a mut [E],
}

impl<E: Real, const C: usize, const ABSOLUTE: bool> Kernel<E> for BackwardTile<'_, E, C, ABSOLUTE> {
    type Output = ();

    #[inline(always)]
    fn run<S: Lanes<E>>(self, s: S) {
        let size = self.p.size();
        let mut pass = BackwardPass::<E, S, C, ABSOLUTE> {
            rule: Rule::new(s, &self.p.settings),
            values: self.values,
            splats: &self.p.splats,
            t: fresh_transmittance(self.tile, size),
            rest: Buffer::zeros(),
            d_image: tile_image(self.pixels.d_image, self.tile, size),
            g: Buffer::zeros(),
            near: [[E::zero(); C]; LIVE_CHECK_INTERVAL],
            drifts: [[E::zero(); 3]; LIVE_CHECK_INTERVAL],
            sums: self.sums,
        };
        for (to, from, len) in self.tile.rows(size) {
            for x in 0..len {
                pass.rest.0[to + x] = self.pixels.budget(from + x, C);
            }
        }
        walk(s, self.p, self.tile, &mut pass);
    }
}

struct BackwardPass<'a, E, S: Lanes<E>, const C: usize, const ABSOLUTE: bool> {
    rule: Rule<E, S>,
    values: &'a [E],
    splats: &'a [Splat2],
    t: Buffer<E>,
    /// `R` of every pixel.
    rest: Buffer<E>,
    d_image: [Buffer<E>; C],
    /// `dL/dalpha' alpha'` of the present Gaussian.
    g: Buffer<E>,
    /// Values of the next Gaussians, and [`drift`] of each when `ABSOLUTE`.
    near: [[E; C]; LIVE_CHECK_INTERVAL],
    drifts: [[E; 3]; LIVE_CHECK_INTERVAL],
    sums: &'a mut [E],
}

impl<E: Real, S: Lanes<E>, const C: usize, const ABSOLUTE: bool> Pass<E>
    for BackwardPass<'_, E, S, C, ABSOLUTE>
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
        if footprint.strips == 0 {
            return;
        }
        let width = geometry_sums(ABSOLUTE) + C;
        let d_value = self.share_out(next, footprint);
        // A second loop, because the sums of both do not fit into 16 registers.
        let Moments {
            moments,
            minus_absolute,
            ..
        } = self.moments(next, footprint);
        let s = self.rule.s;
        let mut registers = [s.splat(E::zero()); MAX_SUMS];
        let all = moments.into_iter().chain(d_value).chain(minus_absolute);
        registers
            .iter_mut()
            .zip(all)
            .for_each(|(to, sum)| *to = sum);
        let sums = &mut self.sums[entry * width..][..width];
        s.write_totals(&registers[..width], sums);
        if ABSOLUTE {
            sums[MOMENTS + C..].iter_mut().for_each(|sum| *sum = -*sum);
        }
    }
}

impl<E: Real, S: Lanes<E>, const C: usize, const ABSOLUTE: bool>
    BackwardPass<'_, E, S, C, ABSOLUTE>
{
    /// Leaves `dL/dalpha' alpha'` of the Gaussian in `g`; the gradient of its values.
    #[inline(always)]
    fn share_out(&mut self, next: usize, footprint: &Footprint<E>) -> [S::V; C] {
        let s = self.rule.s;
        let value = self.near[next].map(|value| s.splat(value));
        let mut d_value = [s.splat(E::zero()); C];
        footprint.for_each(|strip| {
            let (alpha, weight) = self.rule.absorb(footprint, &mut self.t, strip);
            let mut d = s.splat(E::zero());
            for c in 0..C {
                let g = self.d_image[c].get::<S>(strip);
                d = s.mul_add(g, value[c], d);
                d_value[c] = s.mul_add(weight, g, d_value[c]);
            }
            let own = s.mul(weight, d);
            let rest = s.sub(self.rest.get::<S>(strip), own);
            self.rest.set::<S>(strip, rest);
            self.g
                .set::<S>(strip, self.rule.alpha_gradient(alpha, own, rest));
        });
        d_value
    }

    #[inline(always)]
    fn moments(&self, next: usize, footprint: &Footprint<E>) -> Moments<E, S, ABSOLUTE> {
        let s = self.rule.s;
        let mut moments = Moments::new(s, self.drifts[next]);
        footprint.for_each(|strip| {
            let v = s.splat(footprint.v(strip));
            moments.add(self.g.get::<S>(strip), footprint.u(s, strip), v);
        });
        moments
    }
}

fn fused<E: Real, const C: usize, const ABSOLUTE: bool>(
    p: &Projected<E>,
    values: &[E],
    pixels: PixelGradients<'_, E>,
) -> Vec<E> {
    let values = p.in_depth_order(values, C, C);
    sum_over_tiles(p, geometry_sums(ABSOLUTE) + C, |tile, sums| {
        E::dispatch(BackwardTile::<E, C, ABSOLUTE> {
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
    /// Gradients of a loss through [`Projected::blend`] and the projection, with [`SplatGradients::screen_absolute`] when
    /// `absolute`. `splats` and `values` (`[N, channels]`) are the inputs of the forward pass.
    ///
    /// # Panics
    /// If the lengths disagree.
    pub fn backward(
        &self,
        splats: &Splats<'_, E>,
        values: &[E],
        channels: usize,
        pixels: PixelGradients<'_, E>,
        absolute: bool,
    ) -> SplatGradients<E> {
        let pixel_count = self.size()[0] * self.size()[1];
        let n = self.len();
        let same = |name: &str, found: usize, expected: usize| {
            assert_eq!(found, expected, "backward: length of {name}");
        };
        same("splats", splats.len(), n);
        same("values", values.len(), n * channels);
        same("image", pixels.image.len(), pixel_count * channels);
        same("d_image", pixels.d_image.len(), pixel_count * channels);
        same("transmittance", pixels.transmittance.len(), pixel_count);
        if let Some(d) = pixels.d_transmittance {
            same("d_transmittance", d.len(), pixel_count);
        }
        if channels == 0 {
            // There is still the transmittance: one channel of zeros.
            let zeros = vec![E::zero(); n.max(pixel_count)];
            let pixels = PixelGradients {
                image: &zeros[..pixel_count],
                d_image: &zeros[..pixel_count],
                ..pixels
            };
            let mut out = self.backward(splats, &zeros[..n], 1, pixels, absolute);
            out.values.clear();
            return out;
        }
        let sums = if absolute {
            pixel_sums::<E, true>(self, values, channels, pixels)
        } else {
            pixel_sums::<E, false>(self, values, channels, pixels)
        };
        self.parameter_gradients(splats, &sums, channels, absolute)
    }
}
