//! Time against error: each setting of the rasterizer changed alone, against an exact rendering in f64.

use super::figures::timed;
use super::{Bench, Figures};
use crate::error::Result;
use crate::objects::{RenderOptions, Renderer};
use crate::raster::{Projected, Settings, Splats, eval_sh};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use std::hint::black_box;

/// Views of a pass, at most, and their size.
const VIEWS: usize = 4;
const SIZE: [usize; 2] = [480, 360];
/// Stands for an alpha_min of 0, at which every Gaussian would meet every pixel. What a million Gaussians could add below
/// it is less than an f32 can show.
const NEARLY_ZERO: f64 = 1e-14;
const ALPHA_MIN: [f64; 6] = [
    NEARLY_ZERO,
    1.0 / 1024.0,
    1.0 / 255.0,
    1.0 / 128.0,
    1.0 / 64.0,
    1.0 / 32.0,
];
const T_MIN: [f64; 5] = [0.0, 1e-5, 1e-4, 1e-3, 1e-2];
const ALPHA_MAX: [f64; 4] = [1.0, 0.999, 0.99, 0.95];

/// One point of the curve.
struct Point {
    name: String,
    settings: Settings,
    sh_degree: usize,
    /// Milliseconds of a view, for each pass over the views.
    times: Vec<f64>,
}

pub(super) fn measure(bench: &Bench, gaussians: &Gaussians) -> Result<Figures> {
    let cameras = cameras(bench);
    let [width, height] = SIZE;
    let mut figures = Figures::new("curve", gaussians.len());
    figures.notes.push(format!(
        "{} views of {width}x{height} on black; the time of a view, until it is in host memory",
        cameras.len()
    ));
    figures.notes.push(
        "error: absolute, of RGB, against f64 with alpha_min 1e-14, t_min 0, alpha_max 1"
            .to_owned(),
    );
    figures
        .notes
        .push("each line changes one of the configured settings".to_owned());
    let configured = Settings::from(&bench.config.raster);
    let exact = Settings {
        alpha_min: NEARLY_ZERO,
        t_min: 0.0,
        alpha_max: 1.0,
        ..configured
    };
    let reference = cameras
        .iter()
        .map(|camera| render_wide(gaussians, camera, &exact))
        .collect::<Result<Vec<_>>>()?;
    let mut points = points(&configured, &exact, gaussians.sh_degree);
    let mut renderers = (0..=gaussians.sh_degree)
        .map(|degree| {
            let gaussians = gaussians.clone().with_sh_degree(degree);
            Renderer::new(gaussians, None, RenderOptions::default(), &bench.device)
        })
        .collect::<Result<Vec<_>>>()?;
    // Round by round, so that a slow moment of the machine meets all points alike. The first round is the warm-up.
    for round in 0..=bench.repeats {
        for point in &mut points {
            let renderer = point.renderer(&mut renderers)?;
            let mut seconds = Vec::new();
            timed(&mut seconds, || {
                cameras.iter().try_for_each(|camera| {
                    black_box(renderer.frame(camera)?);
                    Ok(())
                })
            })?;
            if round > 0 {
                let of_view = |seconds: f64| 1e3 * seconds / cameras.len() as f64;
                point.times.extend(seconds.into_iter().map(of_view));
            }
        }
    }
    for point in &points {
        let renderer = point.renderer(&mut renderers)?;
        let mut sum = 0.0;
        let mut count = 0;
        let mut largest = 0.0_f64;
        for (camera, reference) in cameras.iter().zip(&reference) {
            for (found, exact) in renderer.frame(camera)?.rgb.iter().zip(reference) {
                let difference = (f64::from(*found) - exact).abs();
                sum += difference;
                count += 1;
                largest = largest.max(difference);
            }
        }
        figures.add(&point.name, "ms", &point.times);
        if let Some(figure) = figures.figures.last_mut() {
            figure.error = Some([sum / count as f64, largest]);
        }
    }
    Ok(figures)
}

/// Some of the training cameras, evenly chosen.
fn cameras(bench: &Bench) -> Vec<Camera> {
    let views = &bench.scene.views;
    let count = VIEWS.min(views.len());
    (0..count)
        .map(|i| {
            views[i * views.len() / count]
                .camera
                .with_size(SIZE[0], SIZE[1])
        })
        .collect()
}

impl Point {
    /// The renderer of this point's SH degree, with this point's settings.
    fn renderer<'a>(&self, of_degrees: &'a mut [Renderer]) -> Result<&'a mut Renderer> {
        let renderer = &mut of_degrees[self.sh_degree];
        renderer.set_options(RenderOptions {
            settings: self.settings,
            ..RenderOptions::default()
        })?;
        Ok(renderer)
    }
}

/// The settings to try: the configured ones, then each setting from exact to coarse, then all exact.
fn points(configured: &Settings, exact: &Settings, sh_degree: usize) -> Vec<Point> {
    let changed = |name: String, change: &dyn Fn(&mut Settings)| {
        let mut settings = *configured;
        change(&mut settings);
        (name, settings)
    };
    let alpha_min =
        ALPHA_MIN.map(|v| changed(format!("alpha_min {}", number(v)), &|s| s.alpha_min = v));
    let t_min = T_MIN.map(|v| changed(format!("t_min {}", number(v)), &|s| s.t_min = v));
    let alpha_max = ALPHA_MAX.map(|v| changed(format!("alpha_max {v}"), &|s| s.alpha_max = v));
    let mut tried: Vec<_> = alpha_min
        .into_iter()
        .chain(t_min)
        .chain(alpha_max)
        .collect();
    tried.push(("all exact".to_owned(), *exact));
    tried.retain(|(_, settings)| settings != configured);
    let point = |(name, settings)| Point {
        name,
        settings,
        sh_degree,
        times: Vec::new(),
    };
    let mut points = vec![point(("as configured".to_owned(), *configured))];
    points.extend(tried.into_iter().map(point));
    points.extend((0..sh_degree).map(|degree| Point {
        sh_degree: degree,
        ..point((format!("SH degree {degree} of {sh_degree}"), *configured))
    }));
    points
}

/// A number as `1/255` where it is the reciprocal of a whole number, else as `1e-5` where it is small.
fn number(value: f64) -> String {
    let parts = (1.0 / value).round();
    if (10.0..1e4).contains(&parts) && parts % 10.0 != 0.0 && value == 1.0 / parts {
        format!("1/{parts}")
    } else if value > 0.0 && value < 0.01 {
        format!("{value:e}")
    } else {
        value.to_string()
    }
}

/// `[H, W, 3]` on black, in f64.
fn render_wide(gaussians: &Gaussians, camera: &Camera, settings: &Settings) -> Result<Vec<f64>> {
    let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();
    let means = wide(gaussians.means.as_flattened());
    let splats = Splats {
        means: &means[..],
        log_scales: &wide(gaussians.log_scales.as_flattened()),
        rotations: &wide(gaussians.rotations.as_flattened()),
        opacity_logits: &wide(&gaussians.opacity_logits),
    };
    let projected = Projected::new(&splats, camera, settings)?;
    let degree = gaussians.sh_degree;
    let center = camera.center.to_array();
    let colours = eval_sh(&means, &wide(&gaussians.sh), degree, degree, center);
    Ok(projected.blend(&colours, 3).image)
}
