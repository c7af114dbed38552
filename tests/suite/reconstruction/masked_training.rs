//! What masks leave out does not count: gradients, scores, and a stranger who walks through the photos of a room.

use crate::support::photometric::{compare, target};
use coseg::config::{BuildingConfig, Config};
use coseg::data::builtin::{BuiltinOptions, scene_with};
use coseg::data::mask::Mask;
use coseg::data::{Scene, Split};
use coseg::metrics::{ImageScores, psnr, ssim};
use coseg::reconstruction::Trainer;
use image::Rgb;

/// Smooth structure in 0..1, another one for each phase.
fn picture(height: usize, width: usize, phase: f64) -> Vec<f64> {
    (0..height * width * 3)
        .map(|i| {
            let (x, y, c) = (
                (i / 3 % width) as f64,
                (i / 3 / width) as f64,
                (i % 3) as f64,
            );
            0.5 + 0.3 * (0.3 * x + 0.2 * y + c + phase).sin()
                + 0.1 * (2.1 * x - 1.7 * y + phase).cos()
        })
        .collect()
}

/// Leaves a block and some single pixels out.
fn mask(height: usize, width: usize) -> Mask {
    Mask::new(width, height, |i| {
        !((5..20).contains(&(i % width)) && (8..40).contains(&(i / width)) || i % 97 == 0)
    })
}

#[test]
fn what_is_left_out_has_no_gradient_and_no_influence() {
    let (height, width) = (50, 37);
    let x = picture(height, width, 0.0);
    let y = picture(height, width, 0.4);
    let mask = mask(height, width);
    let size = (height, width);
    let photo = target(&y, size, Some(mask.clone()));
    for weight in [0.0, 0.2, 1.0] {
        let (loss, gradient) = compare(&photo, &x, weight);
        let pixels = || gradient.chunks(3).enumerate();
        assert!(
            pixels().all(|(i, pixel)| mask.uses(i) || pixel == [0.0; 3]),
            "exactly zero"
        );
        assert!(pixels().all(|(i, pixel)| !mask.uses(i) || pixel.iter().any(|g| *g != 0.0)));
        // Whatever is rendered there, and whatever the photo shows.
        let (mut other, mut another) = (x.clone(), y.clone());
        mask.fill(&mut other, 3, f64::NAN);
        mask.fill(&mut another, 3, 0.77);
        let another = target(&another, size, Some(mask.clone()));
        assert_eq!(compare(&another, &other, weight), (loss, gradient.clone()));
        // As if both were black there, with the gradient of that.
        let mut black = [x.clone(), y.clone()];
        black
            .iter_mut()
            .for_each(|values| mask.fill(values, 3, 0.0));
        let (want, mut of_black) = compare(&target(&black[1], size, None), &black[0], weight);
        mask.fill(&mut of_black, 3, 0.0);
        assert_eq!((loss, &gradient), (want, &of_black));
        for i in (0..x.len()).step_by(41) {
            let moved = |by: f64| {
                let mut x = x.clone();
                x[i] += by;
                compare(&photo, &x, weight).0
            };
            let numeric = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            let off = (gradient[i] - numeric).abs();
            assert!(
                off < 1e-6 * gradient[i].abs().max(1e-5),
                "value {i}: {} against {numeric}",
                gradient[i]
            );
        }
    }
}

#[test]
fn a_mask_that_leaves_nothing_out_changes_no_bit() {
    let size = (50, 37);
    let all = Mask::new(37, 50, |_| true);
    let (x, y) = (picture(50, 37, 0.0), picture(50, 37, 0.4));
    assert_eq!(
        compare(&target(&y, size, Some(all)), &x, 0.2),
        compare(&target(&y, size, None), &x, 0.2)
    );
}

#[test]
fn scores_are_of_what_is_used() {
    let mut scene = tiny();
    let view = scene
        .views
        .iter_mut()
        .find(|view| view.split == Split::Test)
        .unwrap();
    let width = view.camera.width;
    let height = view.camera.height;
    let photo = view.rgb().unwrap();
    let mut image: Vec<f32> = photo
        .iter()
        .enumerate()
        .map(|(i, v)| v + 0.05 * (i as f32).sin())
        .collect();
    let want = ImageScores {
        psnr: psnr(&image, &photo),
        ssim: ssim(&image, &photo, [width, height, 3], None),
    };
    assert_eq!(ImageScores::of_view(&image, view).unwrap(), want);
    // The left 17 columns: PSNR and SSIM are those of the photo without them.
    view.mask = Some(Mask::new(width, height, |i| i % width >= 17));
    let cut = |image: &[f32]| -> Vec<f32> {
        image
            .chunks(3 * width)
            .flat_map(|row| row[51..].to_vec())
            .collect()
    };
    let want = [
        psnr(&cut(&image), &cut(&photo)),
        ssim(&cut(&image), &cut(&photo), [width - 17, height, 3], None),
    ];
    image
        .chunks_mut(3 * width)
        .for_each(|row| row[..51].fill(f32::NAN));
    let found = ImageScores::of_view(&image, view).unwrap();
    assert_eq!(found.psnr, want[0]);
    assert!(
        (found.ssim.unwrap() - want[1].unwrap()).abs() < 1e-12,
        "{found:?} {want:?}"
    );
    // No window of 11 pixels is left.
    view.mask = Some(Mask::new(width, height, |i| i % 9 > 0));
    let found = ImageScores::of_view(&photo, view).unwrap();
    assert_eq!(
        (found.psnr, found.ssim),
        (Some(coseg::metrics::PSNR_CAP), None)
    );
}

/// A small room.
fn tiny() -> Scene {
    let options = BuiltinOptions {
        width: 96,
        height: 72,
        train_views: 16,
        test_views: 4,
        points: 2_500,
        ..BuiltinOptions::default()
    };
    scene_with(&options).unwrap()
}

/// Paints a stranger into each training photo, now here, now there, where `seen`; a fifth of the picture, left out where `masked`.
fn walk_through(scene: &mut Scene, seen: bool, masked: bool) {
    let train = scene
        .views
        .iter_mut()
        .filter(|view| view.split == Split::Train);
    for (i, view) in train.enumerate() {
        let (width, height) = (view.camera.width, view.camera.height);
        let left = 7 * i % (width - 28);
        let stranger = |x: usize, y: usize| (left..left + 28).contains(&x) && y >= height / 4;
        let mut photo = (*view.image.pixels().unwrap()).clone();
        for (x, y, pixel) in photo
            .enumerate_pixels_mut()
            .filter(|(x, y, _)| stranger(*x as usize, *y as usize))
        {
            *pixel = Rgb([230, (40 + x + y) as u8, 30 * (y as u8 % 3)]);
        }
        if seen {
            view.image = photo.into();
        }
        view.mask = masked.then(|| Mask::new(width, height, |i| !stranger(i % width, i / width)));
    }
}

/// Held-out PSNR after some steps.
fn trained(scene: &Scene, iterations: usize) -> f64 {
    let building = BuildingConfig {
        iterations,
        ..BuildingConfig::default()
    };
    let config = Config {
        building,
        seed: 3,
        ..Config::default()
    };
    let device = crate::support::device();
    let mut stage = Trainer::new(scene, &config, &device).unwrap();
    while stage.iteration() < config.building.iterations {
        stage.step().unwrap();
    }
    stage.evaluate().unwrap().held_out.psnr.unwrap()
}

#[test]
fn a_stranger_in_the_photos_hurts_unless_masked() {
    let [clean, mut seen, mut masked, mut unseen] = [(); 4].map(|()| tiny());
    walk_through(&mut seen, true, false);
    walk_through(&mut masked, true, true);
    walk_through(&mut unseen, false, true);
    assert_eq!(
        trained(&masked, 40),
        trained(&unseen, 40),
        "what is left out may be anything"
    );
    let [clean, seen, masked] = [&clean, &seen, &masked].map(|scene| trained(scene, 350));
    eprintln!("held-out PSNR: {clean:.2} dB, with a stranger {seen:.2}, masked {masked:.2}");
    assert!(
        seen < clean - 2.0,
        "the stranger hurts: {clean:.2} dB without, {seen:.2} with"
    );
    // What is lost yet is a fifth of the pixels, of few views that hardly overlap: those under the masks have no influence.
    assert!(
        masked > seen + 1.0,
        "masks help: {seen:.2} dB without, {masked:.2} with"
    );
}

#[test]
fn a_mask_of_another_size_is_no_mask() {
    let mut scene = tiny();
    scene.views[5].mask = Some(Mask::new(72, 96, |i| i > 7));
    let error = Trainer::new(&scene, &Config::default(), &crate::support::device())
        .map(|_| ())
        .unwrap_err();
    let parts = ["72x96", &scene.views[5].name, "96x72", "mask"];
    crate::support::assert_names(&error, &parts);
    // Scores know none either.
    crate::support::assert_names(
        &ImageScores::of_view(&vec![0.0; 3 * 96 * 72], &scene.views[5]).unwrap_err(),
        &parts,
    );
}
