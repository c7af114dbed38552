//! Votes and label maps on a GPU: those of the CPU.

use crate::support::on_device;
use crate::support::raster_reference::{colored_gaussians as gaussians, numbers};
use burn::tensor::Device;
use coseg::config::LabelSource;
use coseg::data::{Classes, LabelMap, LabelRuns, Scene};
use coseg::objects::{Identities, LabelMaps, vote};
use coseg::raster::{Settings, SplatTensors};

fn classes(count: u16) -> Classes {
    Classes::from_names(0, (0..=count).map(|id| (id, format!("class {id}"))))
}

/// A scene of eight views that show from 1 to 64 of 70 classes, and pixels of none.
fn labelled() -> Scene {
    let mut scene = crate::support::painted_plane::scene();
    scene.classes = classes(70);
    for (v, view) in scene.views.iter_mut().enumerate() {
        let (width, height) = (view.camera.width, view.camera.height);
        let shown = [1, 60, 33, 32, 5, 2, 31, 64][v] as u16;
        let id = |i: usize| (i * 7919 / 11) as u16 % (shown + 1);
        view.raw = Some(LabelRuns::from(LabelMap {
            width,
            height,
            ids: (0..width * height).map(id).collect(),
        }));
    }
    scene
}

#[test]
fn votes_are_those_of_the_host() {
    let Some(gpu) = crate::support::gpu() else {
        return;
    };
    let scene = labelled();
    let splats = coseg::reconstruction::initialization::from_points(&scene.points, 0, 2.0)
        .expect("Gaussians");
    let settings = Settings::default();
    let of = |device| {
        vote(
            &splats,
            scene.views.iter(),
            &scene.classes,
            &settings,
            device,
        )
        .expect("votes")
    };
    let (want, got) = (
        of(&crate::support::device()),
        on_device(Some(&gpu), || of(&gpu)),
    );
    assert_eq!(
        (got.classes, got.table.len()),
        (want.classes, want.table.len())
    );
    let most = want.table.iter().fold(0.0_f32, |most, v| most.max(*v));
    assert!(most > 1.0);
    // Single pixels at the rim of a footprint go either way.
    let differ = got
        .table
        .iter()
        .zip(&want.table)
        .filter(|(a, b)| (*a - *b).abs() > 1e-5 * most)
        .count();
    assert!(
        differ * 1000 <= want.table.len(),
        "{differ} of {}",
        want.table.len()
    );
    for (got, want) in got.table.iter().zip(&want.table) {
        assert!((got - want).abs() < 0.01 * most, "{got} {want}");
    }
    let winners = got
        .winners()
        .iter()
        .zip(want.winners())
        .filter(|(a, b)| **a != *b)
        .count();
    assert!(
        winners * 1000 <= splats.len(),
        "{winners} of {} winners",
        splats.len()
    );
}

#[test]
fn label_maps_are_those_of_the_host() {
    let Some(gpu) = crate::support::gpu() else {
        return;
    };
    // The larger image takes 260 labels in several blocks.
    for (width, height, count, scale) in [
        (90, 70, 12, 0.04),
        (90, 70, 1, 0.04),
        (160, 120, 70, 0.1),
        (1200, 900, 260, 0.03),
    ] {
        let camera = crate::support::raster_reference::camera(width, height);
        let gaussians = gaussians(&camera, scale);
        let settings = Settings::default();
        let cpu = crate::support::device();
        let [on_cpu, on_gpu] = [&cpu, &gpu]
            .map(|device| SplatTensors::new(&gaussians, device).seen_by(&camera, &settings));
        let c = usize::from(count);
        let mut scores: Vec<f32> = numbers(gaussians.len() * c, 3)
            .into_iter()
            .map(|v| v as f32)
            .collect();
        // Of every fifth Gaussian nothing is known.
        scores
            .chunks_exact_mut(c)
            .step_by(5)
            .for_each(|row| row.fill(0.25));
        let identities = Identities { scores, classes: c };
        let classes = classes(count);
        for (source, min_coverage) in [
            (LabelSource::Labels, 0.3),
            (LabelSource::Scores, 0.3),
            (LabelSource::Labels, 0.0),
            (LabelSource::Scores, 0.0),
        ] {
            let maps = || LabelMaps::new(&identities, &classes, source, min_coverage);
            let want = maps().of(&on_cpu).expect("a map");
            let got = on_device(Some(&gpu), || maps().of(&on_gpu).expect("a map"));
            assert_eq!((got.width, got.height), (width, height));
            let differ = got
                .ids
                .iter()
                .zip(&want.ids)
                .filter(|(a, b)| a != b)
                .count();
            let what = format!(
                "{source:?} of {count} classes at {width}x{height}, from {min_coverage} on"
            );
            assert!(
                differ * 1000 <= want.ids.len(),
                "{what}: {differ} labels differ"
            );
            let known = want.ids.iter().filter(|id| **id != 0).count();
            assert!(known * 10 > want.ids.len(), "{what}: {known} known");
            // Where Gaussians that nothing is known of have most of a pixel, by labels; sums of scores are never all alike.
            let unknown = source == LabelSource::Labels && count > 1;
            assert!(!unknown || known < want.ids.len(), "{what}: all known");
        }
    }
}

#[test]
fn nothing_known_is_the_ignored_id_on_every_device() {
    let camera = crate::support::raster_reference::camera(40, 30);
    let gaussians = gaussians(&camera, 0.1);
    let settings = Settings::default();
    let classes = classes(3);
    let identities = Identities {
        scores: vec![0.5; gaussians.len() * 3],
        classes: 3,
    };
    for source in [LabelSource::Labels, LabelSource::Scores] {
        let map = |device: &Device| {
            let view = SplatTensors::new(&gaussians, device).seen_by(&camera, &settings);
            LabelMaps::new(&identities, &classes, source, 0.0)
                .of(&view)
                .expect("a map")
        };
        let on_cpu = map(&crate::support::device());
        assert!(on_cpu.ids.iter().all(|id| *id == 0), "{source:?}");
        let Some(gpu) = crate::support::gpu() else {
            continue;
        };
        let map = map(&gpu);
        let known = map.ids.iter().filter(|id| **id != 0).count();
        // Rounding may tell equal sums apart.
        assert!(
            source == LabelSource::Scores || known == 0,
            "{known} pixels of {source:?}"
        );
    }
}
