//! The built-in scene: same bytes at any thread count, exact truth, raw labels in their range, sensible cameras.

use coseg::data::builtin::{
    BuiltinOptions, Corruption, EVALUATED_SEED, PRETRAINING_SEEDS, Room, TEST_DISTANCE, classes,
    corrupt, labelled_points, render_truth, scene, scene_with,
};
use coseg::data::{LabelMap, LabelRuns, Scene, Split, View};
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

static SCENE: LazyLock<Scene> = LazyLock::new(|| scene(EVALUATED_SEED));
static ROOM: LazyLock<Room> = LazyLock::new(|| Room::of_scene(EVALUATED_SEED));

fn tiny() -> BuiltinOptions {
    BuiltinOptions {
        width: 48,
        height: 36,
        train_views: 8,
        test_views: 3,
        points: 500,
        ..Default::default()
    }
}

fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap()
        .install(work)
}

/// Pooled mIoU over the classes of the truth, void predictions counted as wrong.
fn pooled_miou<'a>(views: impl Iterator<Item = &'a View>) -> f64 {
    let n = classes().len() + 1;
    let mut counts = vec![0_u64; n * n];
    for v in views {
        let (truth, raw) = (
            v.truth.as_ref().unwrap().map(),
            v.raw.as_ref().unwrap().map(),
        );
        assert_eq!((truth.width, truth.height), (raw.width, raw.height));
        truth
            .ids
            .iter()
            .zip(&raw.ids)
            .for_each(|(&t, &r)| counts[usize::from(t) * n + usize::from(r)] += 1);
    }
    let iou = |c: usize| {
        let row: u64 = counts[c * n..(c + 1) * n].iter().sum();
        let column: u64 = (0..n).map(|r| counts[r * n + c]).sum();
        counts[c * n + c] as f64 / (row + column - counts[c * n + c]) as f64
    };
    (1..n).map(iou).sum::<f64>() / (n - 1) as f64
}

#[test]
fn one_seed_gives_the_same_bytes_at_any_thread_count() {
    let make = |threads| {
        with_threads(threads, || {
            (scene_with(&tiny()).unwrap(), labelled_points(5, 2000))
        })
    };
    let ((a, points_a), (b, points_b)) = (make(1), make(2));
    assert_eq!(points_a, points_b);
    assert_eq!(a.points, b.points);
    for (v, w) in a.views.iter().zip(&b.views) {
        assert_eq!((&v.name, &v.camera), (&w.name, &w.camera));
        assert_eq!(v.image.pixels().unwrap(), w.image.pixels().unwrap());
        assert_eq!((&v.truth, &v.raw), (&w.truth, &w.raw));
    }
    let other = scene_with(&BuiltinOptions { seed: 3, ..tiny() }).unwrap();
    assert_ne!(
        other.views[0].image.pixels().unwrap(),
        a.views[0].image.pixels().unwrap()
    );
}

#[test]
fn raw_labels_are_as_bad_as_promised_in_both_splits() {
    for split in [Split::Train, Split::Test] {
        let miou = pooled_miou(SCENE.split(split));
        assert!((0.55..=0.65).contains(&miou), "{split:?} {miou}");
    }
}

#[test]
fn sizes_names_and_classes_are_complete() {
    let count = |split| SCENE.split(split).count();
    assert_eq!(
        (count(Split::Train), count(Split::Test), SCENE.classes.len()),
        (48, 12, 10)
    );
    assert_eq!(
        SCENE
            .views
            .iter()
            .map(|v| &v.name)
            .collect::<BTreeSet<_>>()
            .len(),
        60
    );
    assert_eq!(
        SCENE
            .classes
            .entries
            .iter()
            .map(|c| c.color)
            .collect::<BTreeSet<_>>()
            .len(),
        10
    );
    for split in [Split::Train, Split::Test] {
        let mut pixels = BTreeMap::new();
        for v in SCENE.split(split) {
            assert_eq!((v.image.width(), v.image.height()), (320, 240));
            v.truth
                .as_ref()
                .unwrap()
                .runs()
                .for_each(|(id, n)| *pixels.entry(id).or_insert(0) += n);
        }
        assert!(!pixels.contains_key(&SCENE.classes.ignore));
        assert_eq!(pixels.len(), 10, "{split:?} {pixels:?}");
        assert!(pixels.values().all(|&n| n > 2000), "{split:?} {pixels:?}");
    }
    // Several objects of every class that is not part of the building's shell.
    let mut objects: BTreeMap<u16, BTreeSet<u16>> = BTreeMap::new();
    for v in SCENE.split(Split::Train) {
        let truth = render_truth(&ROOM, &v.camera.resized(80, 60));
        truth
            .labels
            .ids
            .iter()
            .zip(&truth.instances)
            .for_each(|(&c, &i)| _ = objects.entry(c).or_default().insert(i));
    }
    for class in SCENE
        .classes
        .entries
        .iter()
        .filter(|c| !["floor", "ceiling"].contains(&c.name.as_str()))
    {
        assert!(
            objects[&class.id].len() >= 3,
            "{} {:?}",
            class.name,
            objects[&class.id]
        );
    }
}

#[test]
fn depth_and_labels_agree_between_views() {
    let views: Vec<&View> = SCENE.views.iter().step_by(5).collect();
    let (mut seen, mut same, mut tried) = (0, 0, 0);
    for (a, b) in views.iter().zip(views.iter().cycle().skip(3)) {
        let truth = render_truth(&ROOM, &a.camera);
        assert_eq!(
            Some(&truth.labels),
            a.truth.as_ref().map(LabelRuns::map).as_ref()
        );
        for i in (0..truth.depth.len()).step_by(193) {
            let (x, y) = ((i % 320) as f64 + 0.5, (i / 320) as f64 + 0.5);
            let p = a.camera.center + a.camera.ray(x, y) * f64::from(truth.depth[i]);
            let Some((u, v, z)) = b.camera.project(p) else {
                continue;
            };
            if !(0.0..320.0).contains(&u) || !(0.0..240.0).contains(&v) {
                continue;
            }
            // The other camera reduced to one pixel whose centre is where the point projects to.
            let (cx, cy) = (b.camera.cx - u + 0.5, b.camera.cy - v + 0.5);
            let pixel = coseg::splat::camera::Camera {
                cx,
                cy,
                width: 1,
                height: 1,
                ..b.camera.clone()
            };
            let there = render_truth(&ROOM, &pixel);
            let depth = f64::from(there.depth[0]);
            tried += 1;
            // Nothing can be seen behind a point that is there.
            assert!(
                depth <= z * (1.0 + 1e-5) + 1e-5,
                "{} to {}: {depth} > {z}",
                a.name,
                b.name
            );
            if (depth - z).abs() < 1e-4 * z {
                seen += 1;
                same += usize::from(there.labels.ids[0] == truth.labels.ids[i]);
            }
        }
    }
    assert!(tried > 500 && seen * 3 > tried, "{seen} of {tried}");
    assert!(same * 500 >= seen * 499, "{same} of {seen}");
}

#[test]
fn cameras_stand_in_free_space_and_test_cameras_off_the_path() {
    for v in &SCENE.views {
        let c = v.camera.center;
        let inside = c.truncate().abs().cmplt(ROOM.size.truncate() / 2.0).all()
            && c.z > 0.5
            && c.z < ROOM.size.z;
        assert!(
            inside && ROOM.clearance(c) > 0.2,
            "{} at {c}, {} free",
            v.name,
            ROOM.clearance(c)
        );
        assert!((v.camera.rotation.determinant() - 1.0).abs() < 1e-9);
        let up = v.camera.rotation * SCENE.up;
        assert!(
            up.y < -0.5 && up.x.abs() < 1e-9,
            "{} is not upright: {up}",
            v.name
        );
    }
    for t in SCENE.split(Split::Test) {
        let near = SCENE
            .split(Split::Train)
            .map(|v| v.camera.center.distance(t.camera.center))
            .fold(9.0, f64::min);
        assert!(
            near >= TEST_DISTANCE,
            "{} is {near} m from a training camera",
            t.name
        );
    }
}

#[test]
fn initial_points_lie_near_surfaces_with_a_few_outliers() {
    let n = SCENE.points.positions.len();
    assert!((11_000..=12_000).contains(&n) && SCENE.points.colors.len() == n);
    let far = |p: &&[f32; 3]| ROOM.clearance(DVec3::from_array(p.map(f64::from))) > 0.06;
    let outliers = SCENE.points.positions.iter().filter(far).count();
    assert!((n / 200..n / 20).contains(&outliers), "{outliers} of {n}");
}

#[test]
fn labelled_points_come_from_many_rooms_none_of_them_evaluated() {
    assert!(!PRETRAINING_SEEDS.contains(&EVALUATED_SEED));
    let table = classes();
    let mut found = BTreeSet::new();
    let mut sizes = BTreeSet::new();
    for seed in [0, 1, 2, 3, EVALUATED_SEED] {
        let cloud = labelled_points(seed, 6000);
        assert_eq!(
            (
                cloud.positions.len(),
                cloud.colors.len(),
                cloud.classes.len()
            ),
            (6000, 6000, 6000)
        );
        let high = cloud
            .positions
            .iter()
            .fold([0.0_f32; 3], |m, p| [0, 1, 2].map(|k| m[k].max(p[k].abs())));
        assert!(high[0] < 3.7 && high[1] < 3.2 && high[2] < 3.2, "{high:?}");
        assert!(
            cloud
                .colors
                .iter()
                .flatten()
                .all(|c| (0.0..=1.0).contains(c))
        );
        assert!(cloud.classes.iter().all(|&c| table.index(c).is_some()));
        found.extend(cloud.classes.iter().copied());
        // Extents of the rooms, in 2 cm steps: the scene's own is among none of them, even under its own seed.
        let step = |v: f64| (v * 50.0).round() as i64;
        sizes.insert([0, 1, 2].map(|k| step(f64::from(high[k]))));
        assert!(
            (f64::from(high[0]) - ROOM.size.x / 2.0).abs()
                + (f64::from(high[2]) - ROOM.size.z).abs()
                > 0.05
        );
    }
    assert_eq!((found.len(), sizes.len()), (10, 5));
}

/// Views of eight upright strips, each an object of its own, classes 1 to 4.
fn strips(views: usize) -> (Vec<LabelMap>, Vec<Vec<u16>>) {
    let (width, height) = (64, 32);
    let instances: Vec<u16> = (0..width * height)
        .map(|i| (i % width / 8) as u16 + 1)
        .collect();
    let ids = instances.iter().map(|i| (i - 1) % 4 + 1).collect();
    (
        vec![LabelMap { width, height, ids }; views],
        vec![instances; views],
    )
}

#[test]
fn corruption_of_strength_zero_changes_nothing() {
    let (labels, instances) = strips(3);
    let instances: Vec<&[u16]> = instances.iter().map(Vec::as_slice).collect();
    let params = Corruption {
        strength: 0.0,
        ..Default::default()
    };
    assert_eq!(corrupt(&labels, &instances, &params, 1), labels);
}

#[test]
fn wrong_classes_last_over_runs_of_views() {
    let (labels, instances) = strips(200);
    let instances: Vec<&[u16]> = instances.iter().map(Vec::as_slice).collect();
    let zero = Corruption {
        swap: 0.0,
        merge: 0.0,
        split: 0.0,
        drop: 0.0,
        warp: 0.0,
        void_borders: 0.0,
        ..Default::default()
    };
    let params = Corruption {
        run_share: 0.4,
        confusions: Vec::new(),
        ..zero
    };
    let (mut wrong, mut runs, mut changes) = (0, 0, 0);
    for seed in 0..6 {
        let raw = corrupt(&labels, &instances, &params, seed);
        for strip in 0..8 {
            let at = |v: usize| {
                Some(raw[v].ids[strip * 8 + 4]).filter(|&c| c != labels[0].ids[strip * 8 + 4])
            };
            for v in 1..200 {
                wrong += usize::from(at(v).is_some());
                runs += usize::from(at(v).is_some() && at(v - 1).is_none());
                changes +=
                    usize::from(at(v).is_some() && at(v - 1).is_some() && at(v) != at(v - 1));
            }
        }
    }
    let mean = wrong as f64 / runs as f64;
    assert!((5.0..13.0).contains(&mean), "mean run {mean} for 8 asked");
    assert_eq!(changes, 0, "a run keeps its class");
    let share = wrong as f64 / (6 * 8 * 199) as f64;
    assert!((0.1..0.5).contains(&share), "{share}");
}

#[test]
fn unusable_options_are_named() {
    let error = scene_with(&BuiltinOptions {
        train_views: 0,
        ..tiny()
    })
    .unwrap_err()
    .to_string();
    assert!(error.contains("builtin.train_views"), "{error}");
    let error = scene_with(&BuiltinOptions { width: 0, ..tiny() })
        .unwrap_err()
        .to_string();
    assert!(error.contains("builtin.width"), "{error}");
}
