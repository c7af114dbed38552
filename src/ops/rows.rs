//! Rows of tensors picked where they lie, for parameters and moments of a set whose members come and go.

#[cfg(feature = "cube")]
use crate::backend::gpu::Resident;
use crate::backend::{HostBackend, HostKernels, device_of, real_kernel};
use burn::backend::{Backend, Dispatch, TensorMetadata, backend_extension, tensor::FloatTensor};
use burn::tensor::Tensor;
#[cfg(feature = "cube")]
use burn_cubecl::tensor::CubeTensor;
use rayon::prelude::*;
use std::sync::Arc;

/// Rows that one task copies at least.
const ROWS: usize = 1024;

/// For each new row the old one it comes from, and whether it is a new member.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowMap {
    pub(super) sources: Vec<u32>,
    /// One more than the largest row.
    end: usize,
    #[cfg(feature = "cube")]
    pub(super) resident: Resident<CubeTensor>,
}

/// What new members get of a tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartOfNew {
    /// A copy of the row they come from.
    Copy,
    /// Zeros.
    Zero,
}

impl RowMap {
    /// Set in the source of a new member.
    pub(super) const NEW: u32 = 1 << 31;

    /// From old row and newness of each new row.
    ///
    /// # Panics
    /// If a row is 2^31 or more.
    pub fn new(sources: impl IntoIterator<Item = (u32, bool)>) -> Self {
        let source = |(row, new)| {
            assert!(row < Self::NEW, "row map: row {row}");
            if new { row | Self::NEW } else { row }
        };
        let sources: Vec<u32> = sources.into_iter().map(source).collect();
        Self {
            end: sources
                .iter()
                .map(|source| source & !Self::NEW)
                .max()
                .map_or(0, |last| last as usize + 1),
            sources,
            #[cfg(feature = "cube")]
            resident: Resident::default(),
        }
    }

    /// New rows.
    pub fn len(&self) -> usize {
        self.sources.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.sources.is_empty()
    }
}

/// Backend side of [`take_rows`]; has no gradient.
#[backend_extension(
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Cube: cfg(feature = "cube")
)]
pub trait RowBackend: Backend {
    /// The rows of `x` (`[N, ..]`) that `map` names, `[R, ..]`.
    fn take_rows(x: FloatTensor<Self>, map: Arc<RowMap>, new: StartOfNew) -> FloatTensor<Self>;
}

impl<B: HostKernels> RowBackend for B {
    fn take_rows(x: FloatTensor<Self>, map: Arc<RowMap>, new: StartOfNew) -> FloatTensor<Self> {
        on_host::take_rows::<Self>(x, &map, new)
    }
}

/// The same on the host, wherever the tensor lives.
pub(super) mod on_host {
    use super::*;

    pub fn take_rows<B: HostBackend>(
        x: FloatTensor<B>,
        map: &RowMap,
        new: StartOfNew,
    ) -> FloatTensor<B> {
        let (device, mut shape) = (device_of::<B>(&x), x.shape().to_vec());
        let width = shape[1..].iter().product::<usize>();
        shape[0] = map.len();
        real_kernel!(x, E => {
            let x = B::values::<E>(x);
            let mut out = vec![E::default(); map.len() * width];
            let rows = out.par_chunks_exact_mut(width.max(1)).zip(&map.sources);
            rows.with_min_len(ROWS).for_each(|(out, &source)| {
                if source & RowMap::NEW == 0 || new == StartOfNew::Copy {
                    out.copy_from_slice(&x[(source & !RowMap::NEW) as usize * width..][..width]);
                }
            });
            B::tensor(out, &shape, &device)
        })
    }
}

/// The rows of `x` (`[N, ..]`, without autodiff) that `map` names, `[R, ..]`, to the bit.
///
/// # Panics
/// If `map` names a row that `x` has not.
pub fn take_rows<const D: usize>(x: Tensor<D>, map: &Arc<RowMap>, new: StartOfNew) -> Tensor<D> {
    assert!(
        map.end <= x.dims()[0],
        "take_rows: row {} of {}",
        map.end - 1,
        x.dims()[0]
    );
    Tensor::from_dispatch(Dispatch::take_rows(x.into_dispatch(), map.clone(), new))
}
