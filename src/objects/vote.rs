//! The vote: each Gaussian takes the class with the largest summed alpha' T over the raw labels of the training views.
//!
//! This is the closed-form baseline that a trained decoder has to beat (FlashSplat solves the same table as a linear
//! programme). The table itself also says how contested a Gaussian is. Labels are lifted by the adjoint of blending, one channel
//! a class.

use super::Identities;
use super::largest::first_largest;
use super::view_votes::ViewVotes;
use crate::backend::device::{read, upload};
use crate::data::{Classes, View};
use crate::error::Result;
use crate::metrics::Agreement;
use crate::raster::{Settings, SplatTensors, SplatView};
use crate::splat::Gaussians;
use burn::tensor::{Device, IndexingUpdateOp, Int, Tensor, TensorData};

/// Steps of expectation maximisation in [`refined_vote`]. More of them fit errors: without pooling, the second one already costs
/// accuracy where errors last over neighbouring views.
const REFINEMENTS: usize = 2;
/// Least blended share of a class that a vote is divided by.
const LEAST_SHARE: f32 = 1e-4;

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

/// Votes for labels with errors: as [`vote`], but labelled pixels of views with scores divide their vote among classes as the
/// segmenter does, and the votes of a view on a Gaussian are multiplied by its distance from the camera. Near views have the most
/// pixels of a Gaussian, but a network sees too little of an object in them.
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

/// The [`weighted_vote`] after `REFINEMENTS` steps of expectation maximisation (Dempster et al. 1977), which undo the blur of
/// blending. The label of a pixel is taken as drawn from the blended class shares `sum_j w_j p_jc` of its Gaussians. Its vote for
/// class c counts `w_i p_ic / sum_j w_j p_jc` on Gaussian i, where the shares p are those of the votes before. From equal shares, a
/// step gives the votes without refinement, divided by the coverage of their pixels.
///
/// # Errors
/// Those of [`weighted_vote`].
pub fn refined_vote<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    classes: &Classes,
    settings: &Settings,
    device: &Device,
) -> Result<Votes> {
    let views: Vec<&View> = views.collect();
    let views = || views.iter().copied();
    let mut votes = weighted_vote(gaussians, views(), classes, settings, device)?;
    for _ in 0..REFINEMENTS {
        let cast = |view: &View| ViewVotes::weighted(view, classes, gaussians, device);
        votes = refine(votes, gaussians, views(), cast, settings, device)?;
    }
    Ok(votes)
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
        let seen = splats.seen_by(&view.camera, settings);
        tables.add(&seen, &cast(view)?, None)?;
    }
    tables.read()
}

/// One step of expectation maximisation from the shares of `votes`, over what the views `cast`.
fn refine<'a>(
    mut votes: Votes,
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    cast: impl Fn(&View) -> Result<ViewVotes>,
    settings: &Settings,
    device: &Device,
) -> Result<Votes> {
    if votes.table.is_empty() {
        return Ok(votes);
    }
    for row in votes.table.chunks_exact_mut(votes.classes) {
        let total = row.iter().sum::<f32>().max(f32::MIN_POSITIVE);
        row.iter_mut().for_each(|vote| *vote /= total);
    }
    let splats = SplatTensors::new(gaussians, device);
    let mut tables = VoteTables::new(&splats, votes.classes);
    for view in views.filter(|view| view.raw.is_some()) {
        let seen = splats.seen_by(&view.camera, settings);
        tables.add(&seen, &cast(view)?, Some(&votes))?;
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

    /// Adds the votes that `view` casts. Where there are `shares`, they count in the Gaussians of a pixel by these.
    fn add(&mut self, view: &SplatView, cast: &ViewVotes, shares: Option<&Votes>) -> Result<()> {
        let device = view.device();
        let table_of = |class: u16| usize::from(class) / self.width;
        // Only the classes that the view shows, so that neither time nor memory grows with those of the whole scene.
        let shown = cast.shown();
        for part in shown.chunk_by(|&a, &b| table_of(a) == table_of(b)) {
            let Some(&class) = part.first() else { continue };
            let number = table_of(class);
            for block in view.channel_blocks(part.len()) {
                let part = &part[block];
                let mut sums = lifted(view, cast, part, shares)?;
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

/// What `cast` gives each Gaussian of `view` for the classes `part`, `[N, len]`.
fn lifted(
    view: &SplatView,
    cast: &ViewVotes,
    part: &[u16],
    shares: Option<&Votes>,
) -> Result<Tensor<2>> {
    let size = [view.camera().height, view.camera().width, part.len()];
    let image = cast.image(part, &view.device()).reshape(size);
    let Some(shares) = shares else {
        return Ok(view.blend_adjoint(image)?.sums);
    };
    let own = shares.of_classes(part, &view.device());
    let (blended, _) = view.blend(own.clone())?;
    let ratio = image / (blended + LEAST_SHARE);
    Ok(view.blend_adjoint(ratio)?.sums * own)
}

impl Votes {
    /// The columns of the classes `part`, `[N, len]`.
    fn of_classes(&self, part: &[u16], device: &Device) -> Tensor<2> {
        let values = self
            .rows()
            .flat_map(|row| part.iter().map(|&class| row[usize::from(class)]));
        let values: Vec<f32> = values.collect();
        let rows = values.len() / part.len();
        upload(values, [rows, part.len()], device)
    }

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

    /// Six rows of ten overlapping Gaussians.
    fn gaussians() -> Gaussians {
        let n = 60;
        let mean = |i: usize| {
            let x = (i % 10) as f32 * 0.1 - 0.45;
            let y = (i / 10) as f32 * 0.1 - 0.25;
            [x, y, 1.0]
        };
        Gaussians {
            means: (0..n).map(mean).collect(),
            log_scales: vec![[-3.0; 3]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![1.0; n],
            sh: vec![0.0; 3 * n],
            sh_degree: 0,
        }
    }

    /// It sees all of them, in 32 x 24 pixels.
    fn camera() -> Camera {
        Camera {
            width: 32,
            height: 24,
            fx: 30.0,
            fy: 30.0,
            cx: 16.0,
            cy: 12.0,
            rotation: DMat3::IDENTITY,
            center: DVec3::ZERO,
        }
    }

    fn devices() -> impl Iterator<Item = Device> {
        let names = BackendName::compiled().iter();
        names.filter_map(|&name| device_of_tests(name))
    }

    fn cast(votes_of: impl Fn(usize) -> Vec<(u16, f32)>) -> ViewVotes {
        let mut pixels = ViewVotes {
            votes: Vec::new(),
            ends: Vec::new(),
            weights: None,
        };
        for pixel in 0..32 * 24 {
            pixels.votes.extend(votes_of(pixel));
            pixels.ends.push(pixels.votes.len());
        }
        pixels
    }

    /// Every eighth run of five pixels votes for nothing; the others divide their vote. Only for the classes `shown`.
    fn divided(shown: &[u16]) -> ViewVotes {
        cast(|pixel| {
            let class = (pixel / 5 % 8) as u16;
            let votes = [(class, 0.75), ((class + 3) % 7, 0.25)].into_iter();
            votes
                .filter(|(c, _)| class < 7 && shown.contains(c))
                .collect()
        })
    }

    #[test]
    fn any_number_of_tables_holds_the_same_votes() {
        let classes = 7;
        for device in devices() {
            let splats = SplatTensors::new(&gaussians(), &device);
            let view = splats.seen_by(&camera(), &Settings::default());
            let votes = |width, shares: Option<&Votes>| {
                let mut votes = VoteTables::of_width(&splats, classes, width);
                let all = divided(&[0, 1, 2, 3, 4, 5, 6]);
                votes.add(&view, &all, shares).expect("votes");
                let some = divided(&[1, 6]);
                votes.add(&view, &some, shares).expect("votes");
                votes.read().expect("readable")
            };
            let mut shares: Option<Votes> = None;
            for _ in 0..2 {
                let whole = votes(classes, shares.as_ref());
                let sum =
                    |class: usize| whole.table.iter().skip(class).step_by(classes).sum::<f32>();
                assert!((0..classes).all(|class| sum(class) > 1.0), "{device:?}");
                for width in [1, 2, 3, 5] {
                    // Sums of another number of channels are rounded otherwise.
                    let votes = votes(width, shares.as_ref());
                    assert_eq!(votes.table.len(), whole.table.len());
                    let pairs = votes.table.iter().zip(&whole.table);
                    let apart = pairs.map(|(a, b)| (a - b).abs() / b.max(1e-3));
                    let apart = apart.fold(0.0, f32::max);
                    assert!(apart < 1e-5, "tables of {width} on {device:?}: {apart}");
                }
                shares = Some(whole);
            }
        }
    }

    #[test]
    fn refinements_make_labels_more_likely_and_edges_sharper() {
        // The left half is class 0, the right half class 1.
        let label = |pixel: usize| u16::from(pixel % 32 >= 16);
        for device in devices() {
            let splats = SplatTensors::new(&gaussians(), &device);
            let view = splats.seen_by(&camera(), &Settings::default());
            let labels = cast(|pixel| vec![(label(pixel), 1.0)]);
            let step = |shares: Option<&Votes>| {
                let mut votes = VoteTables::new(&splats, 2);
                votes.add(&view, &labels, shares).expect("votes");
                let mut votes = votes.read().expect("readable");
                for row in votes.table.chunks_exact_mut(2) {
                    let total: f32 = row.iter().sum();
                    row.iter_mut().for_each(|vote| *vote /= total);
                }
                votes
            };
            // Mean logarithm of the blended share of each label.
            let likelihood = |votes: &Votes| {
                let own = votes.of_classes(&[0, 1], &device);
                let blended = view.blend(own).expect("blended").0;
                let blended = read("shares", blended).expect("readable");
                let of_label = |(pixel, p): (usize, &[f32])| p[usize::from(label(pixel))];
                let shares = blended.chunks_exact(2).enumerate().map(of_label);
                let covered: Vec<f32> = shares.filter(|share| *share > 0.05).collect();
                covered.iter().map(|share| share.ln()).sum::<f32>() / covered.len() as f32
            };
            let mut votes = step(None);
            // Of the column of Gaussians left of the edge.
            let blurred = votes.table[2 * 4];
            for _ in 0..4 {
                let refined = step(Some(&votes));
                let gain = likelihood(&refined) - likelihood(&votes);
                assert!(gain > 1e-4, "{device:?}: {gain}");
                votes = refined;
            }
            let sharp = votes.table[2 * 4];
            assert!(
                blurred < 0.9 && sharp > 0.97,
                "{device:?}: {blurred}, then {sharp}"
            );
        }
    }
}
