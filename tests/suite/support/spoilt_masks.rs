//! Instance maps as a segmenter might give them: ids of each view's own, and masks that are cut, swollen, eroded or missing.

use coseg::data::LabelMap;
use rand::{Rng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, HashMap};

/// The map under other ids, 1 to 60,000, 0 where it is 0.
pub fn shuffled(map: &LabelMap, rng: &mut ChaCha8Rng) -> LabelMap {
    let mut table: HashMap<u16, u16> = HashMap::from([(0, 0)]);
    let mut ids: Vec<u16> = (1..60_000).collect();
    ids.shuffle(rng);
    for &id in &map.ids {
        table
            .entry(id)
            .or_insert_with(|| ids.pop().expect("enough ids"));
    }
    LabelMap {
        ids: map.ids.iter().map(|id| table[id]).collect(),
        ..*map
    }
}

/// How masks go wrong.
#[derive(Clone, Copy, Debug, Default)]
pub struct Noise {
    /// Share of the larger segments that are cut in two by a line.
    pub split: f64,
    /// Share of the segments that swallow a neighbour.
    pub merge: f64,
    /// Pixels lost at each border.
    pub erode: usize,
    /// Share of the segments that are missing.
    pub drop: f64,
}

/// The map as a poor segmenter might give it, under ids of its own.
pub fn spoilt(truth: &LabelMap, noise: Noise, rng: &mut ChaCha8Rng) -> LabelMap {
    let (w, h) = (truth.width, truth.height);
    let mut ids: Vec<u32> = truth.ids.iter().map(|&id| u32::from(id)).collect();
    let mut areas: BTreeMap<u32, usize> = BTreeMap::new();
    ids.iter()
        .for_each(|id| *areas.entry(*id).or_default() += 1);
    areas.remove(&0);
    let all: Vec<u32> = areas.keys().copied().collect();
    for &id in &all {
        if rng.random_bool(noise.merge) {
            // The neighbour across most of the border on the right.
            let mut across: BTreeMap<u32, usize> = BTreeMap::new();
            for p in (0..w * h - 1).filter(|p| {
                (p + 1) % w != 0 && ids[*p] == id && ids[p + 1] != id && ids[p + 1] != 0
            }) {
                *across.entry(ids[p + 1]).or_default() += 1;
            }
            if let Some((&other, _)) = across.iter().max_by_key(|(_, n)| **n) {
                ids.iter_mut()
                    .filter(|v| **v == other)
                    .for_each(|v| *v = id);
            }
        }
        if areas[&id] > 2_000 && rng.random_bool(noise.split) {
            let angle: f64 = rng.random_range(0.0..std::f64::consts::PI);
            let inside: Vec<usize> = (0..w * h).filter(|&p| ids[p] == id).collect();
            let along = |p: usize| (p % w) as f64 * angle.cos() + (p / w) as f64 * angle.sin();
            let mut places: Vec<f64> = inside.iter().map(|&p| along(p)).collect();
            places.sort_by(f64::total_cmp);
            let cut = places
                .get(places.len() * rng.random_range(30..71) / 100)
                .copied()
                .unwrap_or(0.0);
            inside
                .iter()
                .filter(|&&p| along(p) > cut)
                .for_each(|&p| ids[p] = id + 100_000);
        }
    }
    let whole = ids.clone();
    let reach = noise.erode as isize;
    for p in 0..w * h {
        let (x, y) = ((p % w) as isize, (p / w) as isize);
        let mut around =
            (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (x + dx, y + dy)));
        let other = |(x, y): (isize, isize)| {
            x >= 0
                && y >= 0
                && x < w as isize
                && y < h as isize
                && whole[y as usize * w + x as usize] != whole[p]
        };
        if around.any(other) {
            ids[p] = 0;
        }
    }
    let mut table: BTreeMap<u32, u16> = ids.iter().map(|&id| (id, 0)).collect();
    let mut next = 0;
    for (id, to) in &mut table {
        if *id != 0 && !rng.random_bool(noise.drop) {
            next += 1;
            *to = next;
        }
    }
    let map = LabelMap {
        width: w,
        height: h,
        ids: ids.iter().map(|id| table[id]).collect(),
    };
    shuffled(&map, rng)
}
