//! The handwritten backward pass.
//!
//! Front to back, with the forward pass's own transmittances. For a pixel let `d_i = dL/dS . s_i`; then
//! `dL/dalpha'_i = T_i d_i - R_i / (1 - alpha'_i)` with `R_i = sum_(j > i) w_j d_j + dL/dT T`: what is left of
//! `dL/dS . S + dL/dT T` after the first `i` Gaussians. One running scalar per pixel, whatever the number of channels.

use super::blend::{LOOK, Tile, sum_over_tiles};
use super::footprint::{BUFFER, Footprint, Lanes, Rule, Visit, fresh_transmittance, live_rows, load, store, walk};
use super::geometry::{Gradient3, Splat3, project_backward};
use super::projected::{Blended, Projected};
use super::settings::Splats;
use super::tile_pairs::{self, PixelGradients, moments};
use crate::ops::Real;
use crate::ops::vector::{Kernel, Vector, dispatch};
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

struct BackwardLanes<E, V, const C: usize> {
    rule: Rule<V>,
    t: [E; BUFFER],
    /// `R` of every pixel.
    rest: [E; BUFFER],
    d_image: [[E; BUFFER]; C],
    value: [V; C],
    moments: [V; 6],
    d_value: [V; C],
}

impl<E: Real, V: Vector<E>, const C: usize> Visit<E, V> for BackwardLanes<E, V, C> {
    #[inline(always)]
    fn visit(&mut self, at: usize, pair: &Lanes<E, V>) {
        let (mut alpha, mut t) = (pair.alpha, load(&self.t, at));
        let weight = self.rule.absorb(&mut alpha, &mut t);
        store(&mut self.t, at, t);
        let mut d = V::splat(E::zero());
        for c in 0..C {
            let g = load::<E, V>(&self.d_image[c], at);
            d = g.fma(self.value[c], d);
            self.d_value[c] = weight.fma(g, self.d_value[c]);
        }
        let own = weight.mul(d);
        let rest = load::<E, V>(&self.rest, at).sub(own);
        store(&mut self.rest, at, rest);
        let g = rest.fnma(alpha.div(self.rule.one().sub(alpha)), own);
        let g = self.rule.below_cap(alpha, g);
        let gu = g.mul(pair.u);
        let [one, u, v, uu, uv, vv] = &mut self.moments;
        *one = one.add(g);
        *u = u.add(gu);
        *v = g.fma(V::splat(pair.v), *v);
        *uu = gu.fma(pair.u, *uu);
        *uv = gu.fma(V::splat(pair.v), *uv);
        *vv = g.fma(V::splat(pair.v * pair.v), *vv);
    }
}

impl<E: Real, const C: usize> Kernel<E> for BackwardTile<'_, E, C> {
    type Output = ();
    #[inline(always)]
    fn run<V: Vector<E>>(self) {
        let Self { p, tile, values, pixels, sums } = self;
        let rule = Rule::new::<E>(&p.settings);
        let zero = V::splat(E::zero());
        let mut lanes = BackwardLanes::<E, V, C> {
            rule,
            t: fresh_transmittance(tile.origin, p.size()),
            rest: [E::zero(); BUFFER],
            d_image: [[E::zero(); BUFFER]; C],
            value: [zero; C],
            moments: [zero; 6],
            d_value: [zero; C],
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
                for (lanes, &value) in lanes.value.iter_mut().zip(&values[rank as usize * C..][..C]) {
                    *lanes = V::splat(value);
                }
                lanes.moments = [zero; 6];
                lanes.d_value = [zero; C];
                walk(&f, &rule, live, &mut lanes);
                for (sum, lanes) in sums.iter_mut().zip(lanes.moments.iter().chain(&lanes.d_value)) {
                    *sum = lanes.total();
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
            for (a, half) in half.iter().enumerate() {
                out.screen[2 * i + a] = E::of(g.center[a] * half);
            }
            out.opacity_logits[i] = E::of(g.logit);
            out.values[i * channels..][..channels].copy_from_slice(&sums[6..]);
        }
        out
    }
}
