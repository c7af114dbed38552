//! Screen-space gradients between densifications.

use crate::backend::device::{indices, read, upload};
use crate::error::Result;
use crate::ranks;
use burn::tensor::{Device, Tensor};

/// Screen-space gradients since the last densification.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GradientStatistics {
    /// Sum of |(dL/du W/2, dL/dv H/2)|, `[N]`; with AbsGS of sums of absolute values.
    pub gradient: Vec<f32>,
    /// Iterations in which the Gaussian was visible, `[N]`.
    pub visible: Vec<u32>,
}

impl GradientStatistics {
    /// Zeros for `n` Gaussians.
    pub fn new(n: usize) -> Self {
        Self {
            gradient: vec![0.0; n],
            visible: vec![0; n],
        }
    }

    /// Mean over the iterations in which Gaussian `i` was visible; 0 when it never was.
    pub fn mean(&self, i: usize) -> f32 {
        self.gradient[i] / self.visible[i].max(1) as f32
    }
}

/// [`GradientStatistics`] as tensors `[N]` on the device of the gradients.
#[derive(Clone, Debug)]
pub(crate) struct GradientAccumulator {
    /// Sums of lengths of the screen-space gradient.
    gradient: Tensor<1>,
    /// Iterations in which the Gaussian was visible; exact up to 2^24.
    visible: Tensor<1>,
}

impl GradientAccumulator {
    /// Starts from `stats`, on `device`.
    pub fn new(stats: GradientStatistics, device: &Device) -> Self {
        let n = stats.gradient.len();
        let visible = stats.visible.iter().map(|&count| count as f32).collect();
        Self {
            gradient: upload(stats.gradient, [n], device),
            visible: upload(visible, [n], device),
        }
    }

    /// Adds one iteration. `screen` is the screen-space gradient, `[N, 2]`, or `[N, 4]` whose last two columns count;
    /// `radii` are `[N]`, 0 for culled Gaussians.
    pub fn record(&mut self, screen: Tensor<2>, radii: Tensor<1>) {
        let [n, columns] = screen.dims();
        let gradient = screen.slice([0..n, columns - 2..columns]);
        let length = (gradient.clone() * gradient).sum_dim(1).sqrt().reshape([n]);
        let seen = radii.greater_elem(0.0).float();
        self.gradient = self.gradient.clone() + length * seen.clone();
        self.visible = self.visible.clone() + seen;
    }

    /// The sums of all ranks.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return them.
    pub fn of_all_ranks(self) -> Result<Self> {
        let [gradient, visible] = [self.gradient, self.visible]
            .map(|values| ranks::sum_tensor("screen-space gradients", values));
        Ok(Self {
            gradient: gradient?,
            visible: visible?,
        })
    }

    /// Keeps `rows`.
    pub fn select(&mut self, rows: &[u32]) {
        let rows = indices(rows, &self.gradient.device());
        self.gradient = self.gradient.clone().select(0, rows.clone());
        self.visible = self.visible.clone().select(0, rows);
    }

    /// The statistics on the host.
    ///
    /// # Errors
    /// [`crate::Error::Device`] when the device does not return them.
    pub fn read(&self) -> Result<GradientStatistics> {
        let both = Tensor::cat(vec![self.gradient.clone(), self.visible.clone()], 0);
        let mut gradient = read("screen-space gradients", both)?;
        let visible = gradient.split_off(gradient.len() / 2);
        Ok(GradientStatistics {
            gradient,
            visible: visible.into_iter().map(|count| count as u32).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::{BackendName, device_of_tests};
    use burn::tensor::TensorData;

    #[test]
    fn statistics_are_those_of_the_host_on_every_device() {
        let n = 700;
        let waves = |count: usize, by: f32| -> Vec<f32> {
            (0..count).map(|i| (i as f32 * by).sin() * 1e-4).collect()
        };
        for &name in BackendName::compiled() {
            let Some(device) = device_of_tests(name) else {
                continue;
            };
            for columns in [2, 4] {
                let mut want = GradientStatistics::new(n);
                want.visible.fill(2);
                let mut got = GradientAccumulator::new(want.clone(), &device);
                for view in 1..=3 {
                    let screen = waves(n * columns, view as f32);
                    let radii: Vec<u32> = (0..n as u32).map(|i| (i + view) % 4).collect();
                    let as_floats: Vec<f32> = radii.iter().map(|&r| r as f32).collect();
                    let last: Vec<f32> = screen
                        .chunks_exact(columns)
                        .flat_map(|row| [row[columns - 2], row[columns - 1]])
                        .collect();
                    for (i, row) in last.as_chunks::<2>().0.iter().enumerate() {
                        if radii[i] > 0 {
                            want.gradient[i] += row[0].hypot(row[1]);
                            want.visible[i] += 1;
                        }
                    }
                    let screen = TensorData::new(screen, [n, columns]);
                    got.record(
                        Tensor::from_data(screen, &device),
                        Tensor::from_data(TensorData::new(as_floats, [n]), &device),
                    );
                }
                let got = got.read().expect("readable");
                assert_eq!(got.visible, want.visible, "{columns} columns on {name}");
                for (i, (a, b)) in got.gradient.iter().zip(&want.gradient).enumerate() {
                    assert!((a - b).abs() <= 1e-6 * b, "{i} on {name}: {a} for {b}");
                }
            }
        }
    }
}
