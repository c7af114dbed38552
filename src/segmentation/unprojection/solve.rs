//! Features whose rendering comes closest to the maps, instead of weighted means of the maps.
//!
//! With the blending weights `W` of all views, the bilinear reads `U` of their maps `F` and `D = diag(W^T 1)`, the weighted
//! mean is `X0 = D^-1 W^T U F`. Solved for is the minimum of `|W X - U F|^2 + ridge |D^(1/2) (X - X0)|^2`, that is
//! `(W^T W + ridge D) (X - X0) = W^T U F - W^T W X0`: Tikhonov regularisation towards the mean, for each Gaussian as strong as the
//! views' sight of it. Conjugate gradients with `D` as preconditioner (Hestenes and Stiefel 1952) need no `W` in memory:
//! every product renders the views and lifts them back. Since `W 1 <= 1`, the preconditioned matrix has its eigenvalues
//! between `ridge` and `1 + ridge`.

use super::{Sums, of_cells};
use crate::backend::Real;
use crate::config::{Resolution, UnprojectionConfig};
use crate::data::View;
use crate::data::mask::Mask;
use crate::error::Result;
use crate::features::{Lattice, SCALES};
use crate::raster::{Projected, Settings, Splats};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use rayon::prelude::*;
use std::convert::Infallible;
use std::ops::ControlFlow;

/// Gaussians of one task; also the unit of the fixed summation order.
const CHUNK: usize = 1024;
/// Channels whose residual is below this share of their first one are done.
const TOLERANCE: f64 = 1e-4;

/// What is solved for at one scale.
pub struct Problem<'a, E> {
    /// The Gaussians.
    pub splats: Splats<'a, E>,
    /// Cameras of the training views: at the maps' size for `feature` resolution, else at the images'.
    pub cameras: &'a [Camera],
    /// Which of their pixels count, where some do not; none of views beyond its end.
    pub masks: &'a [Option<Mask>],
    /// The blending rule.
    pub settings: &'a Settings,
    /// `D`, `[N]`.
    pub weights: &'a [E],
    /// Strength of the regularisation, above 0.
    pub ridge: f64,
}

/// A solution and how good it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved<E> {
    /// `X`, `[N, channels]`; Gaussians without weight have zeros.
    pub features: Vec<E>,
    /// Steps taken.
    pub iterations: usize,
    /// Length of the residual over that of the first, in the norm of `D^-1`; the worst channel.
    pub residual: f64,
}

impl<E: Real> Problem<'_, E> {
    /// Solves for the lifted maps `buffer` = `W^T U F`, `[N, channels]`, in `iterations` steps or fewer.
    ///
    /// # Errors
    /// What [`Projected::new`] returns; [`crate::Error::Argument`] for a mask of another size than its camera has.
    pub fn solve(&self, buffer: &[E], channels: usize, iterations: usize) -> Result<Solved<E>> {
        let go_on = &mut || ControlFlow::<Infallible>::Continue(());
        let ControlFlow::Continue(solved) =
            self.solve_until(buffer, channels, iterations, go_on)?;
        Ok(solved)
    }

    /// [`Problem::solve`], until `looked` breaks: it is told each time that a view was looked at.
    pub(super) fn solve_until<B>(
        &self,
        buffer: &[E],
        channels: usize,
        iterations: usize,
        looked: &mut dyn FnMut() -> ControlFlow<B>,
    ) -> Result<ControlFlow<B, Solved<E>>> {
        let per_weight = |values: &[E]| -> Vec<E> {
            let mut out = values.to_vec();
            let rows = out
                .par_chunks_mut(CHUNK * channels.max(1))
                .zip(self.weights.par_chunks(CHUNK));
            rows.for_each(|(rows, weights)| {
                for (row, &weight) in rows.chunks_exact_mut(channels.max(1)).zip(weights) {
                    let factor = if weight > E::zero() {
                        weight.recip()
                    } else {
                        E::zero()
                    };
                    row.iter_mut().for_each(|x| *x *= factor);
                }
            });
            out
        };
        let mut features = per_weight(buffer);
        let mut residual = buffer.to_vec();
        let product = match self.rendered_and_lifted(&features, channels, looked)? {
            ControlFlow::Continue(product) => product,
            ControlFlow::Break(told) => return Ok(ControlFlow::Break(told)),
        };
        axpy(&mut residual, &vec![-E::one(); channels], &product);
        drop(product);
        let mut near = per_weight(&residual);
        let mut direction = near.clone();
        let mut length = dot(&residual, &near, channels);
        let first = length.clone();
        let mut done = Solved {
            features: Vec::new(),
            iterations: 0,
            residual: worst(&length, &first),
        };
        while done.iterations < iterations && done.residual > TOLERANCE {
            let mut product = match self.rendered_and_lifted(&direction, channels, looked)? {
                ControlFlow::Continue(product) => product,
                ControlFlow::Break(told) => return Ok(ControlFlow::Break(told)),
            };
            let rows = product
                .par_chunks_mut(CHUNK * channels)
                .zip(direction.par_chunks(CHUNK * channels));
            rows.zip(self.weights.par_chunks(CHUNK))
                .for_each(|((product, direction), weights)| {
                    let rows = product
                        .chunks_exact_mut(channels)
                        .zip(direction.chunks_exact(channels));
                    for ((product, direction), &weight) in rows.zip(weights) {
                        let factor = weight * E::of(self.ridge);
                        product
                            .iter_mut()
                            .zip(direction)
                            .for_each(|(p, &d)| *p += factor * d);
                    }
                });
            let step = ratios(&length, &dot(&direction, &product, channels));
            axpy(&mut features, &step, &direction);
            axpy(
                &mut residual,
                &step.iter().map(|&s| -s).collect::<Vec<E>>(),
                &product,
            );
            near = per_weight(&residual);
            let next = dot(&residual, &near, channels);
            let keep: Vec<E> = ratios(&next, &length);
            direction
                .par_chunks_mut(channels)
                .zip(near.par_chunks(channels))
                .with_min_len(CHUNK)
                .for_each(|(d, n)| {
                    for ((d, &n), &keep) in d.iter_mut().zip(n).zip(&keep) {
                        *d = n + keep * *d;
                    }
                });
            length = next;
            done.iterations += 1;
            done.residual = worst(&length, &first);
        }
        Ok(ControlFlow::Continue(Solved { features, ..done }))
    }

    /// `W^T W x` over all views, `[N, channels]`, until `looked` breaks.
    fn rendered_and_lifted<B>(
        &self,
        x: &[E],
        channels: usize,
        looked: &mut dyn FnMut() -> ControlFlow<B>,
    ) -> Result<ControlFlow<B, Vec<E>>> {
        let mut sum = vec![E::zero(); x.len()];
        let masks = self
            .masks
            .iter()
            .map(Option::as_ref)
            .chain(std::iter::repeat(None));
        for (camera, mask) in self.cameras.iter().zip(masks) {
            mask.map_or(Ok(()), |mask| {
                mask.expect_size("a view", camera.width, camera.height)
            })?;
            let projected = Projected::new(&self.splats, camera, self.settings)?;
            let mut image = projected.blend(x, channels).image;
            mask.into_iter()
                .for_each(|mask| mask.fill(&mut image, channels, E::zero()));
            let lifted = projected.blend_adjoint(&image, channels);
            sum.par_iter_mut()
                .zip(&lifted)
                .with_min_len(CHUNK)
                .for_each(|(s, &l)| *s += l);
            if let ControlFlow::Break(told) = looked() {
                return Ok(ControlFlow::Break(told));
            }
        }
        Ok(ControlFlow::Continue(sum))
    }
}

/// `sums` with features in place of the buffers, until `looked` breaks.
pub(super) fn solved<B>(
    mut sums: Sums<f32>,
    gaussians: &Gaussians,
    (views, lattices): (&[&View], &[[Lattice; SCALES]]),
    config: &UnprojectionConfig,
    settings: &Settings,
    looked: &mut dyn FnMut() -> ControlFlow<B>,
) -> Result<ControlFlow<B, Sums<f32>>> {
    for (scale, (buffer, &channels)) in sums.buffers.iter_mut().zip(&sums.channels).enumerate() {
        let camera = |(view, lattices): (&&View, &[Lattice; SCALES])| match config.resolution {
            Resolution::Image => view.camera.clone(),
            Resolution::Feature => lattices[scale].camera(&view.camera),
        };
        let cameras: Vec<_> = views.iter().zip(lattices).map(camera).collect();
        let mask = |(view, cells): (&&View, &Camera)| {
            Some(of_cells(view.mask.as_ref()?, &view.camera, cells))
        };
        let masks: Vec<Option<Mask>> = views.iter().zip(&cameras).map(mask).collect();
        let (splats, weights, ridge) =
            (gaussians.splats(), &sums.weights[scale], config.solve_ridge);
        let problem = Problem {
            splats,
            cameras: &cameras,
            masks: &masks,
            settings,
            weights,
            ridge,
        };
        let done = match problem.solve_until(buffer, channels, config.solve_iterations, looked)? {
            ControlFlow::Continue(done) => done,
            ControlFlow::Break(told) => return Ok(ControlFlow::Break(told)),
        };
        tracing::info!(
            "unprojection: scale {} solved in {} steps to a residual of {:.1e}",
            scale + 1,
            done.iterations,
            done.residual
        );
        *buffer = done.features;
    }
    Ok(ControlFlow::Continue(sums))
}

/// `y += a x`, with a factor for each channel.
fn axpy<E: Real>(y: &mut [E], a: &[E], x: &[E]) {
    let channels = a.len().max(1);
    y.par_chunks_mut(CHUNK * channels)
        .zip(x.par_chunks(CHUNK * channels))
        .for_each(|(y, x)| {
            for (y, x) in y.chunks_exact_mut(channels).zip(x.chunks_exact(channels)) {
                for ((y, &x), &a) in y.iter_mut().zip(x).zip(a) {
                    *y += a * x;
                }
            }
        });
}

/// Sums over the Gaussians of `a b` for each channel, added up in a fixed order.
fn dot<E: Real>(a: &[E], b: &[E], channels: usize) -> Vec<f64> {
    let chunk = CHUNK * channels.max(1);
    let parts: Vec<Vec<f64>> = a
        .par_chunks(chunk)
        .zip(b.par_chunks(chunk))
        .map(|(a, b)| {
            let mut sums = vec![0.0; channels];
            for (a, b) in a
                .chunks_exact(channels.max(1))
                .zip(b.chunks_exact(channels.max(1)))
            {
                for ((s, a), b) in sums.iter_mut().zip(a).zip(b) {
                    *s += a.wide() * b.wide();
                }
            }
            sums
        })
        .collect();
    let mut sums = vec![0.0; channels];
    for part in parts {
        sums.iter_mut().zip(part).for_each(|(s, p)| *s += p);
    }
    sums
}

/// `a / b` for each channel, 0 where there is nothing left to do.
fn ratios<E: Real>(a: &[f64], b: &[f64]) -> Vec<E> {
    a.iter()
        .zip(b)
        .map(|(&a, &b)| {
            if a > 0.0 && b > 0.0 {
                E::of(a / b)
            } else {
                E::zero()
            }
        })
        .collect()
}

/// Root of the largest ratio; 0 for channels that were solved from the start.
fn worst(now: &[f64], first: &[f64]) -> f64 {
    now.iter()
        .zip(first)
        .map(|(&n, &f)| if f > 0.0 { n / f } else { 0.0 })
        .fold(0.0, f64::max)
        .sqrt()
}
