//! Association: segments with ids of their own in every view become objects.

use crate::support::plate_objects::{
    associate, found, joined, map, map_scores, plate_scene, rendered_scores,
};
use crate::support::plates;
use crate::support::spoilt_masks::{Noise, spoilt};
use coseg::config::{self, Variant};
use coseg::data::{LabelMap, Segment, Split};
use coseg::objects;
use coseg::pipeline::run;
use coseg::progress::Silent;
use coseg::raster::Settings;
use coseg::splat::Gaussians;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::fs;

#[test]
fn shuffled_ids_become_objects() {
    let (gaussians, mut scene) = plate_scene();
    let association = found(&gaussians, &scene);
    let scores = map_scores(&scene, &association.maps);
    assert_eq!(
        (scores.accuracy, scores.miou, scores.scene.pq),
        (Some(1.0), Some(1.0), Some(1.0))
    );
    assert_eq!(
        (
            association.classes.len(),
            association.dropped,
            association.segments
        ),
        (4, 0, 16)
    );
    let names: Vec<&str> = association
        .classes
        .entries
        .iter()
        .map(|c| &*c.name)
        .collect();
    assert_eq!(names, ["object 1", "object 2", "object 3", "object 4"]);
    let pixels = |id: u16| {
        let views = scene.views.iter().zip(&association.maps);
        let trained = views.filter(|(view, _)| view.split == Split::Train);
        let counts = trained.map(|(_, of)| map(of).ids.iter().filter(|i| **i == id).count());
        counts.collect::<Vec<usize>>()
    };
    let of_objects: Vec<_> = (1..=4).map(pixels).collect();
    let sizes: Vec<usize> = of_objects.iter().map(|views| views.iter().sum()).collect();
    assert!(
        sizes.windows(2).all(|pair| pair[0] >= pair[1]),
        "largest first: {sizes:?}"
    );
    let in_views = of_objects
        .iter()
        .map(|v| v.iter().filter(|n| **n > 0).count());
    assert_eq!(in_views.collect::<Vec<_>>(), [4; 4]);
    let mut entries = association.classes.entries.iter();
    assert!(entries.all(|entry| entry.object_of.is_none()));
    association.apply(&mut scene);
    assert!(
        scene
            .views
            .iter()
            .all(|v| v.truth.is_none() && v.raw.is_some())
    );
    assert_eq!(scene.classes.len(), 4);
}

#[test]
fn the_order_of_views_and_the_number_of_threads_change_nothing() {
    let (gaussians, mut scene) = plate_scene();
    let first = found(&gaussians, &scene);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        assert_eq!(
            pool.install(|| found(&gaussians, &scene)),
            first,
            "{threads} threads"
        );
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
        let split = |(p, &id): (usize, &u16)| {
            if id == 4 && p % truth.width < 40 {
                5
            } else {
                id
            }
        };
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
        view.segments = (1..6)
            .map(|id| Segment {
                id,
                class: Some(class(id)),
                thing: id < 4,
            })
            .collect();
    }
    let association = found(&gaussians, &scene);
    let of_class = |class: u16| -> Vec<u16> {
        let entries = association.classes.entries.iter();
        let of_class = entries.filter(|e| e.object_of.is_some_and(|of| of.class == class));
        of_class.map(|entry| entry.id).collect()
    };
    let wall = of_class(4);
    assert_eq!(wall.len(), 1);
    // Names are those of the scene's classes.
    assert_eq!(association.classes.name(wall[0]), "wall");
    assert_eq!(of_class(2).len(), 3, "{:?}", association.classes);
    assert!(
        association
            .classes
            .entries
            .iter()
            .any(|c| c.name == "green 2")
    );
    let found = map(&association.maps[0]);
    let other = of_class(3);
    let truth = map(&scene.views[0].instances);
    assert!(
        found
            .ids
            .iter()
            .zip(&truth.ids)
            .all(|(found, t)| *t == 2 || !other.contains(found))
    );
}

#[test]
fn nothing_to_put_together_is_an_error() {
    let (gaussians, mut scene) = plate_scene();
    scene.views.iter_mut().for_each(|view| view.raw = None);
    let error = associate(&gaussians, &scene).expect_err("empty");
    crate::support::assert_names(
        &error,
        &["data.association", "no segments", "add raw labels"],
    );
    // Maps without Gaussians: nothing is shown.
    let (_, scene) = plate_scene();
    let none = Gaussians {
        means: vec![],
        log_scales: vec![],
        rotations: vec![],
        opacity_logits: vec![],
        sh: vec![],
        sh_degree: 0,
    };
    let error = associate(&none, &scene).expect_err("no Gaussian");
    crate::support::assert_names(
        &error,
        &[
            "data.association",
            "no segment",
            "Gaussians where the segments are",
            "of one scene",
        ],
    );
}

#[test]
fn what_was_built_stays_without_an_object() {
    let folder = tempfile::tempdir().expect("folder");
    plates::scene(folder.path());
    let mut config = crate::support::plate_runs::config(folder.path());
    let out = folder.path().join("run");
    config.data.association = config::Association::Gaussians;
    config.segmentation.rows = Some(vec![Variant::Vote]);
    let raw = folder.path().join("raw");
    let given = folder.path().join("given");
    fs::rename(&raw, &given).expect("moved");
    for i in 0..6 {
        let ids = vec![0; plates::WIDTH * plates::HEIGHT];
        let unlabelled = LabelMap {
            width: plates::WIDTH,
            height: plates::HEIGHT,
            ids,
        };
        unlabelled
            .write(&raw.join(format!("v{i}.png")))
            .expect("a map");
    }
    let error = run(&config, &out, &crate::support::device(), &mut Silent)
        .err()
        .expect("no segments");
    crate::support::assert_names(&error, &["data.association", "no segments"]);
    let built = fs::read(out.join("checkpoint/building.safetensors")).expect("checkpoint");
    fs::remove_dir_all(&raw).expect("removed");
    fs::rename(&given, &raw).expect("moved back");
    let done = run(&config, &out, &crate::support::device(), &mut Silent).expect("a run");
    assert!(done.association.is_some_and(|found| found.objects > 0) && done.rows.len() == 1);
    assert!(fs::read(out.join("checkpoint/building.safetensors")).expect("checkpoint") == built);
}

#[test]
fn views_are_told_of_and_may_end_it() {
    let (gaussians, scene) = plate_scene();
    let until = |last: usize| {
        let mut told = 0;
        let found = objects::associate(&gaussians, &scene, &Settings::default(), &mut |views| {
            told += views;
            if told < last {
                Ok(())
            } else {
                Err(coseg::Error::Stopped)
            }
        });
        match found {
            Err(coseg::Error::Stopped) => (None, told),
            found => (Some(found.expect("association")), told),
        }
    };
    let looks = objects::AssociatedObjects::steps(&scene);
    assert_eq!(looks, (2 + 4) * 4 + 2);
    assert_eq!(until(usize::MAX), (Some(found(&gaussians, &scene)), looks));
    // While the segments of views are looked at, in sweeps, while maps of training and test views are made.
    for last in [1, 4, 5, 9, 20, 22, looks] {
        assert_eq!(until(last), (None, last));
    }
}

#[test]
fn noise_of_single_views_is_outvoted() {
    let (gaussians, mut scene) = plate_scene();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for view in &mut scene.views {
        let noise = Noise {
            split: 0.3,
            merge: 0.1,
            erode: 1,
            drop: 0.2,
        };
        view.raw = Some(spoilt(&map(&view.instances), noise, &mut rng).into());
    }
    let scores = rendered_scores(&gaussians, scene);
    assert_eq!(scores.instances, 4);
    assert!(
        scores.accuracy > Some(0.95) && scores.miou > Some(0.85),
        "{scores:?}"
    );
}

#[test]
fn a_segment_over_two_things_is_divided_and_joins_nothing() {
    let pairs = [(4, 1), (4, 2), (1, 2), (3, 1)];
    for (view, pair) in (0..4).flat_map(|view| pairs.map(|pair| (view, pair))) {
        let mut one = [None; 4];
        one[view] = Some(pair);
        let (gaussians, scene) = joined(one);
        let association = found(&gaussians, &scene);
        assert_eq!(
            (association.classes.len(), association.divided),
            (4, 1),
            "{pair:?} in view {view}"
        );
        let scores = map_scores(&scene, &association.maps);
        assert!(
            scores.accuracy > Some(0.99) && scores.miou > Some(0.98),
            "{pair:?} in view {view}: {scores:?}"
        );
    }
}

#[test]
fn what_most_views_take_for_one_is_one() {
    let pair = Some((1, 2));
    for (views, groups) in [
        ([pair, pair, pair, pair], 3),
        ([pair, None, pair, pair], 3),
        ([None, pair, None, pair], 4),
    ] {
        let (gaussians, scene) = joined(views);
        assert_eq!(found(&gaussians, &scene).classes.len(), groups, "{views:?}");
    }
}
