//! Scenes of generated pictures.

use coseg::data::{Classes, LabelMap, LabelRuns, Photo, Points, Scene, Split, View, WorldUnit};
use coseg::splat::camera::Camera;
use glam::{DMat3, DVec3};
use image::RgbImage;

fn camera(width: usize, height: usize) -> Camera {
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    Camera {
        rotation: DMat3::IDENTITY,
        center: DVec3::ZERO,
        fx: 300.0,
        fy: 300.0,
        cx,
        cy,
        width,
        height,
    }
}

/// A view of a picture.
pub fn view(name: &str, split: Split, image: RgbImage, truth: Option<LabelMap>) -> View {
    let image = Photo::from(image);
    let truth = truth.map(LabelRuns::from);
    let camera = camera(image.width(), image.height());
    View {
        name: name.into(),
        split,
        camera,
        image,
        mask: None,
        truth,
        raw: None,
        scores: None,
        segments: Vec::new(),
        corrected: None,
        instances: None,
    }
}

/// A scene of these views.
pub fn scene(views: Vec<View>, classes: Classes) -> Scene {
    Scene {
        name: "test".into(),
        views,
        classes,
        points: Points::default(),
        drawn: false,
        origin: DVec3::ZERO,
        up: DVec3::Z,
        unit: WorldUnit::Metre,
    }
}

/// Coloured noise over a gradient; `seed` moves it.
pub fn picture(width: u32, height: u32, seed: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let n = (x.wrapping_mul(73) ^ y.wrapping_mul(151) ^ seed.wrapping_mul(977))
            .wrapping_mul(2_654_435_761)
            >> 24;
        image::Rgb([
            (x * 255 / width) as u8,
            (n / 2 + y * 100 / height) as u8,
            ((x / 7 + y / 5 + seed) % 2 * 180) as u8,
        ])
    })
}

/// A scene of `count` pictures, every fourth of them held out.
pub fn pictures(count: u32) -> Scene {
    let views = (0..count).map(|i| {
        view(
            &format!("v{i}"),
            if i % 4 == 3 {
                Split::Test
            } else {
                Split::Train
            },
            picture(70, 54, i),
            None,
        )
    });
    scene(views.collect(), Classes::default())
}
