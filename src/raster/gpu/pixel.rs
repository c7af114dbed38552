//! Evaluation of a projected Gaussian at a pixel.

use super::project::SPLAT;
use super::view::{ALPHA_MAX, ALPHA_MIN, LN_ALPHA_MIN, T_MIN};
use crate::raster::cpu::footprint::TILE;
use burn_cubecl::cubecl::{self, prelude::*};

/// Four floats that shared memory loads at once.
pub(super) type Four = Vector<f32, Const<4>>;

/// Fours of a projected Gaussian.
pub(super) const SPLAT_FOURS: usize = SPLAT / 4;

/// The `part`-th four of Gaussian `id`.
#[cube]
pub(super) fn splat_four(splats: &[f32], id: usize, part: usize) -> Four {
    let at = id * SPLAT + 4 * part;
    let mut four = Four::empty();
    four.insert(0usize, splats[at]);
    four.insert(1usize, splats[at + 1]);
    four.insert(2usize, splats[at + 2]);
    four.insert(3usize, splats[at + 3]);
    four
}

/// Constants of the blending rule.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Rule {
    pub alpha_min: f32,
    /// No exponent below this reaches alpha_min, rounding included.
    lowest: f32,
    pub alpha_max: f32,
    pub t_min: f32,
}

#[cube]
pub(super) fn rule(view: &[f32]) -> Rule {
    Rule {
        alpha_min: view[ALPHA_MIN],
        lowest: view[LN_ALPHA_MIN] - 1e-3f32,
        alpha_max: view[ALPHA_MAX],
        t_min: view[T_MIN],
    }
}

/// Column and row of a unit's pixel, and its index in the image.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Pixel {
    /// Centre, pixels.
    pub x: f32,
    pub y: f32,
    pub inside: bool,
    /// Row-major; that of the first pixel when outside.
    pub index: usize,
}

/// What passes the Gaussians that a pixel has blended.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Light {
    /// The transmittance T.
    pub t: f32,
    /// Whether blending has ended.
    pub blocked: bool,
}

/// A patch of [`PATCH_WIDTH`] x [`PATCH_HEIGHT`] pixels belongs to neighbouring units: as many as run in step on most devices.
pub(super) const PATCH: usize = PATCH_WIDTH * PATCH_HEIGHT;
pub(super) const PATCH_WIDTH: usize = 8;
pub(super) const PATCH_HEIGHT: usize = 4;
/// Patches of a tile, and of a row of them.
pub(super) const PATCHES: usize = TILE * TILE / PATCH;
pub(super) const PATCHES_ACROSS: usize = TILE / PATCH_WIDTH;

/// The pixel of unit `unit` in tile `tile`: patch by patch.
#[cube]
pub(super) fn pixel(tile: usize, unit: u32, width: u32, height: u32) -> Pixel {
    let across = (width + (TILE - 1) as u32) / TILE as u32;
    let patch = unit / PATCH as u32;
    let lane = unit % PATCH as u32;
    let column = (patch % PATCHES_ACROSS as u32) * PATCH_WIDTH as u32 + lane % PATCH_WIDTH as u32;
    let row = (patch / PATCHES_ACROSS as u32) * PATCH_HEIGHT as u32 + lane / PATCH_WIDTH as u32;
    let x = (tile as u32 % across) * TILE as u32 + column;
    let y = (tile as u32 / across) * TILE as u32 + row;
    let inside = x < width && y < height;
    Pixel {
        x: f32::cast_from(x) + 0.5f32,
        y: f32::cast_from(y) + 0.5f32,
        inside,
        index: select(inside, y * width + x, 0u32) as usize,
    }
}

/// alpha' of the `at`-th Gaussian of a batch at (x, y) before the cap; 0 where it is surely below the cut-off.
///
/// Multiply-adds are written out, here and in [`take`], because compilers may or may not contract products and sums. The forward
/// and the backward pass have to stop at the same Gaussian.
#[cube]
pub(super) fn alpha_at(batch: &Shared<[Four]>, at: usize, x: f32, y: f32, rule: &Rule) -> f32 {
    let first = batch[at * SPLAT_FOURS];
    let second = batch[at * SPLAT_FOURS + 1];
    let dy = y - first.extract(1usize);
    let u = first.extract(3usize) * fma(-first.extract(2usize), dy, x - first.extract(0usize));
    let v = second.extract(0usize) * dy;
    let exponent = fma(-v, v, fma(-u, u, second.extract(1usize)));
    let mut alpha = 0.0f32;
    if exponent >= rule.lowest {
        alpha = exponent.exp();
    }
    alpha
}

/// Contribution of a Gaussian to a pixel.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Taken {
    /// Below the cap, or at it.
    pub alpha: f32,
    /// T afterwards.
    pub next: f32,
    /// Whether alpha reaches alpha_min; if not, the rest means nothing.
    pub shows: bool,
}

/// Contribution of the `at`-th Gaussian of a batch to the pixel at (x, y) with transmittance `t`. Both passes share this arithmetic.
#[cube]
pub(super) fn take(
    batch: &Shared<[Four]>,
    at: usize,
    x: f32,
    y: f32,
    t: f32,
    rule: &Rule,
) -> Taken {
    let seen = alpha_at(batch, at, x, y, rule);
    let alpha = min(seen, rule.alpha_max);
    Taken {
        alpha,
        next: fma(-alpha, t, t),
        shows: alpha > 0.0f32 && alpha >= rule.alpha_min,
    }
}

/// Whether Gaussian `id` may reach alpha_min at a pixel centre of patch `patch` of tile `tile`. Never false where [`alpha_at`]
/// reaches it: the margin of the reach exceeds rounding.
#[cube]
pub(super) fn reaches_patch(
    splats: &[f32],
    id: usize,
    tile: usize,
    patch: u32,
    width: u32,
    height: u32,
) -> bool {
    let first = pixel(tile, patch * PATCH as u32, width, height);
    let at = id * SPLAT;
    let slope = splats[at + 2];
    let du = splats[at + 3];
    let dv = splats[at + 4];
    let reach = splats[at + 6];
    // Rounded as alpha_at rounds them.
    let left = first.x - splats[at];
    let right = first.x + (PATCH_WIDTH - 1) as f32 - splats[at];
    let mut reaches = false;
    #[unroll]
    for row in 0..PATCH_HEIGHT {
        let dy = first.y + row as f32 - splats[at + 1];
        let v = dv * dy;
        // The point of the row nearest to the peak of the Gaussian in that row.
        let nearest = min(max(slope * dy, left), right);
        let u = du * fma(-slope, dy, nearest);
        reaches = reaches || fma(u, u, v * v) <= reach * reach;
    }
    reaches
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::gpu::launch;
    use crate::raster::Settings;
    use crate::raster::gpu::fixture::{gpu, words};
    use crate::raster::gpu::view;
    use crate::splat::camera::Camera;
    use glam::{DMat3, DVec3};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// One cube for each splat, one unit for each pixel of `tile`: pixels that the splat shows in, and those of them whose patch
    /// it does not reach.
    #[cube(launch)]
    fn count_missed(
        splats: &[f32],
        view: &[f32],
        found: &[Atomic<u32>],
        splat_count: u32,
        tile: u32,
        width: u32,
        height: u32,
    ) {
        let id = CUBE_POS;
        if id >= splat_count as usize {
            terminate!();
        }
        let mut own = Shared::<[Four]>::new_slice(SPLAT_FOURS);
        if (UNIT_POS as usize) < SPLAT_FOURS {
            own[UNIT_POS as usize] = splat_four(splats, id, UNIT_POS as usize);
        }
        sync_cube();
        let rule = rule(view);
        let at = pixel(tile as usize, UNIT_POS, width, height);
        let alpha = alpha_at(&own, 0usize, at.x, at.y, &rule);
        let patch = UNIT_POS / PATCH as u32;
        let reached = reaches_patch(splats, id, tile as usize, patch, width, height);
        if alpha > 0.0f32 && alpha >= rule.alpha_min {
            found[0].fetch_add(1u32);
            if !reached {
                found[1].fetch_add(1u32);
            }
        }
        if reached {
            found[2].fetch_add(1u32);
        }
    }

    #[test]
    fn a_patch_that_is_passed_over_shows_nothing() {
        let Some(gpu) = gpu() else { return };
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let count = 20_000_usize;
        let size = [96_u32, 64];
        for (alpha_min, least) in [(1.0 / 255.0, 0.5), (1e-14, 0.0)] {
            let settings = Settings {
                alpha_min,
                ..Settings::default()
            };
            let camera = Camera {
                rotation: DMat3::IDENTITY,
                center: DVec3::ZERO,
                fx: 90.0,
                fy: 90.0,
                cx: 48.0,
                cy: 32.0,
                width: size[0] as usize,
                height: size[1] as usize,
            };
            let viewpoint = crate::raster::cpu::geometry::Viewpoint::new(&camera).expect("valid");
            let constants = view::constants(&viewpoint, &settings, [0.0; 3]);
            let splats: Vec<f32> = (0..count)
                .flat_map(|i| {
                    // Widths from a third of a pixel to thousands, slopes to match, centres near the tile and far off.
                    let (wide, tall) = (
                        10_f32.powf(rng.random_range(-0.5..4.0)),
                        10_f32.powf(rng.random_range(-0.5..4.0)),
                    );
                    let far = if i % 4 == 0 { 5_000.0 } else { 40.0 };
                    let log_opacity: f32 = rng.random_range(-5.5..0.0);
                    let tau = log_opacity - constants[view::LN_ALPHA_MIN];
                    let slope = rng.random_range(-2.0..2.0) * wide / tall
                        * if i % 3 == 0 { 50.0 } else { 1.0 };
                    let (x, y) = (
                        rng.random_range(-far..far) + 40.0,
                        rng.random_range(-far..far) + 24.0,
                    );
                    [
                        x,
                        y,
                        slope,
                        wide.recip(),
                        tall.recip(),
                        log_opacity,
                        (tau + 1e-3).sqrt(),
                        1.0,
                    ]
                })
                .collect();
            let splats = gpu.upload(&splats);
            let constants = gpu.upload(&constants);
            let found = gpu.upload(&[0_u32; 3]);
            launch!(gpu, count_missed, gpu.cubes(count);
                &splats, &constants, &found; count as u32, 7, size[0], size[1]);
            let found = words(&gpu, &found);
            assert!(found[0] > 50_000, "some show: {found:?}");
            assert_eq!(found[1], 0, "of {found:?} at alpha_min {alpha_min}");
            assert!(
                f64::from(found[0]) >= least * f64::from(found[2]),
                "reached for little: {found:?}"
            );
            eprintln!("alpha_min {alpha_min}: shows, missed, reached {found:?}");
        }
    }
}
