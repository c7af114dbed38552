//! Simulated raw labels, with the errors of a 2D segmenter that sees one photo at a time.

use super::noise::noise;
use crate::data::LabelMap;
use crate::random::standard_normal;
use glam::DVec2;
use rand::Rng;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// How labels are corrupted. Probabilities hold for an object of average difficulty at `strength` 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Corruption {
    /// Multiplies every probability below, and the warp.
    pub strength: f64,
    /// Share of views in which an object is wrong as part of a run of neighbouring views.
    pub run_share: f64,
    /// Mean length of such a run, views.
    pub run_length: f64,
    /// A segment takes a wrong class in one view.
    pub swap: f64,
    /// A segment takes the class of the neighbour with the longest shared border. Small segments do so three times as often.
    pub merge: f64,
    /// A segment is cut by a line and its smaller part mislabelled or void.
    pub split: f64,
    /// A segment becomes void; small ones four times as often.
    pub drop: f64,
    /// Size of the boundary warp, pixels of a 320 pixel wide image.
    pub warp: f64,
    /// Share of borders along which pixels are void.
    pub void_borders: f64,
    /// For each class the classes it is mistaken for; classes not listed take any other class of the scene.
    pub confusions: Vec<(u16, Vec<u16>)>,
    /// Id of unlabelled pixels.
    pub ignore: u16,
}

impl Default for Corruption {
    /// Calibrated on the built-in scene; confusions are those of its classes.
    fn default() -> Self {
        use super::build::class::*;
        let confusions = [
            (WALL, [CEILING, CABINET, WINDOW]),
            (FLOOR, [TABLE, WALL, SOFA]),
            (CEILING, [WALL, WINDOW, LAMP]),
            (WINDOW, [PICTURE, WALL, CABINET]),
            (PICTURE, [WINDOW, WALL, CABINET]),
            (TABLE, [CABINET, CHAIR, FLOOR]),
            (CHAIR, [SOFA, TABLE, CABINET]),
            (SOFA, [CHAIR, TABLE, FLOOR]),
            (CABINET, [TABLE, WALL, SOFA]),
            (LAMP, [CHAIR, PICTURE, WALL]),
        ];
        Self {
            strength: 1.0,
            run_share: 0.2,
            run_length: 8.0,
            swap: 0.05,
            merge: 0.03,
            split: 0.08,
            drop: 0.02,
            warp: 2.5,
            void_borders: 0.3,
            confusions: confusions
                .map(|(class, others)| (class, others.into()))
                .into(),
            ignore: 0,
        }
    }
}

/// Corrupts the true `labels` of views in walking order (neighbours in the list are neighbours in space); `instances`
/// are the object ids of the same pixels. Returns maps of the same sizes, the same for the same seed at any thread
/// count.
///
/// The model, in the order it is applied:
/// 1. *Objects.* Each object has a difficulty (log-normal, mean 1, at most 3), lower for those that fill much of a
///    view. A two-state chain along the views puts it in and out of runs in which it has one wrong class; its
///    stationary share is `run_share` x difficulty (at most 0.8), its mean run `run_length` views. Two runs in three
///    of one object take the same wrong class, so some objects are wrong in the same way in most views.
/// 2. *Segments.* Each view has a quality (0.6-1.4). Every connected piece of an object not in a run may swap its
///    class, merge into its neighbour, be dropped to void, or be split, independently of other views.
/// 3. *Borders.* The map is resampled through a smooth random displacement, then parts of the borders become void.
pub fn corrupt(
    labels: &[LabelMap],
    instances: &[&[u16]],
    params: &Corruption,
    seed: u64,
) -> Vec<LabelMap> {
    let objects = Objects::draw(labels, instances, params, seed);
    labels
        .par_iter()
        .zip(instances)
        .enumerate()
        .map(|(i, (map, ids))| {
            let mut rng = fork(seed, 2, i as u64);
            let mut out = corrupt_segments(map, ids, i, &objects, params, &mut rng);
            warp(&mut out, params.warp * params.strength, &mut rng);
            void_borders(&mut out, params, &mut rng);
            out
        })
        .collect()
}

fn fork(seed: u64, purpose: u64, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(purpose << 48 | index);
    rng
}

/// Properties of objects that hold in all views.
struct Objects {
    /// Difficulty by instance.
    difficulty: BTreeMap<u16, f64>,
    /// Wrong class by (instance, class) and view.
    runs: BTreeMap<(u16, u16), Vec<Option<u16>>>,
    /// The classes that each class is mistaken for.
    wrong: BTreeMap<u16, Vec<u16>>,
}

impl Objects {
    fn draw(labels: &[LabelMap], instances: &[&[u16]], params: &Corruption, seed: u64) -> Self {
        let largest = largest_shares(labels, instances, params.ignore);
        let classes: BTreeSet<u16> = largest.keys().map(|(_, class)| *class).collect();
        let mistaken_for = |class: u16| {
            let listed = params.confusions.iter().find(|(of, _)| *of == class);
            let all = || classes.iter().copied().collect();
            let mut others: Vec<u16> = listed.map_or_else(all, |(_, others)| others.clone());
            others.retain(|&other| other != class && other != params.ignore);
            (class, others)
        };
        let wrong: BTreeMap<u16, Vec<u16>> = classes.iter().copied().map(mistaken_for).collect();
        let mut difficulty = BTreeMap::new();
        let mut runs = BTreeMap::new();
        for (&(id, class), share) in &largest {
            let rng = &mut fork(seed, 1, u64::from(id) << 16 | u64::from(class));
            let spread = 0.7;
            let normal = standard_normal(rng);
            let hard = (spread * normal - spread * spread / 2.0).exp().min(3.0);
            let hard = hard / (1.0 + 4.0 * share);
            difficulty.insert(id, hard);
            let views = run(labels.len(), hard, &wrong[&class], params, rng);
            runs.insert((id, class), views);
        }
        Self {
            difficulty,
            runs,
            wrong,
        }
    }
}

/// Largest share of a view that each (instance, class) fills.
fn largest_shares(
    labels: &[LabelMap],
    instances: &[&[u16]],
    ignore: u16,
) -> BTreeMap<(u16, u16), f64> {
    let mut largest = BTreeMap::new();
    for (map, ids) in labels.iter().zip(instances) {
        let mut area: BTreeMap<(u16, u16), usize> = BTreeMap::new();
        let pixels = map.ids.iter().zip(*ids);
        for (&class, &id) in pixels.filter(|(class, _)| **class != ignore) {
            *area.entry((id, class)).or_default() += 1;
        }
        for (key, n) in area {
            let share: &mut f64 = largest.entry(key).or_default();
            *share = share.max(n as f64 / map.ids.len() as f64);
        }
    }
    largest
}

/// The wrong class of an object in each view, from a two-state Markov chain.
fn run(
    views: usize,
    hard: f64,
    wrong: &[u16],
    params: &Corruption,
    rng: &mut ChaCha8Rng,
) -> Vec<Option<u16>> {
    let p = (params.strength * params.run_share * hard).min(0.8);
    let leave = 1.0 / params.run_length.max(1.0);
    let enter = leave * p / (1.0 - p);
    let favourite = pick(wrong, rng);
    let mut now = None;
    let states = (0..views).map(|i| {
        let inside = match now {
            _ if i == 0 => rng.random::<f64>() < p,
            Some(_) => rng.random::<f64>() >= leave,
            None => rng.random::<f64>() < enter,
        };
        now = match now {
            _ if !inside => None,
            Some(class) => Some(class),
            None if rng.random_bool(0.67) => favourite,
            None => pick(wrong, rng),
        };
        now
    });
    states.collect()
}

fn pick(from: &[u16], rng: &mut ChaCha8Rng) -> Option<u16> {
    (!from.is_empty()).then(|| from[rng.random_range(0..from.len())])
}

/// A connected piece of one object.
struct Segment {
    pixels: Vec<usize>,
    id: u16,
    class: u16,
    /// Class across the longest shared border.
    neighbour: Option<u16>,
}

/// Segments of a view.
fn segments(map: &LabelMap, ids: &[u16], ignore: u16) -> Vec<Segment> {
    let key = |i: usize| (ids[i], map.ids[i]);
    let regions = map.regions(|a, b| key(a) == key(b)).into_iter();
    let labelled = regions.filter(|pixels| map.ids[pixels[0]] != ignore);
    let segment = |pixels: Vec<usize>| {
        let (id, class) = key(pixels[0]);
        let mut border: BTreeMap<u16, usize> = BTreeMap::new();
        for other in pixels.iter().flat_map(|&i| map.beside(i)) {
            let other = map.ids[other];
            if other != class && other != ignore {
                *border.entry(other).or_default() += 1;
            }
        }
        let neighbour = border.into_iter().max_by_key(|&(c, n)| (n, c)).map(|b| b.0);
        Segment {
            pixels,
            id,
            class,
            neighbour,
        }
    };
    labelled.map(segment).collect()
}

fn corrupt_segments(
    map: &LabelMap,
    ids: &[u16],
    view: usize,
    objects: &Objects,
    params: &Corruption,
    rng: &mut ChaCha8Rng,
) -> LabelMap {
    let mut out = map.clone();
    let rate = params.strength * rng.random_range(0.6..1.4);
    for segment in segments(map, ids, params.ignore) {
        let Segment {
            pixels,
            id,
            class,
            neighbour,
        } = segment;
        let share = pixels.len() as f64 / map.ids.len() as f64;
        let hard = objects.difficulty.get(&id).copied().unwrap_or(1.0);
        let small = share < 0.02;
        let tiny = share < 0.006;
        let mut paint = |part: &[usize], c: u16| part.iter().for_each(|&i| out.ids[i] = c);
        // Always the same number of draws, so that one outcome does not shift the next segment's.
        let [swap, merge, drop, split, fate] = [(); 5].map(|()| rng.random::<f64>());
        let wrong = pick(&objects.wrong[&class], rng);
        let run = objects.runs.get(&(id, class)).and_then(|r| r[view]);
        if let Some(c) = run {
            paint(&pixels, c);
        } else if drop < rate * params.drop * if tiny { 4.0 } else { 1.0 } {
            paint(&pixels, params.ignore);
        } else if swap < rate * params.swap * hard {
            wrong.into_iter().for_each(|c| paint(&pixels, c));
        } else if merge < rate * params.merge * if small { 3.0 } else { 1.0 } {
            neighbour.into_iter().for_each(|c| paint(&pixels, c));
        } else if share > 0.01 && split < rate * params.split {
            let through = pixels[rng.random_range(0..pixels.len())];
            let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
            let place = |i: usize| DVec2::new((i % map.width) as f64, (i / map.width) as f64);
            let side = |&i: &usize| {
                let offset = place(i) - place(through);
                offset.x * cos + offset.y * sin > 0.0
            };
            let (mut part, rest): (Vec<_>, Vec<_>) = pixels.iter().partition(|i| side(i));
            if part.len() > rest.len() {
                part = rest;
            }
            let class = match fate {
                f if f < 0.35 => Some(params.ignore),
                f if f < 0.7 => neighbour,
                _ => wrong,
            };
            class.into_iter().for_each(|c| paint(&part, c));
        }
    }
    out
}

/// Resamples the map through a smooth displacement of about `size` pixels (of a 320 pixel wide image).
fn warp(map: &mut LabelMap, size: f64, rng: &mut ChaCha8Rng) {
    let (w, h) = (map.width, map.height);
    let scale = w as f64 / 320.0;
    let cell = 18.0 * scale;
    let seeds: [u64; 2] = [rng.random(), rng.random()];
    let old = map.ids.clone();
    for (i, id) in map.ids.iter_mut().enumerate() {
        let (x, y) = ((i % w) as f64, (i / w) as f64);
        // Uniform noise has a standard deviation of about 0.2 after smoothing.
        let [dx, dy] = seeds.map(|s| (noise(x / cell, y / cell, s) - 0.5) / 0.2 * size * scale);
        let u = (x + dx).round().clamp(0.0, (w - 1) as f64) as usize;
        let v = (y + dy).round().clamp(0.0, (h - 1) as f64) as usize;
        *id = old[v * w + u];
    }
}

/// Makes pixels at label borders void where a smooth gate is open.
fn void_borders(map: &mut LabelMap, params: &Corruption, rng: &mut ChaCha8Rng) {
    if params.void_borders * params.strength <= 0.0 {
        return;
    }
    let (w, h) = (map.width, map.height);
    let reach = ((w as f64 / 320.0).round() as usize).max(1);
    let cell = 26.0 * w as f64 / 320.0;
    let seed: u64 = rng.random();
    let old = map.ids.clone();
    for y in 0..h {
        for x in 0..w {
            let i = y * w + x;
            let differs = |x: usize, y: usize| old[y * w + x] != old[i];
            let border = differs(x.saturating_sub(reach), y)
                || differs((x + reach).min(w - 1), y)
                || differs(x, y.saturating_sub(reach))
                || differs(x, (y + reach).min(h - 1));
            // Smoothed noise is bell-shaped about one half; this puts about `void_borders` of it below the gate.
            let gate = 0.5 + 0.42 * (params.void_borders * params.strength.min(1.0) - 0.5);
            if border && noise(x as f64 / cell, y as f64 / cell, seed) < gate {
                map.ids[i] = params.ignore;
            }
        }
    }
}
