//! A random cloud, three cameras before it, and feature maps of their views.

use crate::support::lifting::FeatureSet;
use coseg::data::{Split, View};
use coseg::features::{FeatureMap, Moments, Pca, Steps, ViewFeatures};
use coseg::splat::Gaussians;
use coseg::splat::camera::Camera;
use glam::{DMat3, DQuat, DVec3};
use std::path::Path;

/// Numbers in -1..1 without pattern.
pub fn noise(i: usize, salt: usize) -> f64 {
    let x = (i as u64)
        .wrapping_mul(0x9e37_79b9_7f4a_7c15)
        .wrapping_add((salt as u64).wrapping_mul(0x5851_f42d_4c95_7f2d));
    let x = (x ^ x >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((x ^ x >> 32) & 0xffff_ffff) as f64 / 2_147_483_648.0 - 1.0
}

/// A cloud before the cameras; the last Gaussian is behind all of them.
pub fn cloud(n: usize) -> Gaussians {
    let mut g = Gaussians::default();
    for i in 0..n {
        let at = |k| noise(i, k) as f32;
        g.means.push([2.2 * at(0), 1.6 * at(1), 4.0 + 1.5 * at(2)]);
        g.log_scales
            .push([-2.6 + 0.7 * at(3), -2.4 + 0.7 * at(4), -2.8 + 0.7 * at(5)]);
        g.rotations.push([1.0, at(6), at(7), at(8)]);
        g.opacity_logits.push(0.5 + 2.0 * at(9));
        g.sh.extend([0.0; 3]);
    }
    g.means[n - 1] = [0.0, 0.0, -50.0];
    g
}

/// Three cameras, turned a little against each other.
pub fn cameras(width: usize, height: usize) -> Vec<Camera> {
    (0..3)
        .map(|i| {
            let turn = DQuat::from_rotation_y(0.15 * (i as f64 - 1.0))
                * DQuat::from_rotation_x(0.07 * i as f64);
            let center = DVec3::new(0.4 * (i as f64 - 1.0), 0.1 * i as f64, -0.2 * i as f64);
            let (fx, fy) = (width as f64 * 0.9, width as f64 * 0.93);
            let (cx, cy) = (width as f64 * 0.49, height as f64 * 0.52);
            Camera {
                rotation: DMat3::from_quat(turn),
                center,
                fx,
                fy,
                cx,
                cy,
                width,
                height,
            }
        })
        .collect()
}

/// A map of numbers in -1..1.
pub fn map(width: usize, height: usize, channels: usize, salt: usize) -> FeatureMap {
    let data = (0..width * height * channels)
        .map(|i| noise(i, salt) as f32)
        .collect();
    FeatureMap {
        height,
        width,
        channels,
        data,
        steps: None,
    }
}

/// Maps of one view: two scales on one grid, one with steps of its own, one finer than the image.
pub fn maps(salt: usize) -> [FeatureMap; 4] {
    let stepped = FeatureMap {
        steps: Some(Steps {
            stride: 16.0,
            offset: 0.5,
        }),
        ..map(7, 5, 64, salt + 2)
    };
    [
        map(24, 18, 5, salt),
        map(24, 18, 150, salt + 1),
        stepped,
        map(130, 99, 3, salt + 3),
    ]
}

/// A training view without a picture.
pub fn view(name: String, camera: Camera) -> View {
    let image = image::RgbImage::new(camera.width as u32, camera.height as u32).into();
    View {
        name,
        split: Split::Train,
        camera,
        image,
        mask: None,
        truth: None,
        raw: None,
        scores: None,
        segments: Vec::new(),
        corrected: None,
        instances: None,
    }
}

/// `maps(i)` as the features of view `i`.
pub fn features(views: &[View], maps: impl Fn(usize) -> [FeatureMap; 4]) -> FeatureSet {
    let identity = || Pca::fit(&Moments::new(0), 1);
    let of = |(i, v): (usize, &View)| ViewFeatures {
        view: v.name.clone(),
        maps: maps(i).to_vec(),
    };
    let views = views.iter().enumerate().map(of).collect();
    FeatureSet {
        name: "test".into(),
        reductions: vec![identity(); 4],
        views,
    }
}

/// The views of [`cameras`].
pub fn views(width: usize, height: usize) -> Vec<View> {
    cameras(width, height)
        .into_iter()
        .enumerate()
        .map(|(i, c)| view(format!("v{i}"), c))
        .collect()
}

/// Writes an NPY file of f32.
pub fn write_npy(path: &Path, shape: &[u64], values: &[f32]) {
    use npyz::WriterBuilder;
    let file = std::fs::File::create(path).expect("create");
    let mut writer = npyz::WriteOptions::new()
        .default_dtype()
        .shape(shape)
        .writer(file)
        .begin_nd()
        .expect("header");
    writer.extend(values.iter().copied()).expect("values");
    writer.finish().expect("finish");
}
