//! What densification gathers of an iteration: lengths of screen-space gradients, and in how many views a Gaussian was seen.

use crate::backend::{HostBackend, HostKernels, Real, device_of, real_kernel};
use burn::backend::{Backend, Dispatch, TensorMetadata, backend_extension, tensor::FloatTensor};
use burn::tensor::Tensor;

/// Backend side of [`add_screen_gradients`]; has no gradient.
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "cube")
)]
pub trait ScreenGradientBackend: Backend {
    /// New (lengths, views). Buffers nobody else holds are reused.
    fn add_screen_gradients(
        lengths: FloatTensor<Self>,
        views: FloatTensor<Self>,
        screen: FloatTensor<Self>,
        radii: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

impl<B: HostKernels> ScreenGradientBackend for B {
    fn add_screen_gradients(
        lengths: FloatTensor<Self>,
        views: FloatTensor<Self>,
        screen: FloatTensor<Self>,
        radii: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        on_host::add_screen_gradients::<Self>(lengths, views, screen, radii)
    }
}

/// The same on the host, wherever the tensors live.
pub(super) mod on_host {
    use super::*;

    pub fn add_screen_gradients<B: HostBackend>(
        lengths: FloatTensor<B>,
        views: FloatTensor<B>,
        screen: FloatTensor<B>,
        radii: FloatTensor<B>,
    ) -> (FloatTensor<B>, FloatTensor<B>) {
        let (device, rows, columns) = (
            device_of::<B>(&screen),
            screen.shape()[0],
            screen.shape()[1],
        );
        real_kernel!(screen, E => {
            let [mut lengths, mut views] = [lengths, views].map(|sums| B::values::<E>(sums).into_vec());
            let (screen, radii) = (B::values::<E>(screen), B::values::<E>(radii));
            let gradients = screen.chunks_exact(columns).map(|row| [row[columns - 2], row[columns - 1]]);
            for (((length, seen), [x, y]), radius) in lengths.iter_mut().zip(&mut views).zip(gradients).zip(radii.iter()) {
                if *radius > E::of(0.0) {
                    *length += x.hypot(y);
                    *seen += E::of(1.0);
                }
            }
            (B::tensor(lengths, &[rows], &device), B::tensor(views, &[rows], &device))
        })
    }
}

/// Adds to `lengths` (`[N]`) the length of the last two columns of each row of `screen` (`[N, 2]` or `[N, 4]`), and to `views`
/// (`[N]`) one, for the Gaussians whose radius (`radii`, `[N]`) is not 0.
///
/// # Panics
/// If numbers of rows differ, `screen` has fewer than two columns, or a tensor has autodiff or is neither f32 nor f64.
pub fn add_screen_gradients(
    [lengths, views]: [Tensor<1>; 2],
    screen: Tensor<2>,
    radii: Tensor<1>,
) -> [Tensor<1>; 2] {
    let [rows, columns] = screen.dims();
    assert!(columns >= 2, "screen-space gradients: {columns} columns");
    assert_eq!(
        [&lengths, &views, &radii].map(|t| t.dims()[0]),
        [rows; 3],
        "screen-space gradients: rows"
    );
    let (lengths, views) = Dispatch::add_screen_gradients(
        lengths.into_dispatch(),
        views.into_dispatch(),
        screen.into_dispatch(),
        radii.into_dispatch(),
    );
    [Tensor::from_dispatch(lengths), Tensor::from_dispatch(views)]
}
