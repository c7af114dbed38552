//! What a view costs at least: bytes through main memory, and float operations.
//!
//! Per view, with `N` Gaussians, `V` of them visible, `E` tile entries, `P` pixels, `C` channels (3 of SH colour, if there is
//! colour, and `F` features), `K` SH terms, `Q` evaluated and `R` contributing pairs:
//!
//! | step | bytes | operations |
//! |---|---|---|
//! | projection | `44 N + 2 * 32 V` | `21 N + 239 V` |
//! | colour from SH | `12 K V + 2 * 12 V` | `(18 + B(K) + 6 K) V` |
//! | depth sort, host | `3 * 24 V` | |
//! | depth sort, device | `8 N + (4 * 20 - 4) N` | |
//! | tile lists, host | `16 E` | |
//! | tile lists, device | `8 E + (20 p - 4) E + 16 E` | |
//! | blending | `4 E + 4 F V + 4 (C + 1) P` | `10 Q + (4 + 2 C) R`, `6 P` of background with colour |
//! | backward, pixels | `8 E + 32 V + 4 C V + 2 * 4 C P + 2 * 24 V` | `2 C P + 10 Q + (21 + 4 C) R` |
//! | backward, geometry | `44 V + 44 N` | `450 V` |
//! | backward, SH | `2 * 12 V + 12 K V + 12 K N` | `(15 + B(K) + 8 K + D(K)) V` |
//! | backward, features | `4 F N` | |
//! | lifting of `C` channels | `4 E + 4 C P + 8 C V + 16 V` | `10 Q + (5 + 2 C) R` |
//!
//! *Bytes.* Every array counts once where it is an input or an output, and twice (written, read) where one step leaves it for
//! a later one, as if no cache held it in between. Inputs of Gaussians that the algorithm need not look at do not count, nor does what
//! an implementation reads again. Sorts count as they are implemented: on the host three passes over 8-byte pairs of the visible
//! (read, read, written), and lists that are binned, laid out by tile and by Gaussian; on a device four passes over the depths of all, and
//! `p` passes of eight bits over the tile numbers, a pass being keys read, pairs read and pairs written (the first has no values to
//! read). Tables of digit counts and of tile ranges are left out, as are the sums of each entry that meet in a backward pass.
//!
//! *Operations.* Additions, subtractions, products, quotients, minima, maxima, roots, exponentials and logarithms are 1
//! each, a multiply-add 2; comparisons, selections, signs and whole numbers are 0. Counted in the kernels for GPUs: `21 N` are the way
//! into camera axes, `239 V` and `450 V` the projection (124 of EWA in both) and its derivative. 10 of a pair are its exponent
//! (`dy`; 4 for `u`; `v`; 4 for `peak - u^2 - v^2`); 4 more are the exponential, the cap, `alpha T` and the next `T`. In the
//! backward pass it has the same 14, 6 for its share of the loss, and 11 for six moments. `B(K)` and `D(K)` are the SH basis and its
//! derivative (with its way to the mean). Which tiles a Gaussian reaches is left out.

use std::iter::Sum;
use std::ops::Add;

/// Bytes of an f32 or a 32-bit whole number.
const WORD: f64 = 4.0;
/// Parameters of the geometry of a Gaussian, floats.
const GEOMETRY: f64 = 11.0;
/// Floats of a projected Gaussian.
const SPLAT: f64 = 8.0;
/// Sums over pixels from which the gradient of the geometry follows, floats.
const MOMENTS: f64 = 6.0;
const COLOURS: f64 = 3.0;

/// Operations of a Gaussian: into camera axes, and what is left to do for a visible one.
const TO_CAMERA: f64 = 21.0;
const PROJECTION: f64 = 239.0;
const PROJECTION_BACKWARD: f64 = 450.0;
/// The unit direction to a Gaussian.
const DIRECTION: f64 = 15.0;
/// By degree: the SH basis, and its derivative by the mean.
const BASIS: [f64; 4] = [0.0, 3.0, 18.0, 49.0];
const BASIS_BACKWARD: [f64; 4] = [0.0, 20.0, 52.0, 141.0];
/// Operations of a pair: its exponent; what blending adds; what the backward pass adds to both.
const EXPONENT: f64 = 10.0;
const BLEND: f64 = 4.0;
const BLEND_BACKWARD: f64 = 17.0;

/// Bits of a digit of the sort on a device, and passes over 32-bit depths.
const DIGIT: u32 = 8;
const DEPTH_PASSES: f64 = 4.0;
/// Passes of the sort on the host, over 11 bits each.
const HOST_PASSES: f64 = 3.0;

/// What has to be moved and computed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Work {
    /// Through main memory, read and written.
    pub bytes: f64,
    /// Of floats; a multiply-add is two.
    pub operations: f64,
}

impl Add for Work {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            bytes: self.bytes + other.bytes,
            operations: self.operations + other.operations,
        }
    }
}

impl Sum for Work {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), Add::add)
    }
}

impl Work {
    /// `factor` times as much.
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            bytes: self.bytes * factor,
            operations: self.operations * factor,
        }
    }
}

/// Exact counts of one view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Counts {
    pub gaussians: f64,
    pub visible: f64,
    /// Entries of all tile lists.
    pub entries: f64,
    pub tiles: u32,
    pub pixels: f64,
    /// Pairs whose exponent is looked at: those of the kernels for CPUs, which pass over strips of eight pixels that a Gaussian
    /// does not reach.
    pub evaluated: f64,
    /// Pairs with alpha' of alpha_min or more, before the stop.
    pub contributing: f64,
}

/// What is blended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Channels {
    /// Degree of the SH, where there is colour.
    pub sh_degree: Option<usize>,
    /// Channels besides.
    pub features: f64,
}

/// Whose sorts are counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sorting {
    /// `crate::raster::tiles`.
    Host,
    /// `crate::raster::gpu::lists`.
    Device,
}

impl Channels {
    /// Of both together.
    fn count(&self) -> f64 {
        self.features + self.sh_degree.map_or(0.0, |_| COLOURS)
    }
}

/// SH functions up to `degree`.
fn terms(degree: usize) -> f64 {
    ((degree + 1) * (degree + 1)) as f64
}

/// A view's image and transmittance.
pub(super) fn forward(n: &Counts, channels: &Channels, sorting: Sorting) -> Work {
    let c = channels.count();
    let background = if channels.sh_degree.is_some() {
        2.0 * COLOURS * n.pixels
    } else {
        0.0
    };
    let blending = Work {
        bytes: WORD * (n.entries + channels.features * n.visible + (c + 1.0) * n.pixels),
        operations: EXPONENT * n.evaluated + (BLEND + 2.0 * c) * n.contributing + background,
    };
    lists(n, sorting)
        + channels
            .sh_degree
            .map_or_else(Work::default, |degree| colours(n, degree))
        + blending
}

/// Gradients of all inputs, given the image and its gradient.
pub(super) fn backward(n: &Counts, channels: &Channels) -> Work {
    let (c, colour) = (channels.count(), channels.sh_degree);
    let pixels = Work {
        bytes: WORD
            * (2.0 * n.entries
                + (SPLAT + c) * n.visible
                + 2.0 * c * n.pixels
                + 2.0 * MOMENTS * n.visible),
        operations: 2.0 * c * n.pixels
            + EXPONENT * n.evaluated
            + (BLEND + BLEND_BACKWARD + 4.0 * c) * n.contributing,
    };
    let geometry = Work {
        bytes: WORD * GEOMETRY * (n.visible + n.gaussians),
        operations: PROJECTION_BACKWARD * n.visible,
    };
    let features = Work {
        bytes: WORD * channels.features * n.gaussians,
        operations: 0.0,
    };
    pixels
        + geometry
        + features
        + colour.map_or_else(Work::default, |degree| colours_backward(n, degree))
}

/// A view's part of sums of `channels` feature channels: `W^T y`, the weights' own sums and the counter.
pub(super) fn lifting(n: &Counts, channels: f64, sorting: Sorting) -> Work {
    let adjoint = Work {
        bytes: WORD * (n.entries + channels * n.pixels + 2.0 * (channels + 2.0) * n.visible),
        operations: EXPONENT * n.evaluated + (BLEND + 1.0 + 2.0 * channels) * n.contributing,
    };
    lists(n, sorting) + adjoint
}

/// Projection and tile lists.
fn lists(n: &Counts, sorting: Sorting) -> Work {
    let projection = Work {
        bytes: WORD * (GEOMETRY * n.gaussians + 2.0 * SPLAT * n.visible),
        operations: TO_CAMERA * n.gaussians + PROJECTION * n.visible,
    };
    let words = match sorting {
        Sorting::Host => HOST_PASSES * 6.0 * n.visible + 4.0 * n.entries,
        Sorting::Device => {
            let bits = u32::BITS - n.tiles.leading_zeros();
            let tile_passes = f64::from(bits.div_ceil(DIGIT).max(1));
            let sort = |passes: f64, keys: f64| (5.0 * passes - 1.0) * keys;
            // The depths and radii; entries made, and put in the order of the tiles.
            2.0 * n.gaussians
                + sort(DEPTH_PASSES, n.gaussians)
                + (2.0 + 4.0) * n.entries
                + sort(tile_passes, n.entries)
        }
    };
    projection
        + Work {
            bytes: WORD * words,
            operations: 0.0,
        }
}

fn colours(n: &Counts, degree: usize) -> Work {
    let k = terms(degree);
    Work {
        bytes: WORD * COLOURS * (k + 2.0) * n.visible,
        operations: (DIRECTION + COLOURS + by_degree(&BASIS, degree) + 2.0 * COLOURS * k)
            * n.visible,
    }
}

fn colours_backward(n: &Counts, degree: usize) -> Work {
    let k = terms(degree);
    let derivative = by_degree(&BASIS, degree) + by_degree(&BASIS_BACKWARD, degree);
    Work {
        bytes: WORD * COLOURS * ((k + 2.0) * n.visible + k * n.gaussians),
        operations: (DIRECTION + derivative + (COLOURS + 5.0) * k) * n.visible,
    }
}

/// Of `degree`; of the highest there is for one above.
fn by_degree(table: &[f64; 4], degree: usize) -> f64 {
    table[degree.min(table.len() - 1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two Gaussians, one of them seen: three entries, 20 pixels of 6 tiles, 50 pairs looked at and 30 that count.
    const TINY: Counts = Counts {
        gaussians: 2.0,
        visible: 1.0,
        entries: 3.0,
        tiles: 6,
        pixels: 20.0,
        evaluated: 50.0,
        contributing: 30.0,
    };
    const RGB: Channels = Channels {
        sh_degree: Some(1),
        features: 0.0,
    };

    #[test]
    fn a_view_counted_by_hand() {
        // 44 * 2 + 64; 24 * 3; 16 * 3; 12 * 4 + 24; 4 * 3; 16 * 20.
        let host = forward(&TINY, &RGB, Sorting::Host);
        assert_eq!(host.bytes, 152.0 + 72.0 + 48.0 + 72.0 + 12.0 + 320.0);
        // 21 * 2 + 239; 15 + 3 + 3 + 24; 500; 10 * 30; 6 * 20.
        assert_eq!(host.operations, 281.0 + 45.0 + 500.0 + 300.0 + 120.0);
        // Six tiles are one pass: 8 * 2 + 76 * 2; 8 * 3 + 16 * 3 + 16 * 3.
        let device = forward(&TINY, &RGB, Sorting::Device);
        assert_eq!(device.bytes - host.bytes, 168.0 + 120.0 - 72.0 - 48.0);
        assert_eq!(device.operations, host.operations);
        // 256 tiles, one number more than a digit has, are two.
        let more = forward(&Counts { tiles: 256, ..TINY }, &RGB, Sorting::Device);
        assert_eq!(more.bytes - device.bytes, 20.0 * 3.0);
    }

    #[test]
    fn a_backward_pass_counted_by_hand() {
        let work = backward(&TINY, &RGB);
        // 8 * 3 + 32 + 12 + 24 * 20 + 48; 44 * 3; 24 + 48 + 48 * 2.
        assert_eq!(work.bytes, 596.0 + 132.0 + 168.0);
        // 6 * 20 + 500 + 33 * 30; 450; 15 + 3 + 20 + 8 * 4.
        assert_eq!(work.operations, 1610.0 + 450.0 + 70.0);
    }

    #[test]
    fn a_lifting_counted_by_hand() {
        let work = lifting(&TINY, 64.0, Sorting::Host);
        // As above; 4 * 3 + 256 * 20 + 512 + 16.
        assert_eq!(work.bytes, 152.0 + 72.0 + 48.0 + 5660.0);
        assert_eq!(work.operations, 281.0 + 500.0 + 133.0 * 30.0);
    }

    #[test]
    fn work_grows_with_channels_degree_and_gaussians() {
        let at_least =
            |more: Work, less: Work| more.bytes > less.bytes && more.operations > less.operations;
        let all = |n: &Counts, channels: &Channels| {
            forward(n, channels, Sorting::Device) + backward(n, channels)
        };
        for features in [1.0, 20.0, 64.0] {
            assert!(at_least(
                all(&TINY, &Channels { features, ..RGB }),
                all(&TINY, &RGB)
            ));
        }
        for degree in 0..3 {
            let of = |degree| {
                all(
                    &TINY,
                    &Channels {
                        sh_degree: Some(degree),
                        features: 0.0,
                    },
                )
            };
            assert!(at_least(of(degree + 1), of(degree)));
        }
        let double = Counts {
            gaussians: 4.0,
            visible: 2.0,
            ..TINY
        };
        assert!(at_least(all(&double, &RGB), all(&TINY, &RGB)));
        assert_eq!(
            [Work {
                bytes: 1.0,
                operations: 2.0
            }; 3]
                .into_iter()
                .sum::<Work>()
                .scaled(2.0)
                .operations,
            12.0
        );
    }
}
