//! Figures of association on trained scenes; nothing here passes or fails.

use crate::support::plate_objects::{associate, rendered};
use crate::support::spoilt_masks::{Noise, spoilt};
use coseg::config::{Association, AssociationConfig};
use coseg::data::{Classes, LabelMap, LabelRuns, Limits, LoadOptions, Scene, Segment, Split, load};
use coseg::metrics::{InstanceScores, instance_scores};
use coseg::objects::Semantics;
use coseg::splat::{Gaussians, ply};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Classes of the test scenes of which there are no instances.
const STUFF: [&str; 3] = ["wall", "floor", "ceiling"];
/// Pixels of each pair of ids.
type Counts = BTreeMap<(u16, u16), usize>;

/// The objects of a case, as the test views show them.
struct Found {
    /// Class table of the objects.
    scene: Scene,
    /// Rendered from a vote, one for each test view.
    maps: Vec<LabelMap>,
}

impl Found {
    /// Associates the raw labels of `scene`, and prints how it went.
    fn new(gaussians: &Gaussians, mut scene: Scene) -> Self {
        let clock = std::time::Instant::now();
        let found =
            associate(gaussians, &scene, &AssociationConfig::default()).expect("association");
        let [groups, segments, divided, dropped] = [
            found.groups.len(),
            found.segments,
            found.divided,
            found.dropped,
        ];
        let seconds = clock.elapsed().as_secs_f64();
        found.apply(&mut scene);
        let own = scene
            .split(Split::Test)
            .map(|view| (ids(&view.instances), ids(&view.raw)));
        let own = instance_scores(own);
        eprintln!(
            "{segments} segments, {groups} groups, {divided} divided, {dropped} dropped, {seconds:.1} s; maps of test views: \
             accuracy {:.4}, mIoU {:.4}",
            own.accuracy.unwrap_or_default(),
            own.miou.unwrap_or_default(),
        );
        Self {
            maps: rendered(gaussians, &scene),
            scene,
        }
    }

    /// Scores of the rendered maps.
    fn scores(&self) -> InstanceScores {
        let views = self.scene.split(Split::Test).zip(&self.maps);
        instance_scores(views.map(|(view, map)| (ids(&view.instances), &map.ids[..])))
    }

    fn print(&self, name: &str) {
        let s = self.scores();
        eprintln!(
            "{name}: rendered accuracy {:.4}, mIoU {:.4}, PQ {:.4} (scene {:.4}), {} instances, {} objects",
            s.accuracy.unwrap_or_default(),
            s.miou.unwrap_or_default(),
            s.panoptic.pq.unwrap_or_default(),
            s.scene.pq.unwrap_or_default(),
            s.instances,
            s.objects
        );
    }

    /// Pixels of each true instance and object in the test views as rendered.
    fn counts(&self) -> Counts {
        let views = self.scene.split(Split::Test).zip(&self.maps);
        counts(views.map(|(view, map)| (ids(&view.instances), map.ids.clone())))
    }
}

fn ids(map: &Option<LabelRuns>) -> Vec<u16> {
    map.as_ref().expect("map").map().ids
}

fn counts(maps: impl Iterator<Item = (Vec<u16>, Vec<u16>)>) -> Counts {
    let mut counts = Counts::new();
    maps.flat_map(|(a, b)| a.into_iter().zip(b))
        .for_each(|pair| *counts.entry(pair).or_default() += 1);
    counts
}

/// The first id that has most pixels of the second id `of`.
fn owner(counts: &Counts, of: u16) -> Option<u16> {
    counts
        .iter()
        .filter(|((_, b), _)| *b == of)
        .max_by_key(|(_, n)| **n)
        .map(|((a, _), _)| *a)
}

/// True ids in all views: what the Gaussians allow.
fn with_true_ids(gaussians: &Gaussians, scene: &Scene) -> Found {
    let mut scene = scene.clone();
    let mut all: Vec<u16> = scene
        .views
        .iter()
        .flat_map(|view| ids(&view.instances))
        .collect();
    all.sort_unstable();
    all.dedup();
    scene.classes = Classes::from_names(0, all.into_iter().map(|id| (id, id.to_string())));
    scene
        .views
        .iter_mut()
        .for_each(|view| view.raw = view.instances.clone());
    Found {
        maps: rendered(gaussians, &scene),
        scene,
    }
}

/// Raw labels of all views, those of training views spoilt.
fn spoil(scene: &mut Scene, noise: Noise) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for view in &mut scene.views {
        let noise = if view.split == Split::Test {
            Noise::default()
        } else {
            noise
        };
        view.raw = Some(
            spoilt(
                &view.instances.as_ref().expect("truth").map(),
                noise,
                &mut rng,
            )
            .into(),
        );
    }
}

/// Segments take the class that most of their pixels have in truth.
fn with_classes(scene: &mut Scene) {
    let stuff = |id: u16| STUFF.contains(&scene.classes.name(id));
    for view in &mut scene.views {
        let counts = counts([(ids(&view.truth), ids(&view.raw))].into_iter());
        let mut segments: Vec<u16> = ids(&view.raw).to_vec();
        segments.sort_unstable();
        segments.dedup();
        let told = |id| {
            owner(&counts, id)
                .filter(|class| *class > 0)
                .map(|class| Segment {
                    id,
                    class: Some(class),
                    thing: !stuff(class),
                })
        };
        view.segments = segments
            .into_iter()
            .filter(|id| *id > 0)
            .filter_map(told)
            .collect();
    }
}

/// Prints of each instance that no rendered object shows most of its pixels of, what became of it.
fn print_missing(found: &Found, limit: &Found) {
    let (rendered, limit) = (found.counts(), limit.counts());
    let train = || found.scene.split(Split::Train);
    let trained = counts(train().map(|view| (ids(&view.instances), ids(&view.raw))));
    let mut instances: Vec<u16> = rendered
        .keys()
        .map(|(t, _)| *t)
        .filter(|t| *t > 0)
        .collect();
    instances.dedup();
    let owned = |counts: &Counts, t: u16| {
        let objects: std::collections::BTreeSet<u16> =
            counts.keys().map(|(_, o)| *o).filter(|o| *o > 0).collect();
        objects.into_iter().find(|o| owner(counts, *o) == Some(t))
    };
    for t in instances
        .into_iter()
        .filter(|&t| owned(&rendered, t).is_none())
    {
        let views: Vec<usize> = train()
            .map(|view| ids(&view.instances).iter().filter(|id| **id == t).count())
            .filter(|n| *n > 0)
            .collect();
        let test: usize = rendered
            .iter()
            .filter(|((a, _), _)| *a == t)
            .map(|(_, n)| n)
            .sum();
        let mut shares: Vec<(usize, u16)> = trained
            .iter()
            .filter(|((a, _), _)| *a == t)
            .map(|((_, o), n)| (*n, *o))
            .collect();
        shares.sort_unstable_by(|a, b| b.cmp(a));
        let reason = match (views.len(), owned(&trained, t), owned(&limit, t)) {
            (0, ..) => "in no training view".to_owned(),
            (_, Some(object), Some(_)) => format!("object {object} in the maps, lost in the vote"),
            (_, Some(object), None) => {
                format!("object {object} in the maps, lost in the vote; so with true ids")
            }
            (_, None, limit) => {
                let into = shares
                    .iter()
                    .find(|(_, o)| *o > 0)
                    .and_then(|(_, o)| owner(&trained, *o));
                let also = if limit.is_none() {
                    "; lost with true ids too"
                } else {
                    ""
                };
                match shares.first() {
                    Some((_, 0)) => {
                        format!(
                            "most of its pixels without an object, then joined with instance {into:?}{also}"
                        )
                    }
                    _ => format!("joined with instance {into:?}{also}"),
                }
            }
        };
        eprintln!(
            "  instance {t}: {} training views, {} pixels in the largest, {} in all, {test} in test views; {reason}; {:?}",
            views.len(),
            views.iter().max().copied().unwrap_or_default(),
            views.iter().sum::<usize>(),
            &shares[..shares.len().min(4)],
        );
    }
}

/// Figures for a trained scene whose folder has `instances_gt`: `COSEG_SCENE_PLY` names the Gaussians and
/// `COSEG_SCENE_DIR` the folder; `COSEG_CASES` some of the cases, all without it.
#[test]
#[ignore = "needs trained Gaussians and minutes; prints figures"]
fn measure_a_trained_scene() {
    let path = |key| {
        std::env::var_os(key)
            .map(PathBuf::from)
            .expect("COSEG_SCENE_PLY and COSEG_SCENE_DIR")
    };
    let trained = ply::read(&path("COSEG_SCENE_PLY"), &Limits::default()).expect("Gaussians");
    let gaussians = &trained.gaussians;
    let options = LoadOptions {
        raw_labels: Some("instances_gt".into()),
        association: Association::Gaussians,
        ..LoadOptions::default()
    };
    let mut scene = load(&path("COSEG_SCENE_DIR"), &options).expect("scene");
    for view in &mut scene.views {
        view.camera.center += scene.origin - trained.origin;
        view.instances = view.raw.take();
    }
    let clean = Noise::default();
    let cases = [
        ("clean", clean),
        (
            "split 30 %",
            Noise {
                split: 0.3,
                ..clean
            },
        ),
        (
            "merge 15 %",
            Noise {
                merge: 0.15,
                ..clean
            },
        ),
        ("erode 2 px", Noise { erode: 2, ..clean }),
        ("drop 30 %", Noise { drop: 0.3, ..clean }),
        (
            "all",
            Noise {
                split: 0.3,
                merge: 0.15,
                erode: 2,
                drop: 0.3,
            },
        ),
    ];
    let wanted = std::env::var("COSEG_CASES").unwrap_or_default();
    let wanted = |name: &str| wanted.is_empty() || wanted.split(',').any(|w| name.starts_with(w));
    let limit = with_true_ids(gaussians, &scene);
    limit.print("true ids");
    for (name, noise) in cases.into_iter().filter(|(name, _)| wanted(name)) {
        let mut scene = scene.clone();
        spoil(&mut scene, noise);
        let found = Found::new(gaussians, scene);
        found.print(name);
        if name == "clean" {
            print_missing(&found, &limit);
        }
    }
    if !wanted("classes") {
        return;
    }
    for (name, noise) in [("classes, clean", clean), ("classes, all", cases[5].1)] {
        let mut scene = scene.clone();
        spoil(&mut scene, noise);
        with_classes(&mut scene);
        let semantics = Semantics::of(&scene).expect("classes");
        let found = Found::new(gaussians, scene);
        found.print(name);
        let maps = found
            .scene
            .split(Split::Test)
            .zip(found.maps.iter().cloned().map(LabelRuns::from));
        let maps: Vec<_> = maps.collect();
        let scores = semantics.score(&found.scene.classes, &maps);
        let quality = scores.panoptic.expect("instances");
        eprintln!(
            "{name}: semantic mIoU {:.4} ({:.4} per view), accuracy {:.4}; PQ {:.4}, of things {:.4}, of stuff {:.4}, scene {:.4}",
            scores.miou.unwrap_or_default(),
            scores.miou_per_view.unwrap_or_default(),
            scores.accuracy.unwrap_or_default(),
            quality.all.pq.unwrap_or_default(),
            quality.things.pq.unwrap_or_default(),
            quality.stuff.pq.unwrap_or_default(),
            quality.scene.pq.unwrap_or_default(),
        );
    }
}
