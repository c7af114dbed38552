//! Each stage of the GPU pipeline against the CPU's.

use super::blend::{Values, blend};
use super::lists::{Order, Report, TileEntries, depth_order, tile_counts, tile_entries};
use super::pixel::{Four, PATCH, SPLAT_FOURS, alpha_at, pixel, reaches_patch, rule, splat_four};
use super::pixel_sums::{PixelGradients, Tiles, adjoint, pixel_sums};
use super::project::{ProjectedScene, SPLAT, Scene, project};
use super::radix_sort::sort_positions;
use super::scan::{CEILING, exclusive_sums};
use super::{covers, view};
use crate::backend::device::gpu_of_tests;
use crate::backend::gpu::{Gpu, arg};
use crate::raster::{Projected, Settings, Splats};
use crate::splat::camera::Camera;
use burn::tensor::DType;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::{CubeDevice, tensor::CubeTensor};
use glam::{DMat3, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The default device, if this machine has one.
fn gpu() -> Option<Gpu> {
    gpu_of_tests()?;
    Some(Gpu::on(CubeDevice::Wgpu(Default::default())))
}

fn words(gpu: &Gpu, tensor: &CubeTensor) -> Vec<u32> {
    super::read_words(gpu, tensor).expect("a working device")
}

fn floats(gpu: &Gpu, tensor: &CubeTensor) -> Vec<f32> {
    words(gpu, tensor).into_iter().map(f32::from_bits).collect()
}

#[test]
fn sums_of_what_comes_before() {
    let Some(gpu) = gpu() else { return };
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for len in [
        1,
        7,
        8,
        255,
        2047,
        2048,
        2049,
        16_384,
        16_385,
        70_000,
        2048 * 2048 + 5,
    ] {
        let values: Vec<u32> = (0..len).map(|_| rng.random_range(0..100)).collect();
        let sums = words(
            &gpu,
            &exclusive_sums(&gpu, &gpu.upload(&values, DType::U32), len),
        );
        let mut sum = 0;
        for (i, value) in values.iter().enumerate() {
            assert_eq!(sums[i], sum, "{i} of {len}");
            sum += value;
        }
    }
    let large = vec![1 << 29; 5000];
    let sums = words(
        &gpu,
        &exclusive_sums(&gpu, &gpu.upload(&large, DType::U32), 5000),
    );
    assert_eq!(sums[..3], [0, 1 << 29, 1 << 30]);
    assert!(sums[4..].iter().all(|&s| s == CEILING));
}

#[test]
fn sorting_is_stable() {
    let Some(gpu) = gpu() else { return };
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for (len, bits) in [
        (1, 32),
        (5, 4),
        (255, 10),
        (2048, 32),
        (2049, 13),
        (50_000, 13),
        (50_000, 32),
        (300_000, 8),
    ] {
        let most = u32::MAX >> (32 - bits);
        let keys: Vec<u32> = (0..len).map(|_| rng.random_range(0..=most)).collect();
        let (sorted, positions) = sort_positions(&gpu, gpu.upload(&keys, DType::U32), len, bits);
        let mut want: Vec<u32> = (0..len as u32).collect();
        want.sort_by_key(|&i| keys[i as usize]);
        assert!(
            words(&gpu, &positions)[..len] == want,
            "positions of {len} keys of {bits} bits"
        );
        let want: Vec<u32> = want.iter().map(|&i| keys[i as usize]).collect();
        assert!(
            words(&gpu, &sorted)[..len] == want,
            "{len} keys of {bits} bits"
        );
    }
}

/// A scene in host memory and on the device, as far as tile lists.
struct View {
    gpu: Gpu,
    host: Projected<f32>,
    constants: CubeTensor,
    projected: ProjectedScene,
    order: Order,
    entries: TileEntries,
    size: [usize; 2],
}

impl View {
    fn new(n: usize, scale: f32, size: [usize; 2], settings: &Settings) -> Option<Self> {
        let gpu = gpu()?;
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut draw = |n: usize, low: f32, high: f32| -> Vec<f32> {
            (0..n).map(|_| rng.random_range(low..high)).collect()
        };
        let means: Vec<f32> = draw(3 * n, -2.0, 2.0);
        let log_scales: Vec<f32> = draw(3 * n, -1.0, 1.0)
            .iter()
            .map(|x| x + scale.ln())
            .collect();
        let (rotations, logits) = (draw(4 * n, -1.0, 1.0), draw(n, -3.0, 3.0));
        let camera = Camera {
            rotation: DMat3::IDENTITY,
            center: DVec3::new(0.1, 0.2, -2.5),
            fx: 0.8 * size[0] as f64,
            fy: 0.8 * size[0] as f64,
            cx: 0.5 * size[0] as f64,
            cy: 0.5 * size[1] as f64,
            width: size[0],
            height: size[1],
        };
        let splats = Splats {
            means: &means,
            log_scales: &log_scales,
            rotations: &rotations,
            opacity_logits: &logits,
        };
        let host = Projected::new(&splats, &camera, settings).expect("valid");
        let [means, log_scales, rotations, logits] =
            [&means, &log_scales, &rotations, &logits].map(|v| gpu.upload(v, DType::F32));
        let scene = Scene {
            means,
            log_scales,
            rotations,
            logits,
            len: n,
        };
        let constants = view::constants(&host.viewpoint, &camera, settings, [0.0; 3]);
        let constants = gpu.upload(&constants, DType::F32);
        let report = Report::new(&gpu);
        let everywhere = settings.alpha_min == 0.0;
        let projected = project(&gpu, &scene, &constants, &report.counts, everywhere);
        let order = depth_order(
            &gpu,
            &projected,
            n,
            size,
            everywhere,
            &report,
            CEILING as usize,
        );
        let count = words(&gpu, &report.counts)[1] as usize;
        let entries = tile_entries(&gpu, &projected, &order, count, false, size, everywhere);
        Some(Self {
            gpu,
            host,
            constants,
            projected,
            order,
            entries,
            size,
        })
    }
}

#[test]
fn projections_agree() {
    let Some(view) = View::new(3000, 0.05, [120, 77], &Settings::default()) else {
        return;
    };
    assert!(covers(&view.constants), "this device runs the kernels");
    let splats = floats(&view.gpu, &view.projected.splats);
    let mut culled = vec![true; view.host.len()];
    for (splat, &id) in view.host.splats.iter().zip(&view.host.ids) {
        culled[id as usize] = false;
        let got = &splats[id as usize * SPLAT..][..SPLAT];
        let want = [
            splat.center[0],
            splat.center[1],
            splat.slope,
            splat.du,
            splat.dv,
            splat.log_opacity,
            splat.reach,
        ];
        for (field, (&got, want)) in got.iter().zip(want).enumerate() {
            // Cancellation in the slope is relative to the ellipse, and in the centre to the image.
            let size = if field < 2 {
                120.0
            } else {
                want.abs().max(0.1)
            };
            assert!(
                (f64::from(got) - want).abs() < 2e-5 * size,
                "Gaussian {id}, field {field}: {got}, expected {want}"
            );
        }
    }
    let radii = words(&view.gpu, &view.projected.radii);
    let differing = radii
        .iter()
        .zip(&culled)
        .filter(|&(&r, &culled)| (r == 0) != culled)
        .count();
    assert!(differing <= 2, "{differing} fates differ");
}

#[test]
fn tile_lists_agree() {
    for settings in [
        Settings::default(),
        Settings {
            alpha_min: 0.0,
            ..Settings::default()
        },
    ] {
        for (n, scale, size) in [
            (2000, 0.03, [130, 90]),
            (300, 0.5, [65, 40]),
            (100, 3.0, [33, 47]),
        ] {
            let Some(view) = View::new(n, scale, size, &settings) else {
                return;
            };
            let [across, down] = tile_counts(size);
            let ranges = words(&view.gpu, &view.entries.ranges);
            let gaussians = words(&view.gpu, &view.entries.gaussians);
            let (mut entries, mut differing) = (0, 0);
            for tile in 0..across * down {
                let got = &gaussians[ranges[2 * tile] as usize..ranges[2 * tile + 1] as usize];
                let ranks =
                    &view.host.tiles.ranks[view.host.tiles.tile(tile % across, tile / across)];
                let want: Vec<u32> = ranks
                    .iter()
                    .map(|&rank| view.host.ids[rank as usize])
                    .collect();
                entries += want.len();
                // Lists differ where an ellipse grazes a tile; what both have is in one order.
                let both: Vec<u32> = got.iter().copied().filter(|id| want.contains(id)).collect();
                let shared: Vec<u32> = want.iter().copied().filter(|id| got.contains(id)).collect();
                let flips = both.iter().zip(&shared).filter(|(a, b)| a != b).count();
                differing += got.len() + want.len() - both.len() - shared.len() + flips;
            }
            assert!(entries > 0);
            assert!(
                differing * 500 <= entries,
                "{differing} of {entries} entries differ, {n} Gaussians"
            );
        }
    }
}

#[test]
fn entries_in_slabs_give_the_same_sums() {
    let Some(view) = View::new(400, 0.1, [50, 41], &Settings::default()) else {
        return;
    };
    let gpu = &view.gpu;
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut draw = |n: usize| -> CubeTensor {
        let values: Vec<f32> = (0..n).map(|_| rng.random_range(-1.0..1.0)).collect();
        gpu.upload(&values, DType::F32)
    };
    let pixels = 50 * 41;
    let values = Values {
        colours: Some(draw(400 * 3)),
        features: Some(draw(400 * 9)),
        channels: 12,
    };
    let (image, transmittance) = blend(
        gpu,
        &view.projected.splats,
        &view.entries,
        &values,
        &view.constants,
        view.size,
    );
    let (d_image, d_transmittance) = (draw(pixels * 12), draw(pixels));
    let gradients = PixelGradients {
        image: &image,
        d_image: &d_image,
        transmittance: &transmittance,
        d_transmittance: Some(&d_transmittance),
        absolute: false,
    };
    let tiles = Tiles {
        order: &view.order,
        entries: &view.entries,
        size: view.size,
    };
    let sums = |row_bytes: usize| {
        let out = pixel_sums(
            gpu,
            &view.projected.splats,
            tiles,
            &values,
            &gradients,
            &view.constants,
            row_bytes,
        );
        [out.moments, out.d_colours, out.d_features].map(|t| floats(gpu, &t))
    };
    let whole = sums(usize::MAX);
    let slabs = sums(view.entries.len * 56 / 3);
    let lift = |row_bytes: usize| {
        let sums = adjoint(
            gpu,
            &view.projected.splats,
            tiles,
            &d_image,
            12,
            &view.constants,
            row_bytes,
        );
        floats(gpu, &sums)
    };
    let lifted = [lift(usize::MAX), lift(view.entries.len * 48 / 3)];
    let d_values: Vec<f32> = whole[1]
        .chunks_exact(3)
        .zip(whole[2].chunks_exact(9))
        .flat_map(|(a, b)| [a, b].concat())
        .collect();
    let pairs = whole
        .iter()
        .zip(&slabs)
        .chain([(&lifted[0], &lifted[1]), (&d_values, &lifted[0])]);
    for (whole, slabs) in pairs {
        let largest = whole.iter().fold(0.0_f32, |a, v| a.max(v.abs()));
        assert!(largest > 0.0);
        assert!(
            whole
                .iter()
                .zip(slabs)
                .all(|(a, b)| (a - b).abs() <= 1e-5 * largest)
        );
    }
}

/// A cube a splat, a unit a pixel of `tile`: pixels that the splat shows in, and those of them whose patch it does not reach.
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
    let (count, size) = (20_000_usize, [96_u32, 64]);
    for (alpha_min, least) in [(1.0 / 255.0, 0.5), (0.0, 0.0)] {
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
        let constants = view::constants(&viewpoint, &camera, &settings, [0.0; 3]);
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
                let slope =
                    rng.random_range(-2.0..2.0) * wide / tall * if i % 3 == 0 { 50.0 } else { 1.0 };
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
        let (splats, constants) = (
            gpu.upload(&splats, DType::F32),
            gpu.upload(&constants, DType::F32),
        );
        let found = gpu.upload(&[0_u32; 3], DType::U32);
        count_missed::launch(
            &gpu.client,
            gpu.cubes(count),
            gpu.dim(),
            arg(&splats),
            arg(&constants),
            arg(&found),
            count as u32,
            7,
            size[0],
            size[1],
        );
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
