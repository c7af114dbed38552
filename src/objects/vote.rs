//! The vote: each Gaussian takes the class with the largest summed alpha' T over the raw labels of the training views.
//!
//! This is the closed-form baseline that a trained decoder has to beat (FlashSplat solves the same table as a linear
//! programme). The table itself also says how contested a Gaussian is. Labels are lifted by the adjoint of blending, one channel
//! a class.

use super::Identities;
use super::largest::first_largest;
use super::view_votes::ViewVotes;
use crate::backend::device::read;
use crate::data::{Classes, View};
use crate::error::Result;
use crate::metrics::Agreement;
use crate::raster::{Settings, SplatTensors, SplatView};
use crate::splat::Gaussians;
use burn::tensor::{Device, IndexingUpdateOp, Int, Tensor, TensorData};

/// Summed weights of each class on each Gaussian.
#[derive(Clone, Debug, PartialEq)]
pub struct Votes {
    /// `[N, C]` row-major: sum over labelled training pixels of alpha' T where the label is class c.
    pub table: Vec<f32>,
    /// C.
    pub classes: usize,
}

/// Collects the votes of all `views` that have raw labels, on `device`: one vote of each labelled pixel for its class.
///
/// # Errors
/// Those of [`SplatView::blend_adjoint`].
pub fn vote<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    classes: &Classes,
    settings: &Settings,
    device: &Device,
) -> Result<Votes> {
    let cast = |view: &View| Ok(ViewVotes::of_labels(view, classes));
    collect(gaussians, views, classes.len(), cast, settings, device)
}

/// Votes for labels of a network: as [`vote`], but labelled pixels of views with scores divide their vote among classes as the
/// network does, and the votes of a view on a Gaussian are multiplied by its distance from the camera. Near views have the most
/// pixels of a Gaussian, but the network sees too little of an object in them.
///
/// # Errors
/// Those of [`vote`] and of [`ViewScores::read`](crate::data::ViewScores::read).
pub fn weighted_vote<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    classes: &Classes,
    settings: &Settings,
    device: &Device,
) -> Result<Votes> {
    let cast = |view: &View| ViewVotes::weighted(view, classes, gaussians, device);
    collect(gaussians, views, classes.len(), cast, settings, device)
}

/// Sums what the views with raw labels `cast`.
fn collect<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    classes: usize,
    cast: impl Fn(&View) -> Result<ViewVotes>,
    settings: &Settings,
    device: &Device,
) -> Result<Votes> {
    if gaussians.is_empty() || classes == 0 {
        return Ok(Votes {
            table: Vec::new(),
            classes,
        });
    }
    let splats = SplatTensors::new(gaussians, device);
    let mut tables = VoteTables::new(&splats, classes);
    for view in views.filter(|view| view.raw.is_some()) {
        tables.add(&splats.seen_by(&view.camera, settings), &cast(view)?)?;
    }
    tables.read()
}

/// Votes on a device until all views are in.
struct VoteTables {
    gaussians: usize,
    classes: usize,
    /// Classes of a table; the last one may have fewer.
    width: usize,
    /// `[N, width]`. A table takes at most a quarter of the device's largest buffer, unless one class takes more.
    tables: Vec<Tensor<2>>,
}

impl VoteTables {
    /// No votes yet of `classes` for `splats`; there are some of both.
    fn new(splats: &SplatTensors, classes: usize) -> Self {
        let width = splats.channels_within(usize::MAX).clamp(1, classes);
        Self::of_width(splats, classes, width)
    }

    fn of_width(splats: &SplatTensors, classes: usize, width: usize) -> Self {
        let n = splats.len();
        let table = |first: usize| Tensor::zeros([n, width.min(classes - first)], &splats.device());
        Self {
            gaussians: n,
            classes,
            width,
            tables: (0..classes).step_by(width).map(table).collect(),
        }
    }

    /// Adds the votes that `view` casts.
    fn add(&mut self, view: &SplatView, cast: &ViewVotes) -> Result<()> {
        let (height, width) = (view.camera().height, view.camera().width);
        let device = view.device();
        let table_of = |class: u16| usize::from(class) / self.width;
        // Only the classes that the view shows, so that neither time nor memory grows with those of the whole scene.
        let shown = cast.shown();
        for part in shown.chunk_by(|&a, &b| table_of(a) == table_of(b)) {
            let Some(&class) = part.first() else { continue };
            let number = table_of(class);
            for block in view.channel_blocks(part.len()) {
                let part = &part[block];
                let image = cast.image(part, &device);
                let mut sums = view
                    .blend_adjoint(image.reshape([height, width, part.len()]))?
                    .sums;
                if let Some(weights) = &cast.weights {
                    sums = sums * weights.clone();
                }
                let columns = part
                    .iter()
                    .map(|&class| i64::from(class) - (number * self.width) as i64)
                    .collect();
                let columns =
                    Tensor::<1, Int>::from_data(TensorData::new(columns, [part.len()]), &device);
                // Taken out: burn copies a table that has a second owner.
                let table = self.tables.remove(number);
                self.tables.insert(
                    number,
                    table.select_assign(1, columns, sums, IndexingUpdateOp::Add),
                );
            }
        }
        Ok(())
    }

    /// All votes, on the host.
    fn read(mut self) -> Result<Votes> {
        let classes = self.classes;
        if self.tables.len() == 1 {
            let table = read("votes", self.tables.remove(0))?;
            return Ok(Votes { table, classes });
        }
        let mut table = vec![0.0; self.gaussians * classes];
        for (number, part) in self.tables.into_iter().enumerate() {
            let first = number * self.width;
            let columns = part.dims()[1];
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

impl Votes {
    /// The votes of each Gaussian.
    pub fn rows(&self) -> std::slice::ChunksExact<'_, f32> {
        self.table.chunks_exact(self.classes.max(1))
    }

    /// Class index of each Gaussian's largest vote; `None` where nothing was voted. Ties go to the lower index.
    pub fn winners(&self) -> Vec<Option<u16>> {
        self.rows()
            .map(|row| first_largest(row).filter(|&c| row[c] > 0.0))
            .map(|best| best.map(|c| c as u16))
            .collect()
    }

    /// One-hot identities of the winners; zero where nothing was voted.
    pub fn identities(&self) -> Identities {
        let mut scores = vec![0.0; self.table.len()];
        for (row, winner) in scores
            .chunks_exact_mut(self.classes.max(1))
            .zip(self.winners())
        {
            if let Some(c) = winner {
                row[usize::from(c)] = 1.0;
            }
        }
        Identities {
            scores,
            classes: self.classes,
        }
    }

    /// Logarithms of the shares of each Gaussian's votes, `[N, C]`, every share raised by `floor`: the votes as logits of a
    /// softmax. Equal in all classes where nothing was voted.
    pub fn log_shares(&self, floor: f32) -> Vec<f32> {
        let shares = self.rows().flat_map(|row| {
            let total = row.iter().sum::<f32>().max(f32::MIN_POSITIVE);
            row.iter().map(move |v| (v / total + floor).ln())
        });
        shares.collect()
    }

    /// How far the views agree, over all Gaussians with votes; zeros when there are none.
    pub fn agreement(&self) -> Agreement {
        let (mut voted, mut entropy, mut contested) = (0_u64, 0.0, 0_u64);
        for (row, of_row) in self.rows().zip(self.entropy()) {
            let (sum, most) = row
                .iter()
                .fold((0.0, 0.0_f32), |(sum, most), &v| (sum + v, most.max(v)));
            if sum > 0.0 {
                voted += 1;
                entropy += f64::from(of_row);
                contested += u64::from(3.0 * most < 2.0 * sum);
            }
        }
        let count = voted.max(1) as f64;
        Agreement {
            entropy: entropy / count,
            contested: contested as f64 / count,
        }
    }

    /// Shannon entropy (nats) of each Gaussian's votes: 0 where all views agree or nothing was voted.
    pub fn entropy(&self) -> Vec<f32> {
        self.rows()
            .map(|row| {
                let sum: f32 = row.iter().sum();
                row.iter()
                    .filter(|v| **v > 0.0)
                    .map(|v| -(v / sum) * (v / sum).ln())
                    .sum()
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::{BackendName, device_of_tests};
    use crate::splat::camera::Camera;
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
        // Every eighth run of five pixels votes for nothing; the others divide their vote.
        let votes_of = |pixel: usize, shown: &[u16]| -> Vec<(u16, f32)> {
            let class = (pixel / 5 % 8) as u16;
            let other = (class + 3) % 7;
            let votes = [(class, 0.75), (other, 0.25)];
            votes
                .into_iter()
                .filter(|(c, _)| class < 7 && shown.contains(c))
                .collect()
        };
        let pixels = |shown: &[u16]| {
            let mut pixels = ViewVotes {
                votes: Vec::new(),
                ends: Vec::new(),
                weights: None,
            };
            for pixel in 0..32 * 24 {
                pixels.votes.extend(votes_of(pixel, shown));
                pixels.ends.push(pixels.votes.len());
            }
            pixels
        };
        for device in BackendName::compiled()
            .iter()
            .filter_map(|&name| device_of_tests(name))
        {
            let votes = |width| {
                let splats = SplatTensors::new(&gaussians, &device);
                let view = splats.seen_by(&camera, &Settings::default());
                let mut votes = VoteTables::of_width(&splats, classes, width);
                let all = pixels(&[0, 1, 2, 3, 4, 5, 6]);
                votes.add(&view, &all).expect("votes");
                votes.add(&view, &pixels(&[1, 6])).expect("votes");
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
