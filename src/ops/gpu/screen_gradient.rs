//! Screen-space gradients gathered in one kernel, a unit a Gaussian.

use super::{covers, own};
use crate::backend::gpu::{Gpu, arg};
use crate::ops::screen_gradient::{ScreenGradientBackend, on_host};
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;

#[cube(launch)]
fn gather(
    lengths: &mut [f32],
    views: &mut [f32],
    screen: &[f32],
    radii: &[f32],
    rows: u32,
    columns: u32,
) {
    let i = ABSOLUTE_POS;
    if i >= rows as usize {
        terminate!();
    }
    if radii[i] > 0.0f32 {
        let at = (i + 1) * columns as usize;
        let x = screen[at - 2];
        let y = screen[at - 1];
        lengths[i] += (x * x + y * y).sqrt();
        views[i] += 1.0f32;
    }
}

impl ScreenGradientBackend for CubeBackend {
    fn add_screen_gradients(
        lengths: FloatTensor<Self>,
        views: FloatTensor<Self>,
        screen: FloatTensor<Self>,
        radii: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let (rows, columns) = (screen.meta.shape()[0], screen.meta.shape()[1]);
        if rows == 0 {
            return (lengths, views);
        }
        if !covers(&screen) {
            return on_host::add_screen_gradients::<Self>(lengths, views, screen, radii);
        }
        let gpu = Gpu::of(&screen);
        let [lengths, views] = [lengths, views].map(own);
        gather::launch(
            &gpu.client,
            gpu.cubes_for(rows),
            gpu.dim(),
            arg(&lengths),
            arg(&views),
            arg(&into_contiguous(screen)),
            arg(&into_contiguous(radii)),
            rows as u32,
            columns as u32,
        );
        (lengths, views)
    }
}
