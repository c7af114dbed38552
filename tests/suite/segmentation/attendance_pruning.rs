//! Attendance: which Gaussians too few pixels show (Algorithm 1).

use crate::support::feature_maps::{cloud, features, maps, views};
use crate::support::lifting::unproject;
use coseg::config::UnprojectionConfig;
use coseg::raster::Settings;
use coseg::splat::Gaussians;

#[test]
fn of_many_large_photos_a_few_pixels_are_enough() {
    let config = UnprojectionConfig::default();
    // 48 photos of 320x240, then 437 of 1600x1200, of which a share alone would ask for 8,390 pixels.
    assert!((config.fewest_pixels(48 * 320 * 240) - 36.864).abs() < 1e-9);
    assert_eq!(config.fewest_pixels(437 * 1600 * 1200), 40.0);
    let share = UnprojectionConfig {
        attendance_pixels: 0.0,
        ..config
    };
    assert!((share.fewest_pixels(437 * 1600 * 1200) - 8_390.4).abs() < 1e-6);

    let scene = cloud(200);
    let views = views(40, 30);
    let set = features(&views, maps);
    let pruned = |attendance_pixels| {
        let config = UnprojectionConfig {
            attendance: 0.05,
            attendance_pixels,
            ..UnprojectionConfig::default()
        };
        let lifted = unproject(
            &scene,
            views.iter(),
            &set,
            &config,
            &Settings::default(),
            &crate::support::device(),
        );
        let lifted = lifted.expect("features");
        lifted.keep.iter().filter(|keep| !**keep).count()
    };
    let (by_share, by_pixels) = (pruned(0.0), pruned(9.0));
    assert!(
        by_pixels > 0 && by_pixels < by_share,
        "{by_pixels} pruned below 9 pixels, {by_share} by share"
    );
}

#[test]
fn no_attendance_threshold_prunes_nothing() {
    let scene = cloud(50);
    let views = views(40, 30);
    let config = UnprojectionConfig {
        attendance: 0.0,
        ..UnprojectionConfig::default()
    };
    let lifted = unproject(
        &scene,
        views.iter(),
        &features(&views, maps),
        &config,
        &Settings::default(),
        &crate::support::device(),
    )
    .expect("features");
    assert!(lifted.keep.iter().all(|&k| k));
    assert!(lifted.sums.buffers.iter().flatten().all(|x| x.is_finite()));
    let empty = Gaussians::default();
    let lifted = unproject(
        &empty,
        views.iter(),
        &features(&views, maps),
        &config,
        &Settings::default(),
        &crate::support::device(),
    )
    .expect("nothing");
    assert!(lifted.keep.is_empty() && lifted.sums.buffers[0].is_empty());
}
