//! Association: segments with ids of their own in every view become objects.

use crate::cli::{fails, read_json, succeeds, utf8};
use crate::plates::{self, camera, plates};
use coseg::config::{Association, AssociationConfig};
use coseg::data::{Classes, LabelMap, LabelRuns, Limits, LoadOptions, Scene, Segment, Split, View, load};
use coseg::gaussians::{Gaussians, ply};
use coseg::metrics::{InstanceScores, instance_scores};
use coseg::objects::{self, LabelRule, associate, hard_label_map, label_map, vote};
use coseg::raster::{Projected, Settings};
use rand::{Rng, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};

/// Six views of the plates with exact instances; raw labels are the same under ids drawn anew in each view.
fn plate_scene() -> (Gaussians, Scene) {
    let folder = tempfile::tempdir().expect("folder");
    plates::scene(folder.path());
    let (gaussians, labels) = plates();
    let mut scene = load(folder.path(), &LoadOptions::default()).expect("scene");
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (i, view) in scene.views.iter_mut().enumerate() {
        view.camera = camera(i);
        let projected = Projected::new(&gaussians.splats(), &view.camera, &Settings::default()).expect("view");
        let truth = hard_label_map(&projected, &labels, 0.5);
        view.raw = Some(shuffled(&truth, &mut rng).into());
        view.instances = Some(truth.into());
    }
    (gaussians, scene)
}

/// The map under other ids, 1 to 60,000, 0 where it is 0.
fn shuffled(map: &LabelMap, rng: &mut ChaCha8Rng) -> LabelMap {
    let mut table: HashMap<u16, u16> = HashMap::from([(0, 0)]);
    let mut ids: Vec<u16> = (1..60_000).collect();
    ids.shuffle(rng);
    for &id in &map.ids {
        table.entry(id).or_insert_with(|| ids.pop().expect("enough ids"));
    }
    LabelMap { ids: map.ids.iter().map(|id| table[id]).collect(), ..*map }
}

fn found(gaussians: &Gaussians, scene: &Scene) -> objects::Association {
    associate(gaussians, scene, &AssociationConfig::default(), &Settings::default()).expect("association")
}

/// The map, which is there.
fn map(runs: &Option<LabelRuns>) -> LabelMap {
    runs.as_ref().expect("map").map()
}

/// Scores of the maps of both splits against the instances.
fn map_scores(scene: &Scene, maps: &[Option<LabelRuns>]) -> InstanceScores {
    let pairs = scene.views.iter().zip(maps);
    instance_scores(pairs.map(|(v, m)| (map(&v.instances), map(m))))
}

#[test]
fn shuffled_ids_become_objects() {
    let (gaussians, mut scene) = plate_scene();
    let association = found(&gaussians, &scene);
    let scores = map_scores(&scene, &association.maps);
    assert_eq!((scores.accuracy, scores.miou, scores.scene.pq), (Some(1.0), Some(1.0), Some(1.0)));
    assert_eq!((association.groups.len(), association.dropped, association.segments), (4, 0, 16));
    let names: Vec<&str> = association.classes.entries.iter().map(|c| &*c.name).collect();
    assert_eq!(names, ["object 1", "object 2", "object 3", "object 4"]);
    assert!(association.groups.windows(2).all(|g| g[0].weight >= g[1].weight), "largest first");
    assert!(association.groups.iter().all(|g| g.views == 4 && g.class.is_none()));
    association.apply(&mut scene);
    assert!(scene.views.iter().all(|v| v.truth.is_none() && v.raw.is_some()));
    assert_eq!(scene.classes.len(), 4);
}

#[test]
fn the_order_of_views_and_the_number_of_threads_change_nothing() {
    let (gaussians, mut scene) = plate_scene();
    let first = found(&gaussians, &scene);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        assert_eq!(pool.install(|| found(&gaussians, &scene)), first, "{threads} threads");
    }
    scene.views.reverse();
    let mut reversed = found(&gaussians, &scene);
    reversed.maps.reverse();
    assert_eq!(reversed.maps, first.maps);
}

#[test]
fn no_object_has_two_classes_and_stuff_is_one_object() {
    let (gaussians, mut scene) = plate_scene();
    // The wall is stuff, in two pieces; the plates are chairs, but the first view takes one for a table.
    for (i, view) in scene.views.iter_mut().enumerate() {
        let truth = map(&view.instances);
        let split = |(p, &id): (usize, &u16)| if id == 4 && p % truth.width < 40 { 5 } else { id };
        let ids: Vec<u16> = truth.ids.iter().enumerate().map(split).collect();
        view.raw = Some(LabelMap { ids, ..truth }.into());
        let class = |id: u16| {
            if id > 3 {
                4
            } else if i == 0 && id == 2 {
                3
            } else {
                2
            }
        };
        view.segments = (1..6).map(|id| Segment { id, class: Some(class(id)), thing: id < 4 }).collect();
    }
    let association = found(&gaussians, &scene);
    let wall: Vec<_> = association.groups.iter().filter(|g| g.class == Some(4)).collect();
    assert_eq!(wall.len(), 1);
    // Names are those of the scene's classes.
    assert_eq!(association.classes.name(wall[0].id), "wall");
    let chairs = association.groups.iter().filter(|g| g.class == Some(2)).count();
    assert_eq!(chairs, 3, "{:?}", association.classes);
    assert!(association.classes.entries.iter().any(|c| c.name == "green 2"));
    let found = map(&association.maps[0]);
    let other: Vec<u16> = association.groups.iter().filter(|g| g.class == Some(3)).map(|g| g.id).collect();
    let truth = map(&scene.views[0].instances);
    assert!(found.ids.iter().zip(&truth.ids).all(|(found, t)| *t == 2 || !other.contains(found)));
}

#[test]
fn nothing_to_put_together_is_an_error() {
    let (gaussians, mut scene) = plate_scene();
    scene.views.iter_mut().for_each(|view| view.raw = None);
    let error = associate(&gaussians, &scene, &AssociationConfig::default(), &Settings::default()).expect_err("empty");
    crate::assert_names(&error, &["data.association", "no segments", "add raw labels"]);
    // Maps without Gaussians: nothing belongs together.
    let (_, scene) = plate_scene();
    let none = Gaussians {
        means: vec![],
        log_scales: vec![],
        rotations: vec![],
        opacity_logits: vec![],
        sh: vec![],
        sh_degree: 0,
    };
    let association = found(&none, &scene);
    assert_eq!((association.groups.len(), association.dropped), (0, association.segments));
}

/// How masks go wrong.
#[derive(Clone, Copy, Debug, Default)]
struct Noise {
    /// Share of the larger segments that are cut in two by a line.
    split: f64,
    /// Share of the segments that swallow a neighbour.
    merge: f64,
    /// Pixels lost at each border.
    erode: usize,
    /// Share of the segments that are missing.
    drop: f64,
}

fn spoilt(truth: &LabelMap, noise: Noise, rng: &mut ChaCha8Rng) -> LabelMap {
    let (w, h) = (truth.width, truth.height);
    let mut ids: Vec<u32> = truth.ids.iter().map(|&id| u32::from(id)).collect();
    let mut areas: BTreeMap<u32, usize> = BTreeMap::new();
    ids.iter().for_each(|id| *areas.entry(*id).or_default() += 1);
    areas.remove(&0);
    let all: Vec<u32> = areas.keys().copied().collect();
    for &id in &all {
        if rng.random_bool(noise.merge) {
            // The neighbour across most of the border on the right.
            let mut across: BTreeMap<u32, usize> = BTreeMap::new();
            for p in (0..w * h - 1).filter(|p| (p + 1) % w != 0 && ids[*p] == id && ids[p + 1] != id && ids[p + 1] != 0)
            {
                *across.entry(ids[p + 1]).or_default() += 1;
            }
            if let Some((&other, _)) = across.iter().max_by_key(|(_, n)| **n) {
                ids.iter_mut().filter(|v| **v == other).for_each(|v| *v = id);
            }
        }
        if areas[&id] > 2_000 && rng.random_bool(noise.split) {
            let angle: f64 = rng.random_range(0.0..std::f64::consts::PI);
            let inside: Vec<usize> = (0..w * h).filter(|&p| ids[p] == id).collect();
            let along = |p: usize| (p % w) as f64 * angle.cos() + (p / w) as f64 * angle.sin();
            let mut places: Vec<f64> = inside.iter().map(|&p| along(p)).collect();
            places.sort_by(f64::total_cmp);
            let cut = places.get(places.len() * rng.random_range(30..71) / 100).copied().unwrap_or(0.0);
            inside.iter().filter(|&&p| along(p) > cut).for_each(|&p| ids[p] = id + 100_000);
        }
    }
    let whole = ids.clone();
    let reach = noise.erode as isize;
    for p in 0..w * h {
        let (x, y) = ((p % w) as isize, (p / w) as isize);
        let mut around = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (x + dx, y + dy)));
        let other = |(x, y): (isize, isize)| {
            x >= 0 && y >= 0 && x < w as isize && y < h as isize && whole[y as usize * w + x as usize] != whole[p]
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
    let map = LabelMap { width: w, height: h, ids: ids.iter().map(|id| table[id]).collect() };
    shuffled(&map, rng)
}

#[test]
fn noise_of_single_views_is_outvoted() {
    let (gaussians, mut scene) = plate_scene();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for view in &mut scene.views {
        let noise = Noise { split: 0.3, merge: 0.1, erode: 1, drop: 0.2 };
        view.raw = Some(spoilt(&map(&view.instances), noise, &mut rng).into());
    }
    let scores = rendered_scores(&gaussians, &mut scene, &AssociationConfig::default());
    assert_eq!(scores.instances, 4);
    assert!(scores.accuracy > Some(0.95) && scores.miou > Some(0.85), "{scores:?}");
}

/// Scores of the objects as rendered in the test views.
fn rendered_scores(gaussians: &Gaussians, scene: &mut Scene, config: &AssociationConfig) -> InstanceScores {
    let settings = Settings::default();
    let clock = std::time::Instant::now();
    let association = associate(gaussians, scene, config, &settings).expect("association");
    let (groups, segments, dropped) = (association.groups.len(), association.segments, association.dropped);
    let seconds = clock.elapsed().as_secs_f64();
    association.apply(scene);
    let own = instance_scores(scene.split(Split::Test).map(|view| (map(&view.instances), map(&view.raw))));
    eprintln!(
        "{segments} segments, {groups} groups, {dropped} dropped, {seconds:.1} s; maps of test views: accuracy {:.4}, mIoU {:.4}",
        own.accuracy.unwrap_or_default(),
        own.miou.unwrap_or_default(),
    );
    rendered(gaussians, scene)
}

/// Scores of what a vote of the raw labels of the training views shows in the test views.
fn rendered(gaussians: &Gaussians, scene: &Scene) -> InstanceScores {
    let settings = Settings::default();
    let votes = vote(gaussians, scene.split(Split::Train), &scene.classes, &settings).expect("votes").identities();
    let rule = LabelRule { source: coseg::config::LabelSource::Labels, min_coverage: 0.5 };
    let render = |view: &View| {
        let projected = Projected::new(&gaussians.splats(), &view.camera, &settings).expect("view");
        (map(&view.instances), label_map(&projected, &votes, &scene.classes, &rule))
    };
    instance_scores(scene.split(Split::Test).map(render))
}

/// Figures for a trained scene whose folder has `instances_gt`: `COSEG_SCENE_PLY` names the Gaussians and
/// `COSEG_SCENE_DIR` the folder.
#[test]
#[ignore = "needs trained Gaussians and minutes; prints figures"]
fn measure_a_trained_scene() {
    let path = |key| std::env::var_os(key).map(PathBuf::from).expect("COSEG_SCENE_PLY and COSEG_SCENE_DIR");
    let trained = ply::read(&path("COSEG_SCENE_PLY"), &Limits::default()).expect("Gaussians");
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
        ("split 30 %", Noise { split: 0.3, ..clean }),
        ("merge 15 %", Noise { merge: 0.15, ..clean }),
        ("erode 2 px", Noise { erode: 2, ..clean }),
        ("drop 30 %", Noise { drop: 0.3, ..clean }),
        ("all", Noise { split: 0.3, merge: 0.15, erode: 2, drop: 0.3 }),
    ];
    // What true ids give: the limit of these Gaussians.
    let mut oracle = scene.clone();
    let mut classes: Vec<u16> = oracle.views.iter().flat_map(|v| map(&v.instances).ids).collect();
    classes.sort_unstable();
    classes.dedup();
    oracle.classes = Classes::from_names(0, classes.into_iter().map(|id| (id, id.to_string())));
    oracle.views.iter_mut().for_each(|view| view.raw = view.instances.clone());
    print("true ids", &rendered(&trained.gaussians, &oracle));
    for (name, noise) in cases {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut scene = scene.clone();
        for view in &mut scene.views {
            let noise = if view.split == Split::Test { clean } else { noise };
            view.raw = Some(spoilt(&map(&view.instances), noise, &mut rng).into());
        }
        let s = rendered_scores(&trained.gaussians, &mut scene, &AssociationConfig::default());
        print(name, &s);
    }
}

fn print(name: &str, s: &InstanceScores) {
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

/// The plates with raw labels under shuffled ids, and true instances.
fn plate_folder(dir: &Path) {
    plates::scene(dir);
    let mut value = read_json(&dir.join("transforms.json"));
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for frame in value["frames"].as_array_mut().expect("frames") {
        frame["instance_path"] = frame["label_path"].take();
        frame.as_object_mut().expect("frame").remove("label_path");
        let truth = LabelMap::read(&dir.join(frame["instance_path"].as_str().expect("path")), &Limits::default());
        let raw = dir.join(frame["raw_label_path"].as_str().expect("path"));
        shuffled(&truth.expect("truth"), &mut rng).write(&raw).expect("raw labels");
    }
    fs::write(dir.join("transforms.json"), value.to_string()).expect("write");
    fs::remove_file(dir.join("classes.json")).expect("remove");
}

#[test]
fn associate_writes_maps_of_global_ids() {
    let folder = tempfile::tempdir().expect("folder");
    let dir = folder.path();
    plate_folder(dir);
    let (ply, out) = (dir.join("plates.ply"), dir.join("out"));
    let arguments = ["associate", "--scene", utf8(&ply), "--data", utf8(dir), "--out", utf8(&out)];
    let said = succeeds(&arguments);
    assert!(said.contains("16 segments of training views: 4 objects, 0 segments of none"), "{said}");
    assert!(said.contains("held-out views, maps: accuracy 1.0000, mIoU 1.0000, PQ 1.0000"), "{said}");
    assert!(said.contains("held-out views, rendered: accuracy 1.0000"), "{said}");
    let classes = Classes::read(&out.join("classes.json")).expect("classes");
    assert_eq!((classes.len(), classes.name(4)), (4, "object 4"));
    let bytes = fs::read(out.join("labels/v2.png")).expect("map");
    assert_eq!(bytes[24..26], [16, 0], "16-bit grey");
    let labels = ply::read(&out.join("scene.ply"), &Limits::default()).expect("scene").labels.expect("labels");
    let (_, truth) = plates();
    let pairs: BTreeSet<(u16, u16)> = labels.iter().copied().zip(truth).filter(|(found, _)| *found > 0).collect();
    assert_eq!(pairs.len(), 4, "{pairs:?}");
    // The ids mean the same in all views.
    let mut pairs = BTreeSet::new();
    for i in 0..6 {
        let map = LabelMap::read(&out.join(format!("labels/v{i}.png")), &Limits::default()).expect("map");
        let truth = LabelMap::read(&dir.join(format!("labels/v{i}.png")), &Limits::default()).expect("truth");
        pairs.extend(map.ids.into_iter().zip(truth.ids));
    }
    assert_eq!(pairs.iter().filter(|(found, _)| *found > 0).count(), 4, "{pairs:?}");
    let message = fails(&[&arguments[..], &["--set", "association.min_overlap=0"]].concat(), 1);
    assert!(message.contains("association.min_overlap") && message.contains("above 0"), "{message}");
    let message = fails(&[&arguments[..], &["--set", "data.association=tracks"]].concat(), 1);
    assert!(message.contains("\"none\"") && message.contains("\"gaussians\""), "{message}");
}

#[test]
fn a_run_trains_on_objects_and_scores_them() {
    let folder = tempfile::tempdir().expect("folder");
    let dir = folder.path();
    plate_folder(dir);
    let run = dir.join("run");
    let sets = [
        "data.association=gaussians",
        "building.iterations=60",
        "building.random_points=400",
        "segmentation.iterations=20",
        "segmentation.rows=raw,vote,per_gaussian",
    ];
    let sets: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
    let said = succeeds(&[&["train", "--data", utf8(dir), "--out", utf8(&run)][..], &sets].concat());
    assert!(said.contains("16 segments put together into"), "{said}");
    let metrics = read_json(&run.join("metrics.json"));
    assert_eq!(metrics["association"]["segments"], 16);
    let labels = &metrics["test"]["labels"];
    for row in ["raw", "vote", "per_gaussian"] {
        let scores = &labels[row]["instances"];
        assert_eq!((&scores["instances"], &labels[row]["miou"]), (&4.into(), &serde_json::Value::Null), "{labels}");
        assert!(scores["accuracy"].as_f64().expect("accuracy") > 0.5, "{row}: {scores}");
    }
    let page = fs::read_to_string(run.join("report.html")).expect("page");
    assert!(page.contains("Objects against true instances") && page.contains("put together"), "the page says so");
    let classes = Classes::read(&run.join("classes.json")).expect("classes");
    assert!(classes.name(1).starts_with("object "));
    let said: serde_json::Value = serde_json::from_str(&succeeds(&["eval", utf8(&run), "--json"])).expect("JSON");
    let [found, told] = [&said["instances"]["accuracy"], &labels["per_gaussian"]["instances"]["accuracy"]];
    assert!((found.as_f64().expect("score") - told.as_f64().expect("score")).abs() < 1e-3, "{said}");
    assert_eq!(said["labels"]["miou"], serde_json::Value::Null);
}
