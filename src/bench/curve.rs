//! Time against error: each setting of the rasterizer changed alone, against an exact rendering in f64.

use super::{Bench, Findings, Samples};
use crate::error::Result;
use crate::objects::{RenderOptions, Renderer};
use crate::raster::{Projected, Settings, Splats, eval_sh};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use std::hint::black_box;

/// Views of a pass, at most.
const VIEWS: usize = 4;
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
    seconds: Samples,
}

pub(super) fn measure(
    bench: &Bench,
    gaussians: &Gaussians,
    case: &str,
    findings: &mut Findings,
) -> Result<()> {
    let effort = &bench.effort;
    let [width, height] = effort.size;
    let cameras = bench.subject.cameras(effort.views.min(VIEWS), effort.size);
    findings.note(format!(
        "{case}, {} views of {width}x{height} on black; the time of a view with its way to host memory",
        cameras.len()
    ));
    findings.note(
        "error: absolute, of RGB, against f64 with alpha_min 1e-14, t_min 0, alpha_max 1. The first line has the",
    );
    findings.note("configured settings; each other line changes one of them.");
    let default = Settings::from(&bench.config.raster);
    let exact = Settings {
        alpha_min: NEARLY_ZERO,
        t_min: 0.0,
        alpha_max: 1.0,
        ..default
    };
    let wide = Wide::new(gaussians);
    let reference = cameras
        .iter()
        .map(|camera| wide.render(camera, &exact))
        .collect::<Result<Vec<_>>>()?;
    let mut points = points(&default, &exact, gaussians.sh_degree);
    let mut renderers = (0..=gaussians.sh_degree)
        .map(|degree| {
            let gaussians = truncated(gaussians, degree);
            Renderer::new(gaussians, None, RenderOptions::default(), &bench.device)
        })
        .collect::<Result<Vec<_>>>()?;
    // Round by round, so that a slow moment of the machine meets all points alike. The first round is the warm-up.
    for round in 0..=effort.repeats {
        for point in &mut points {
            let renderer = point.renderer(&mut renderers)?;
            let mut samples = Samples::default();
            samples.time(|| {
                cameras.iter().try_for_each(|camera| {
                    black_box(renderer.frame(camera)?);
                    Ok(())
                })
            })?;
            if round > 0 {
                point.seconds.push(samples.sum());
            }
        }
    }
    let first = points[0].seconds.median();
    for point in &points {
        let mut error = Error::default();
        let renderer = point.renderer(&mut renderers)?;
        for (camera, reference) in cameras.iter().zip(&reference) {
            error.add(&renderer.frame(camera)?.rgb, reference);
        }
        let (name, seconds) = (&point.name, &point.seconds);
        let time = seconds.scaled(1e3 / cameras.len().max(1) as f64);
        findings.measured(name, "time", "ms", &time);
        findings.counted(name, "of the first", "", seconds.median() / first);
        findings.counted(name, "mean error", "", error.sum / error.count as f64);
        findings.counted(name, "largest error", "", error.largest);
    }
    Ok(())
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
fn points(default: &Settings, exact: &Settings, sh_degree: usize) -> Vec<Point> {
    let point = |name: String, settings: Settings| Point {
        name,
        settings,
        sh_degree,
        seconds: Samples::default(),
    };
    let alpha_min = ALPHA_MIN.map(|value| {
        let settings = Settings {
            alpha_min: value,
            ..*default
        };
        (format!("alpha_min {}", number(value)), settings)
    });
    let t_min = T_MIN.map(|value| {
        let settings = Settings {
            t_min: value,
            ..*default
        };
        (format!("t_min {}", number(value)), settings)
    });
    let alpha_max = ALPHA_MAX.map(|value| {
        let settings = Settings {
            alpha_max: value,
            ..*default
        };
        (format!("alpha_max {value}"), settings)
    });
    let changed = alpha_min.into_iter().chain(t_min).chain(alpha_max);
    let mut points = vec![point("as configured".into(), *default)];
    points.extend(
        changed
            .filter(|(_, settings)| settings != default)
            .map(|(name, settings)| point(name, settings)),
    );
    points.extend((0..sh_degree).map(|degree| Point {
        sh_degree: degree,
        ..point(format!("SH degree {degree} of {sh_degree}"), *default)
    }));
    points.push(point("all exact".into(), *exact));
    points
}

/// `1/255` for such a number, `1e-5` for other small ones.
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

/// Without the SH terms above `degree`.
fn truncated(gaussians: &Gaussians, degree: usize) -> Gaussians {
    let kept = 3 * (degree + 1).pow(2);
    let rows = gaussians.sh.chunks_exact(3 * gaussians.sh_len());
    Gaussians {
        sh: rows.flat_map(|row| &row[..kept]).copied().collect(),
        sh_degree: degree,
        ..gaussians.clone()
    }
}

/// The same numbers as f64.
struct Wide {
    means: Vec<f64>,
    log_scales: Vec<f64>,
    rotations: Vec<f64>,
    opacity_logits: Vec<f64>,
    sh: Vec<f64>,
    sh_degree: usize,
}

impl Wide {
    fn new(g: &Gaussians) -> Self {
        let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect();
        Self {
            means: wide(g.means.as_flattened()),
            log_scales: wide(g.log_scales.as_flattened()),
            rotations: wide(g.rotations.as_flattened()),
            opacity_logits: wide(&g.opacity_logits),
            sh: wide(&g.sh),
            sh_degree: g.sh_degree,
        }
    }

    /// `[H, W, 3]` on black.
    fn render(&self, camera: &Camera, settings: &Settings) -> Result<Vec<f64>> {
        let splats = Splats {
            means: &self.means[..],
            log_scales: &self.log_scales,
            rotations: &self.rotations,
            opacity_logits: &self.opacity_logits,
        };
        let projected = Projected::new(&splats, camera, settings)?;
        let degree = self.sh_degree;
        let center = camera.center.to_array();
        let colours = eval_sh(&self.means, &self.sh, degree, degree, center);
        Ok(projected.blend(&colours, 3).image)
    }
}

/// Absolute differences.
#[derive(Default)]
struct Error {
    sum: f64,
    count: usize,
    largest: f64,
}

impl Error {
    fn add(&mut self, found: &[f32], expected: &[f64]) {
        for (a, b) in found.iter().zip(expected) {
            let difference = (f64::from(*a) - b).abs();
            self.sum += difference;
            self.largest = self.largest.max(difference);
        }
        self.count += expected.len();
    }
}
