//! Votes on a device until all views are in.

use super::Votes;
use super::view_votes::ViewVotes;
use crate::backend::device::{indices, read};
use crate::error::Result;
use crate::raster::{SplatTensors, SplatView};
use burn::tensor::{IndexingUpdateOp, Tensor};

/// Least blended share of a class that a vote is divided by.
const MIN_SHARE: f32 = 1e-4;

/// Votes on a device until all views are in.
pub(super) struct VoteTables {
    gaussians: usize,
    classes: usize,
    /// Classes of a table; the last one may have fewer.
    width: usize,
    /// `[N, width]`. A table takes at most a quarter of the device's largest buffer, unless one class takes more.
    tables: Vec<Tensor<2>>,
}

impl VoteTables {
    /// No votes yet of `classes` for `splats`; there are some of both.
    pub fn new(splats: &SplatTensors, classes: usize) -> Self {
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
    pub fn add(
        &mut self,
        view: &SplatView,
        cast: &ViewVotes,
        shares: Option<&Votes>,
    ) -> Result<()> {
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
                let first = (number * self.width) as u32;
                let columns: Vec<u32> = part.iter().map(|&c| u32::from(c) - first).collect();
                let columns = indices(&columns, &device);
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
    pub fn read(mut self) -> Result<Votes> {
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
        return view.blend_adjoint(image);
    };
    let shares = shares.of_classes(part, &view.device());
    let (blended, _) = view.blend(shares.clone())?;
    let ratio = image / (blended + MIN_SHARE);
    Ok(view.blend_adjoint(ratio)? * shares)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::device::{BackendName, device_of_tests};
    use crate::raster::Settings;
    use crate::splat::Gaussians;
    use crate::splat::camera::Camera;
    use burn::tensor::Device;
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
                    // Sums of another number of channels are rounded differently.
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
                votes.read().expect("readable").shares()
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
            // The column of Gaussians left of the edge.
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
