//! What densification gathers, on the host or on the GPU that the gradients lie on.

use crate::backend::device::{in_host_memory, read};
use crate::error::Result;
use crate::ops::add_screen_gradients;
use crate::raster::Radii;
use crate::reconstruction::densify::DensityStats;
use burn::tensor::{Device, Tensor, TensorData};

/// [`DensityStats`] in the making. On a GPU they stay there: an iteration reads nothing back for them.
#[derive(Clone, Debug)]
pub(crate) enum Tally {
    Host(DensityStats),
    /// Sums of gradients, and numbers of views, `[N]`; exact up to 2^24 views.
    Device(Box<[Tensor<1>; 2]>),
}

impl Tally {
    /// Goes on from `stats`, where tensors lie on `device`.
    pub fn new(stats: DensityStats, device: &Device) -> Self {
        if in_host_memory(device) {
            return Self::Host(stats);
        }
        let tensor = |values: Vec<f32>| {
            let n = values.len();
            Tensor::from_data(TensorData::new(values, [n]), device)
        };
        let visible = stats.visible.iter().map(|&count| count as f32).collect();
        Self::Device(Box::new([tensor(stats.gradient), tensor(visible)]))
    }

    /// Nothing gathered yet for `n` Gaussians.
    pub fn empty(n: usize, device: &Device) -> Self {
        if in_host_memory(device) {
            return Self::Host(DensityStats::new(n));
        }
        Self::Device(Box::new([
            Tensor::zeros([n], device),
            Tensor::zeros([n], device),
        ]))
    }

    /// Adds one iteration: `screen` is the screen-space gradient, `[N, 2]`, or `[N, 4]` of which the last two columns count.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not give back what the host sums.
    pub fn record(&mut self, screen: Tensor<2>, radii: &Radii) -> Result<()> {
        let columns = screen.dims()[1];
        match self {
            Self::Host(stats) => {
                let values = read("screen-space gradient", screen)?;
                let values = match columns {
                    4 => values
                        .as_chunks::<4>()
                        .0
                        .iter()
                        .flat_map(|row| [row[2], row[3]])
                        .collect(),
                    _ => values,
                };
                stats.record(&values, &radii.read()?);
            }
            Self::Device(sums) => {
                let radii = radii.as_tensor(&screen.device());
                let empty = || Tensor::empty([0], &screen.device());
                // moved out, so that the kernel finds buffers nobody else holds
                let before = std::mem::replace(&mut **sums, [empty(), empty()]);
                **sums = add_screen_gradients(before, screen, radii);
            }
        }
        Ok(())
    }

    /// What was gathered.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not give it back.
    pub fn read(&self) -> Result<DensityStats> {
        match self {
            Self::Host(stats) => Ok(stats.clone()),
            Self::Device(sums) => {
                let both = Tensor::cat(sums.to_vec(), 0);
                let mut gradient = read("screen-space gradients", both)?;
                let visible = gradient.split_off(gradient.len() / 2);
                Ok(DensityStats {
                    gradient,
                    visible: visible.into_iter().map(|count| count as u32).collect(),
                })
            }
        }
    }
}
