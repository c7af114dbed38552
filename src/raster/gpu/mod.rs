//! The rasterizer's kernels for GPUs, one CubeCL source for every device.
//!
//! They follow the CPU's formulas step by step, in `f32`. The camera centre is split into two floats, and the exponent is
//! `-(u^2 + v^2)` with the determinant as a sum of positive terms: rounding costs digits, never splats. The kernels use no
//! subgroup operation and no float atomic, and sum in a fixed order, so that a device returns the same bits every time. A forward
//! pass reads back once: the number of tile entries and the number of non-finite rows. With a tile capacity it reads nothing.
//!
//! Memory besides inputs and outputs, in bytes: 64 for each Gaussian (100 in the backward pass), 28 for each tile entry during the
//! sort and 8 afterwards. The backward pass and the adjoint take up to 128 for each tile entry (80 where cubes have 32 KB of shared
//! memory), 1 GiB at most: more entries go through in slabs. Sums of absolute values add 8 for each Gaussian and tile entry. A
//! tile capacity counts as entries.

mod backward;
mod blend;
mod ewa;
mod frozen;
mod lists;
mod outline;
mod parameters;
mod pixel;
mod pixel_sums;
mod project;
mod radix_sort;
mod row_sums;
mod scan;
mod sh;
mod vec3;
mod view;

pub(crate) use self::frozen::Lists;

use super::settings::Settings;
use crate::backend::gpu::{Gpu, add_non_finite, shortfall};
use crate::error::{Error, Result};
use crate::raster::cpu::geometry::Viewpoint;
use crate::splat::camera::Camera;
use burn::backend::ops::FloatTensorOps;
use burn::tensor::{DType, Slice};
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::prelude::*;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use lists::{Order, Report, TileEntries};
use project::ProjectedScene;
use sh::Harmonics;

/// Sums of absolute screen-space gradients exist for up to this many channels.
pub(super) const ABSOLUTE_CHANNELS: usize = backward::ALWAYS_TOGETHER;

/// The inputs of one call, contiguous `f32` tensors on one device.
pub(crate) struct Inputs {
    /// `[N, 3]`.
    pub means: CubeTensor,
    /// `[N, 3]`.
    pub log_scales: CubeTensor,
    /// `[N, 4]`.
    pub rotations: CubeTensor,
    /// `[N]`.
    pub logits: CubeTensor,
    /// `[N, K, 3]`, and the degree in use.
    pub sh: Option<(CubeTensor, usize)>,
    /// `[N, C]`, C above 0.
    pub features: Option<CubeTensor>,
}

/// Camera, settings and background.
#[derive(Clone, Copy)]
pub(crate) struct Scenery<'a> {
    pub camera: &'a Camera,
    pub settings: &'a Settings,
    pub background: [f64; 3],
}

/// A view's projection and tile lists.
struct Prepared {
    view: CubeTensor,
    projected: ProjectedScene,
    order: Order,
    entries: TileEntries,
    size: [usize; 2],
    /// [`Report::summary`].
    summary: CubeTensor,
}

/// What the forward pass leaves for the backward pass.
pub(crate) struct Forward {
    prepared: Prepared,
    /// What was blended, `[N, C]`, colours first.
    values: CubeTensor,
    /// `[H, W]`.
    pub transmittance: CubeTensor,
}

/// Gradients in the order of the inputs.
pub(crate) struct Gradients {
    pub means: CubeTensor,
    pub log_scales: CubeTensor,
    pub rotations: CubeTensor,
    pub logits: CubeTensor,
    pub sh: Option<CubeTensor>,
    pub features: Option<CubeTensor>,
    /// `[N, 2]`, or `[N, 4]` with sums of absolute values.
    pub screen: CubeTensor,
}

/// Whether the device of `tensor` can run the kernels.
pub(super) fn covers(tensor: &CubeTensor) -> bool {
    tensor.dtype == DType::F32 && shortfall(&tensor.client).is_none()
}

impl Inputs {
    /// Number of Gaussians.
    fn len(&self) -> usize {
        self.logits.meta.num_elements()
    }

    fn harmonics(&self) -> Option<Harmonics> {
        let (sh, active) = self.sh.as_ref()?;
        Some(Harmonics::new(sh.clone(), self.len(), *active))
    }

    /// Number of channels.
    fn channels(&self) -> usize {
        let colours = self.sh.as_ref().map_or(0, |_| 3);
        let width = |t: &CubeTensor| t.meta.num_elements() / self.len().max(1);
        colours + self.features.as_ref().map_or(0, width)
    }

    /// `colours` `[N, 3]` and the features side by side, `[N, C]`.
    fn values(&self, colours: Option<CubeTensor>) -> CubeTensor {
        let parts: Vec<CubeTensor> = colours.into_iter().chain(self.features.clone()).collect();
        match &parts[..] {
            [only] => only.clone(),
            _ => into_contiguous(CubeBackend::float_cat(parts, 1)),
        }
    }
}

/// [`Error::Limit`] when `count` of `what`, of `bytes` each, exceed the largest allocation of the device or 32 bits.
fn check_size(gpu: &Gpu, what: &str, count: usize, bytes: usize) -> Result<()> {
    let limit = (gpu.largest() / bytes.max(1)).min(scan::CEILING as usize - 1);
    if count <= limit {
        return Ok(());
    }
    Err(Error::Limit {
        what: format!("{what} on this device"),
        found: count.to_string(),
        limit: limit.to_string(),
        help: "render a smaller image or fewer channels, remove very large Gaussians, or use a CPU backend".into(),
    })
}

/// Renders `inputs`, at least one Gaussian and one channel: the image `[H, W, C]`, or `None` when an input holds a NaN or an
/// infinity.
///
/// With `room`, a capacity in tile entries, nothing is read back. The caller reads [`Forward::summary`], and discards the image
/// and its gradients if the capacity did not suffice or rows were not finite.
///
/// # Errors
/// [`Error::Config`] for settings out of range, [`Error::Argument`] for an unusable camera, [`Error::Limit`] for what the device
/// cannot hold, [`Error::Device`] when it fails.
pub(super) fn forward(
    inputs: &Inputs,
    scenery: Scenery<'_>,
    room: Option<usize>,
) -> Result<Option<(CubeTensor, Forward)>> {
    let gpu = Gpu::of(&inputs.means);
    let harmonics = inputs.harmonics();
    let channels = inputs.channels();
    let pixels = scenery.camera.width.saturating_mul(scenery.camera.height);
    check_size(
        &gpu,
        "pixels times channels",
        pixels.saturating_mul(channels.max(1)),
        size_of::<f32>(),
    )?;
    for tensor in inputs.sh.iter().map(|(sh, _)| sh).chain(&inputs.features) {
        check_size(
            &gpu,
            "values of the Gaussians",
            tensor.meta.num_elements(),
            size_of::<f32>(),
        )?;
    }
    let Some(prepared) = prepare(&gpu, inputs, scenery, room)? else {
        return Ok(None);
    };
    let Prepared {
        view,
        projected,
        entries,
        size,
        ..
    } = &prepared;
    let colours = harmonics.map(|h| sh::colours(&gpu, &inputs.means, &h, &projected.radii, view));
    let values = inputs.values(colours);
    let (image, transmittance) = blend::blend(
        &gpu,
        &projected.splats,
        entries,
        &values,
        channels,
        view,
        *size,
    );
    Ok(Some((
        image,
        Forward {
            prepared,
            values,
            transmittance,
        },
    )))
}

/// Projects and sorts `inputs`; `None` when an input holds a NaN or an infinity. `room` as in [`forward`].
fn prepare(
    gpu: &Gpu,
    inputs: &Inputs,
    scenery: Scenery<'_>,
    room: Option<usize>,
) -> Result<Option<Prepared>> {
    let Scenery {
        camera,
        settings,
        background,
    } = scenery;
    settings.check()?;
    let viewpoint = Viewpoint::new(camera)?;
    // The background is part of colours alone.
    let behind = if inputs.sh.is_some() {
        background
    } else {
        [0.0; 3]
    };
    let size = viewpoint.size;
    let len = inputs.len();
    check_size(gpu, "Gaussians", len, project::SPLAT * size_of::<f32>())?;
    let view = gpu.upload(
        &view::constants(&viewpoint, camera, settings, behind),
        DType::F32,
    );
    let report = Report::new(gpu);
    let everywhere = settings.alpha_min == 0.0;
    for tensor in inputs.sh.iter().map(|(sh, _)| sh).chain(&inputs.features) {
        add_non_finite(gpu, tensor, tensor.meta.num_elements(), &report.counts);
    }
    let projected = project::project(gpu, inputs, &view, &report.counts, everywhere);
    let fits = |count: usize| {
        check_size(
            gpu,
            "entries of the tile lists of one view",
            count,
            size_of::<u32>(),
        )
    };
    let room = room.filter(|&room| fits(room).is_ok());
    let most = room.unwrap_or(scan::CEILING as usize);
    let order = lists::depth_order(gpu, &projected, len, size, everywhere, &report, most);
    let count = match room {
        Some(room) => room,
        None => {
            let [non_finite, count] = read_report(gpu, &report.counts)?;
            if non_finite > 0 {
                return Ok(None);
            }
            fits(count as usize)?;
            count as usize
        }
    };
    let entries = lists::tile_entries(
        gpu,
        &projected,
        &order,
        count,
        room.is_some(),
        size,
        everywhere,
    );
    Ok(Some(Prepared {
        view,
        projected,
        order,
        entries,
        size,
        summary: report.summary,
    }))
}

/// Non-finite rows, and entries.
fn read_report(gpu: &Gpu, report: &CubeTensor) -> Result<[u32; 2]> {
    let words = read_words(gpu, report)?;
    match words[..] {
        [non_finite, entries, ..] => Ok([non_finite, entries]),
        _ => Err(device_error(gpu, "a readback came short".into())),
    }
}

fn device_error(gpu: &Gpu, reason: String) -> Error {
    Error::Device {
        device: gpu.client.name().into(),
        reason,
        help: "see whether the device has memory left, or choose a CPU backend".into(),
    }
}

fn read_words(gpu: &Gpu, tensor: &CubeTensor) -> Result<Vec<u32>> {
    match gpu.client.read_one(tensor.handle.clone()) {
        Ok(bytes) => Ok(u32::from_bytes(&bytes).to_vec()),
        Err(error) => Err(device_error(
            gpu,
            format!("reading from the device failed: {error:?}"),
        )),
    }
}

impl Forward {
    /// Non-finite rows, tile entries beyond the capacity, and tile entries, as floats.
    pub fn summary(&self) -> CubeTensor {
        self.prepared.summary.clone()
    }

    /// Radii in pixels, `[N]`, `u32`; 0 = culled.
    pub fn radii(&self) -> CubeTensor {
        self.prepared.projected.radii.clone()
    }

    /// Gradients of all inputs. `image` is the output of [`forward`]; `d_image` (`[H, W, C]`) and `d_transmittance` (`[H, W]`) are
    /// contiguous. `absolute` adds sums of absolute screen-space gradients, for at most [`ABSOLUTE_CHANNELS`] channels.
    pub fn backward(
        &self,
        inputs: &Inputs,
        image: &CubeTensor,
        d_image: &CubeTensor,
        d_transmittance: Option<&CubeTensor>,
        absolute: bool,
    ) -> Gradients {
        let gpu = Gpu::of(&inputs.means);
        let Prepared {
            view,
            projected,
            order,
            entries,
            size,
            ..
        } = &self.prepared;
        let transmittance = &self.transmittance;
        let pixels = pixel_sums::PixelGradients {
            image,
            d_image,
            transmittance,
            d_transmittance,
            absolute,
        };
        let tiles = pixel_sums::Tiles {
            order,
            entries,
            size: *size,
        };
        let row_bytes = pixel_sums::row_bytes(&gpu);
        let sums = pixel_sums::pixel_sums(
            &gpu,
            &projected.splats,
            tiles,
            Some(&self.values),
            &pixels,
            view,
            row_bytes,
        );
        let d = parameters::backward(
            &gpu,
            inputs,
            view,
            &projected.splats,
            &projected.radii,
            &sums.moments,
        );
        let harmonics = inputs.harmonics();
        let features = inputs.features.as_ref().map(|_| match &harmonics {
            None => sums.values.clone(),
            Some(_) => {
                let after_colours = [Slice::full(), Slice::from(3..)];
                CubeBackend::float_slice(sums.values.clone(), &after_colours)
            }
        });
        let sh = harmonics.map(|harmonics| {
            let from = sh::ColourGradients {
                values: &self.values,
                d_values: &sums.values,
                radii: &projected.radii,
            };
            sh::backward(&gpu, &inputs.means, &harmonics, &from, view, &d.means)
        });
        Gradients {
            means: d.means,
            log_scales: d.log_scales,
            rotations: d.rotations,
            logits: d.logits,
            sh,
            features,
            screen: d.screen,
        }
    }
}

#[cfg(test)]
mod fixture {
    //! What the tests of the kernels share.

    use super::lists::{Order, Report, TileEntries, depth_order, tile_entries};
    use super::project::{ProjectedScene, project};
    use super::scan::CEILING;
    use super::*;
    use crate::backend::device::gpu_of_tests;
    use crate::raster::{Projected, Splats};
    use burn_cubecl::CubeDevice;
    use glam::{DMat3, DVec3};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The default device, if this machine has one.
    pub fn gpu() -> Option<Gpu> {
        gpu_of_tests()?;
        Some(Gpu::on(CubeDevice::Wgpu(Default::default())))
    }

    pub fn words(gpu: &Gpu, tensor: &CubeTensor) -> Vec<u32> {
        read_words(gpu, tensor).expect("a working device")
    }

    pub fn floats(gpu: &Gpu, tensor: &CubeTensor) -> Vec<f32> {
        words(gpu, tensor).into_iter().map(f32::from_bits).collect()
    }

    /// A scene in host memory and on the device, as far as tile lists.
    pub struct View {
        pub gpu: Gpu,
        pub host: Projected<f32>,
        pub constants: CubeTensor,
        pub projected: ProjectedScene,
        pub order: Order,
        pub entries: TileEntries,
        pub size: [usize; 2],
    }

    impl View {
        pub fn new(n: usize, scale: f32, size: [usize; 2], settings: &Settings) -> Option<Self> {
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
            let inputs = Inputs {
                means,
                log_scales,
                rotations,
                logits,
                sh: None,
                features: None,
            };
            let constants = view::constants(&host.viewpoint, &camera, settings, [0.0; 3]);
            let constants = gpu.upload(&constants, DType::F32);
            let report = Report::new(&gpu);
            let everywhere = settings.alpha_min == 0.0;
            let projected = project(&gpu, &inputs, &constants, &report.counts, everywhere);
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
}
