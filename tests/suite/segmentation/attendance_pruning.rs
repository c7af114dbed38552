//! Attendance: which Gaussians too few pixels show (Algorithm 1).

use crate::support::feature_maps::{cloud, features, maps, views};
use crate::support::lifting::unproject;
use coseg::config::{Normalisation, UnprojectionConfig};
use coseg::raster::Settings;
use coseg::segmentation::unprojection::attended;
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
    let pruned = |attendance_pixels| {
        let config = UnprojectionConfig {
            attendance: 0.05,
            attendance_pixels,
            ..UnprojectionConfig::default()
        };
        let keep = kept(&scene, &config);
        keep.iter().filter(|keep| !**keep).count()
    };
    let (by_share, by_pixels) = (pruned(0.0), pruned(9.0));
    assert!(
        by_pixels > 0 && by_pixels < by_share,
        "{by_pixels} pruned below 9 pixels, {by_share} by share"
    );
}

#[test]
fn no_attendance_threshold_prunes_nothing() {
    let config = UnprojectionConfig {
        attendance: 0.0,
        ..UnprojectionConfig::default()
    };
    assert_eq!(kept(&cloud(50), &config), [true; 50]);
    assert!(kept(&Gaussians::default(), &config).is_empty());
}

#[test]
fn no_gaussians_have_no_features() {
    let views = views(40, 30);
    let lifted = unproject(
        &Gaussians::default(),
        views.iter(),
        &features(&views, maps),
        Normalisation::Count,
        &crate::support::device(),
    );
    assert_eq!(lifted.expect("nothing"), vec![Vec::<f32>::new(); 4]);
}

fn kept(scene: &Gaussians, config: &UnprojectionConfig) -> Vec<bool> {
    let views = views(40, 30);
    let settings = Settings::default();
    let device = crate::support::device();
    let go_on = &mut || Ok(());
    attended(scene, views.iter(), config, &settings, &device, go_on).expect("counts")
}
