//! Scores of instance maps: association accuracy, instance mIoU, panoptic quality. Predicted ids need not equal true ids.

use super::{assignment, mean};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Id of pixels without an instance, in truth and prediction.
const VOID: u16 = 0;
/// Two segments match above this IoU; then no segment has two matches.
const MATCH: f64 = 0.5;

/// Scores of a set of views against their true instances, each in 0..1.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InstanceScores {
    /// Association accuracy: share of the pixels with a true instance that show the object matched with it. Objects and instances
    /// are matched one to one at the largest sum of pixels over all views. Pixels without an object are wrong.
    pub accuracy: Option<f64>,
    /// Mean over the true instances of the IoU with the matched object, all views counted together; 0 without one.
    pub miou: Option<f64>,
    /// Panoptic quality of each view's segments, all views counted together, one class.
    pub panoptic: Quality,
    /// The same with all views as one image: an object that changes its id between views counts as two.
    pub scene: Quality,
    /// True instances in the views.
    pub instances: usize,
    /// Objects in the views.
    pub objects: usize,
}

/// Panoptic quality = segmentation quality x recognition quality (Kirillov et al. 2019, Eq. 1-2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// Sum of the IoU of matched segments over `TP + FP / 2 + FN / 2`.
    pub pq: Option<f64>,
    /// Mean IoU of matched segments; 0 of a class where none match, as in panopticapi.
    pub sq: Option<f64>,
    /// `TP / (TP + FP / 2 + FN / 2)`.
    pub rq: Option<f64>,
}

/// Pixels of each pair of a true and a predicted id.
#[derive(Clone, Debug, Default)]
pub(super) struct Pairs(BTreeMap<(u16, u16), u64>);

impl Pairs {
    /// The pairs of one view; pixels past the shorter slice are not counted.
    pub fn of(truth: &[u16], prediction: &[u16]) -> Self {
        let mut pairs = Self::default();
        let mut run: Option<((u16, u16), u64)> = None;
        // Neighbours mostly have the same pair: one look-up for each run.
        for pair in truth.iter().copied().zip(prediction.iter().copied()) {
            match &mut run {
                Some((last, n)) if *last == pair => *n += 1,
                _ => {
                    pairs.count(run);
                    run = Some((pair, 1));
                }
            }
        }
        pairs.count(run);
        pairs
    }

    fn count(&mut self, run: Option<((u16, u16), u64)>) {
        if let Some((pair, n)) = run {
            *self.0.entry(pair).or_default() += n;
        }
    }

    pub fn merge(&mut self, other: &Self) {
        for (&pair, &n) in &other.0 {
            self.count(Some((pair, n)));
        }
    }

    fn get(&self, truth: u16, prediction: u16) -> u64 {
        self.0.get(&(truth, prediction)).copied().unwrap_or(0)
    }

    /// Pixels of each true, and of each predicted id.
    fn areas(&self) -> [BTreeMap<u16, u64>; 2] {
        let mut areas: [BTreeMap<u16, u64>; 2] = Default::default();
        for (&(truth, prediction), n) in &self.0 {
            *areas[0].entry(truth).or_default() += n;
            *areas[1].entry(prediction).or_default() += n;
        }
        areas
    }

    /// IoU of a true and a predicted segment; predicted pixels without truth are left out.
    fn iou(&self, truth: u16, prediction: u16, areas: &[BTreeMap<u16, u64>; 2]) -> f64 {
        let both = self.get(truth, prediction);
        let area = |side: usize, id| areas[side].get(&id).copied().unwrap_or(0);
        let union = area(0, truth) + area(1, prediction) - both - self.get(VOID, prediction);
        if union > 0 {
            both as f64 / union as f64
        } else {
            0.0
        }
    }
}

/// Matched segments and those without a match, by class.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct ClassMatches {
    iou: f64,
    matched: usize,
    unmatched: usize,
}

/// Counts segments towards [`Quality`], image by image.
///
/// As in panopticapi, segments of one class match above an IoU of 0.5. Pixels without truth (id 0) do not count in unions. An
/// unmatched prediction is not a false positive if more than half of it lies on such pixels.
#[derive(Clone, Debug, Default)]
pub struct PanopticQuality(BTreeMap<u16, ClassMatches>);

impl PanopticQuality {
    /// Counts one image, `[H, W]` segment ids, 0 is none. `classes` tells the class of a true and of a predicted segment.
    pub fn add(&mut self, truth: &[u16], prediction: &[u16], classes: [&dyn Fn(u16) -> u16; 2]) {
        self.count(&Pairs::of(truth, prediction), classes);
    }

    pub(super) fn count(
        &mut self,
        pairs: &Pairs,
        [true_class, predicted_class]: [&dyn Fn(u16) -> u16; 2],
    ) {
        let areas = pairs.areas();
        let mut matched: [Vec<u16>; 2] = Default::default();
        for &(truth, prediction) in pairs.0.keys().filter(|(t, p)| *t != VOID && *p != VOID) {
            let iou = pairs.iou(truth, prediction, &areas);
            if iou > MATCH && true_class(truth) == predicted_class(prediction) {
                let matches = self.0.entry(true_class(truth)).or_default();
                matches.iou += iou;
                matches.matched += 1;
                matched[0].push(truth);
                matched[1].push(prediction);
            }
        }
        let is_left = |side: usize, id| id != VOID && !matched[side].contains(&id);
        let missed = areas[0].keys().filter(|id| is_left(0, **id));
        let missed = missed.map(|&id| true_class(id));
        let is_false = |id: u16, area: u64| is_left(1, id) && 2 * pairs.get(VOID, id) <= area;
        let false_ones = areas[1].iter().filter(|(id, area)| is_false(**id, **area));
        for class in missed.chain(false_ones.map(|(&id, _)| predicted_class(id))) {
            self.0.entry(class).or_default().unmatched += 1;
        }
    }

    /// The mean over classes that occur.
    pub fn quality(&self) -> Quality {
        self.quality_of(|_| true)
    }

    /// The mean over the classes that occur.
    pub fn quality_of(&self, wanted: impl Fn(u16) -> bool) -> Quality {
        let weight = |t: &ClassMatches| t.matched as f64 + 0.5 * t.unmatched as f64;
        let occurs = || {
            self.0
                .iter()
                .filter(|(class, t)| wanted(**class) && t.matched + t.unmatched > 0)
                .map(|(_, t)| t)
        };
        Quality {
            pq: mean(occurs().map(|t| Some(t.iou / weight(t)))),
            // The sum is 0 where none match.
            sq: mean(occurs().map(|t| Some(t.iou / t.matched.max(1) as f64))),
            rq: mean(occurs().map(|t| Some(t.matched as f64 / weight(t)))),
        }
    }
}

/// Scores `views` of (true instance ids, predicted object ids), each `[H, W]`, one after the other. Id 0 is not an instance.
/// Pixels whose truth is 0 are left out.
pub fn instance_scores(
    views: impl IntoIterator<Item = (impl AsRef<[u16]>, impl AsRef<[u16]>)>,
) -> InstanceScores {
    let mut pooled = Pairs::default();
    let mut per_view = PanopticQuality::default();
    let one: &dyn Fn(u16) -> u16 = &|_| 0;
    for (truth, prediction) in views {
        let pairs = Pairs::of(truth.as_ref(), prediction.as_ref());
        per_view.count(&pairs, [one, one]);
        pooled.merge(&pairs);
    }
    let mut scene = PanopticQuality::default();
    scene.count(&pooled, [one, one]);
    let areas = pooled.areas();
    let [instances, objects] = areas.each_ref().map(|areas| {
        let ids = areas.keys().copied().filter(|id| *id != VOID);
        ids.collect::<Vec<_>>()
    });
    let all_pairs = instances
        .iter()
        .flat_map(|&t| objects.iter().map(move |&p| (t, p)));
    let values: Vec<i64> = all_pairs.map(|(t, p)| pooled.get(t, p) as i64).collect();
    let mut partners = assignment(&values, objects.len());
    partners.resize(instances.len(), None);
    let partner = |place: Option<usize>| place.map(|place| objects[place]);
    let matched = partners.into_iter().map(partner);
    let pairs: Vec<(u16, Option<u16>)> = instances.iter().copied().zip(matched).collect();
    let right = pairs
        .iter()
        .map(|&(t, p)| p.map_or(0, |p| pooled.get(t, p)));
    let right: u64 = right.sum();
    let all: u64 = instances.iter().map(|id| areas[0][id]).sum();
    InstanceScores {
        accuracy: (all > 0).then(|| right as f64 / all as f64),
        miou: mean(
            pairs
                .iter()
                .map(|&(t, p)| Some(p.map_or(0.0, |p| pooled.iou(t, p, &areas)))),
        ),
        panoptic: per_view.quality(),
        scene: scene.quality(),
        instances: instances.len(),
        objects: objects.len(),
    }
}
