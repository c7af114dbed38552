//! The handwritten backward pass.
//!
//! Front to back, with the forward pass's own transmittances. For a pixel let `d_i = dL/dS . s_i`; then
//! `dL/dalpha'_i = T_i d_i - R_i / (1 - alpha'_i)` with `R_i = sum_(j > i) w_j d_j + dL/dT T`: what is left of
//! `dL/dS . S + dL/dT T` after the first `i` Gaussians. One running scalar per pixel, whatever the number of channels.

use super::blend::{LOOK, Tile, lanes, store, sum_over_tiles, total};
use super::footprint::{BUFFER, Footprint, LANES, Rule, Visit, fresh_transmittance, live_rows, walk};
use super::geometry::{Gradient3, Splat3, project_backward};
use super::projected::{Blended, Projected};
use super::settings::Splats;
use super::simd::{Kernel, dispatch};
use super::tile_pairs::{self, PixelGradients, moments};
use crate::ops::Real;
use rayon::prelude::*;

/// Gaussians that one task handles.
const CHUNK: usize = 512;

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
}

struct BackwardTile<'a, E, const C: usize> {
    p: &'a Projected<E>,
    tile: Tile<'a>,
    values: &'a [E],
    pixels: PixelGradients<'a, E>,
    sums: &'a mut [E],
}

struct BackwardLanes<E, const C: usize> {
    rule: Rule<E>,
    t: [E; BUFFER],
    /// `R` of every pixel.
    rest: [E; BUFFER],
    d_image: [[E; BUFFER]; C],
    value: [E; C],
    moments: [[E; LANES]; 6],
    d_value: [[E; LANES]; C],
}

impl<E: Real, const C: usize> Visit<E> for BackwardLanes<E, C> {
    #[inline(always)]
    fn visit<const FUSED: bool>(&mut self, at: usize, u: E, v: E, f: &Footprint<E>) {
        let mut alpha = self.rule.alphas::<FUSED>(u, v, f);
        let mut t = lanes(&self.t, at);
        let weight = self.rule.absorb::<FUSED>(&mut alpha, &mut t);
        store(&mut self.t, at, &t);
        let mut d = [E::zero(); LANES];
        for c in 0..C {
            let g = lanes(&self.d_image[c], at);
            for l in 0..LANES {
                d[l] = g[l].fma::<FUSED>(self.value[c], d[l]);
                self.d_value[c][l] = weight[l].fma::<FUSED>(g[l], self.d_value[c][l]);
            }
        }
        let mut rest = lanes(&self.rest, at);
        let vv = v * v;
        let [m0, m1, m2, m3, m4, m5] = &mut self.moments;
        for l in 0..LANES {
            let own = weight[l] * d[l];
            rest[l] -= own;
            let g = own - rest[l] * (alpha[l] / (E::one() - alpha[l]));
            let g = if alpha[l] < self.rule.alpha_max { g } else { E::zero() };
            let u = E::of(l as f64).fma::<FUSED>(f.du, u);
            let gu = g * u;
            m0[l] += g;
            m1[l] += gu;
            m2[l] = g.fma::<FUSED>(v, m2[l]);
            m3[l] = gu.fma::<FUSED>(u, m3[l]);
            m4[l] = gu.fma::<FUSED>(v, m4[l]);
            m5[l] = g.fma::<FUSED>(vv, m5[l]);
        }
        store(&mut self.rest, at, &rest);
    }
}

impl<E: Real, const C: usize> Kernel for BackwardTile<'_, E, C> {
    type Output = ();
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Self { p, tile, values, pixels, sums } = self;
        let mut lanes = BackwardLanes::<E, C> {
            rule: Rule::new(&p.settings),
            t: fresh_transmittance(tile.origin, p.size()),
            rest: [E::zero(); BUFFER],
            d_image: [[E::zero(); BUFFER]; C],
            value: [E::zero(); C],
            moments: [[E::zero(); LANES]; 6],
            d_value: [[E::zero(); LANES]; C],
        };
        for (to, from, len) in tile.rows(p.size()) {
            for x in 0..len {
                lanes.rest[to + x] = pixels.budget(from + x, C);
                for c in 0..C {
                    lanes.d_image[c][to + x] = pixels.d_image[(from + x) * C + c];
                }
            }
        }
        let stride = 6 + C;
        for (ranks, sums) in tile.ranks.chunks(LOOK).zip(sums.chunks_mut(LOOK * stride)) {
            let live = live_rows(&lanes.t);
            if live == 0 {
                break;
            }
            for (&rank, sums) in ranks.iter().zip(sums.chunks_exact_mut(stride)) {
                let f = Footprint::new(&p.splats[rank as usize], tile.origin);
                lanes.value.copy_from_slice(&values[rank as usize * C..][..C]);
                lanes.moments = [[E::zero(); LANES]; 6];
                lanes.d_value = [[E::zero(); LANES]; C];
                walk::<E, _, FUSED>(&f, live, &mut lanes);
                for (sum, lanes) in sums.iter_mut().zip(lanes.moments.iter().chain(&lanes.d_value)) {
                    *sum = total(lanes);
                }
            }
        }
    }
}

fn fused<E: Real, const C: usize>(p: &Projected<E>, values: &[E], pixels: PixelGradients<'_, E>) -> Vec<E> {
    let values = p.in_depth_order(values, C, C);
    sum_over_tiles(p, 6 + C, |tile, sums| {
        dispatch(BackwardTile::<E, C> { p, tile, values: &values, pixels, sums });
    })
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
        let pixels =
            PixelGradients { image: &forward.image, transmittance: &forward.transmittance, d_image, d_transmittance };
        self.backward_slices(splats, values, channels, pixels)
    }

    pub(super) fn backward_slices(
        &self,
        splats: &Splats<'_, E>,
        values: &[E],
        channels: usize,
        pixels: PixelGradients<'_, E>,
    ) -> SplatGradients<E> {
        let [w, h] = self.size();
        let n = self.len();
        assert_eq!(values.len(), n * channels, "backward: values against Gaussians times channels");
        assert_eq!(splats.len(), n, "backward: splats against Gaussians");
        assert_eq!(pixels.image.len(), w * h * channels, "backward: image against pixels times channels");
        assert_eq!(pixels.d_image.len(), w * h * channels, "backward: d_image against pixels times channels");
        assert_eq!(pixels.transmittance.len(), w * h, "backward: transmittance against pixels");
        assert!(pixels.d_transmittance.is_none_or(|d| d.len() == w * h), "backward: d_transmittance against pixels");
        let sums = match channels {
            0 => fused::<E, 0>(self, values, pixels),
            1 => fused::<E, 1>(self, values, pixels),
            2 => fused::<E, 2>(self, values, pixels),
            3 => fused::<E, 3>(self, values, pixels),
            4 => fused::<E, 4>(self, values, pixels),
            _ => tile_pairs::backward(self, values, channels, pixels),
        };
        let stride = 6 + channels;
        let geometry: Vec<Gradient3> = sums
            .par_chunks(stride * CHUNK)
            .zip(self.ids.par_chunks(CHUNK))
            .zip(self.splats.par_chunks(CHUNK))
            .flat_map_iter(|((sums, ids), projected)| {
                sums.chunks_exact(stride).zip(ids).zip(projected).map(|((sums, &id), projected)| {
                    let splat = Splat3::read(splats, id as usize);
                    project_backward(&splat, &self.viewpoint, projected, &moments(sums), self.settings.low_pass)
                })
            })
            .collect();
        let zeros = |width: usize| vec![E::zero(); n * width];
        let mut out = SplatGradients {
            means: zeros(3),
            log_scales: zeros(3),
            rotations: zeros(4),
            opacity_logits: zeros(1),
            values: zeros(channels),
            screen: zeros(2),
        };
        let half = [w as f64 / 2.0, h as f64 / 2.0];
        for ((g, sums), &id) in geometry.iter().zip(sums.chunks_exact(stride)).zip(&self.ids) {
            let i = id as usize;
            for a in 0..3 {
                out.means[3 * i + a] = E::of(g.mean[a]);
                out.log_scales[3 * i + a] = E::of(g.log_scale[a]);
            }
            for a in 0..4 {
                out.rotations[4 * i + a] = E::of(g.rotation[a]);
            }
            for a in 0..2 {
                out.screen[2 * i + a] = E::of(g.center[a] * half[a]);
            }
            out.opacity_logits[i] = E::of(g.logit);
            out.values[i * channels..][..channels].copy_from_slice(&sums[6..]);
        }
        out
    }
}
