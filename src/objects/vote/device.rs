//! The table of votes on a GPU: labels are lifted by the rasterizer's adjoint, a channel a class, and summed where they are.

use super::Votes;
use crate::backend::device::{largest_allocation, read};
use crate::error::Result;
use crate::objects::device_labels::one_hot;
use crate::raster::{Settings, SplatTensors};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use burn::tensor::{Device, IndexingUpdateOp, Int, Tensor, TensorData};

/// Votes that stay on a device until all views are in.
pub(super) struct DeviceVotes {
    splats: SplatTensors,
    settings: Settings,
    classes: usize,
    /// So many classes a table, the last of which may have fewer.
    width: usize,
    /// `[N, width]`: no buffer is more than a quarter of the device's largest, unless one class is.
    tables: Vec<Tensor<2>>,
}

impl DeviceVotes {
    /// None so far of `classes` for `gaussians`, both of which there are some of.
    pub fn new(
        gaussians: &Gaussians,
        classes: usize,
        settings: &Settings,
        device: &Device,
    ) -> Self {
        let most = largest_allocation(device).map_or(usize::MAX, |bytes| bytes / 4);
        let width = (most / (gaussians.len() * size_of::<f32>())).clamp(1, classes);
        Self::in_tables(gaussians, [classes, width], settings, device)
    }

    fn in_tables(
        gaussians: &Gaussians,
        [classes, width]: [usize; 2],
        settings: &Settings,
        device: &Device,
    ) -> Self {
        let (n, device) = (gaussians.len(), device.clone().inner());
        let table = |first: usize| Tensor::zeros([n, width.min(classes - first)], &device);
        Self {
            tables: (0..classes).step_by(width).map(table).collect(),
            splats: SplatTensors::new(gaussians, &device),
            settings: *settings,
            classes,
            width,
        }
    }

    /// Adds the view of `camera`, whose pixels are of the classes `labels`; those below the number of classes are `shown`,
    /// ascending.
    pub fn add(&mut self, camera: &Camera, labels: &[u16], shown: &[u16]) -> Result<()> {
        let (height, width, device) = (camera.height, camera.width, self.splats.means.device());
        let view = self.splats.seen_by(camera, &self.settings);
        let labels: Vec<f32> = labels.iter().map(|&class| f32::from(class)).collect();
        let labels = Tensor::<2>::from_data(TensorData::new(labels, [height * width, 1]), &device);
        for part in
            shown.chunk_by(|&a, &b| usize::from(a) / self.width == usize::from(b) / self.width)
        {
            let Some(&class) = part.first() else { continue };
            let number = usize::from(class) / self.width;
            for block in view.channel_blocks(part.len()) {
                let part = &part[block];
                let image = one_hot(
                    &labels,
                    part.iter().map(|&class| f32::from(class)).collect(),
                );
                let sums = view
                    .blend_adjoint(image.reshape([height, width, part.len()]))?
                    .sums;
                let columns = part
                    .iter()
                    .map(|&class| i64::from(class) - (number * self.width) as i64)
                    .collect();
                let columns =
                    Tensor::<1, Int>::from_data(TensorData::new(columns, [part.len()]), &device);
                // Taken out: a table that somebody else held would be copied.
                let table = self.tables.remove(number);
                self.tables.insert(
                    number,
                    table.select_assign(1, columns, sums, IndexingUpdateOp::Add),
                );
            }
        }
        Ok(())
    }

    /// All of them, on the host.
    pub fn read(self) -> Result<Votes> {
        let Self {
            classes,
            width,
            mut tables,
            splats,
            ..
        } = self;
        if tables.len() == 1 {
            return Ok(Votes {
                table: read("votes", tables.remove(0))?,
                classes,
            });
        }
        let mut table = vec![0.0; splats.len() * classes];
        for (number, part) in tables.into_iter().enumerate() {
            let (first, columns) = (number * width, part.dims()[1]);
            let part = read("votes", part)?;
            for (row, values) in table
                .chunks_exact_mut(classes)
                .zip(part.chunks_exact(columns))
            {
                row[first..first + columns].copy_from_slice(values);
            }
        }
        Ok(Votes { table, classes })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::{BackendName, device_of_tests};
    use glam::{DMat3, DVec3};

    #[test]
    fn any_number_of_tables_holds_the_same_votes() {
        let n = 60;
        let gaussians = Gaussians {
            means: (0..n)
                .map(|i| {
                    [
                        (i % 10) as f32 * 0.1 - 0.45,
                        (i / 10) as f32 * 0.1 - 0.25,
                        1.0,
                    ]
                })
                .collect(),
            log_scales: vec![[-3.0; 3]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![1.0; n],
            sh: vec![0.0; 3 * n],
            sh_degree: 0,
        };
        let camera = Camera {
            width: 32,
            height: 24,
            fx: 30.0,
            fy: 30.0,
            cx: 16.0,
            cy: 12.0,
            rotation: DMat3::IDENTITY,
            center: DVec3::ZERO,
        };
        let classes = 7;
        // 7 is no class.
        let labels: Vec<u16> = (0..32 * 24).map(|pixel| (pixel / 5 % 8) as u16).collect();
        for device in BackendName::compiled()
            .iter()
            .filter_map(|&name| device_of_tests(name))
        {
            let votes = |width| {
                let settings = Settings::default();
                let mut votes =
                    DeviceVotes::in_tables(&gaussians, [classes, width], &settings, &device);
                votes
                    .add(&camera, &labels, &[0, 1, 2, 3, 4, 5, 6])
                    .expect("votes");
                votes.add(&camera, &labels, &[1, 6]).expect("votes");
                votes.read().expect("readable")
            };
            let whole = votes(classes);
            let sum = |class: usize| whole.table.iter().skip(class).step_by(classes).sum::<f32>();
            assert!((0..classes).all(|class| sum(class) > 1.0), "{device:?}");
            for width in [1, 2, 3, 5] {
                // Sums of another number of channels are rounded otherwise.
                let votes = votes(width);
                assert_eq!(
                    (votes.classes, votes.table.len()),
                    (classes, whole.table.len())
                );
                let apart = votes
                    .table
                    .iter()
                    .zip(&whole.table)
                    .map(|(a, b)| (a - b).abs() / b.max(1e-3));
                let apart = apart.fold(0.0, f32::max);
                assert!(apart < 1e-5, "tables of {width} on {device:?}: {apart}");
            }
        }
    }
}
