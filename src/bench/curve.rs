//! Time against error: each setting of the rasterizer moved alone, against an f64 render with all of them exact.

use super::{Bench, Figure, Findings, Layout, Samples, Section, gaussians_in_words};
use crate::error::Result;
use crate::objects::{RenderOptions, Renderer};
use crate::raster::{Projected, Settings, Splats, eval_sh};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use std::hint::black_box;

/// Views of a pass, at most.
const VIEWS: usize = 4;
/// Stands for an alpha_min of 0, at which every Gaussian would meet every pixel: what a million Gaussians could add below
/// it is less than an f32 can show.
const NEARLY_ZERO: f64 = 1e-14;

/// One point of the curve.
struct Point {
    name: String,
    settings: Settings,
    /// SH terms above this degree are zero.
    sh_degree: usize,
    double: bool,
    seconds: Samples,
}

pub(super) fn measure(bench: &Bench) -> Result<Findings> {
    let effort = &bench.effort;
    let gaussians = bench.subject.gaussians(effort.gaussians)?;
    let cameras = bench.subject.cameras(effort.views.min(VIEWS), effort.size);
    let mut findings = Findings::new(
        Section::Curve,
        vec![
            format!("{}, {}", bench.views_in_words(cameras.len()), gaussians_in_words(gaussians.len())),
            "forward, mean view. Error: absolute, of RGB before clamping (black background), against f64 arithmetic with".into(),
            "alpha_min 1e-14, t_min 0, alpha_max 1. Each line moves one setting away from the configured ones (first line);".into(),
            "near plane and low-pass are left alone: they say what the scene is, not how exactly it is drawn.".into(),
            "f32 on the backend above, the image's way to the host included; f64 on the CPU.".into(),
        ],
    );
    findings.layout = Layout::Grid;
    let default = Settings::from(&bench.config.raster);
    let exact = Settings {
        alpha_min: NEARLY_ZERO,
        t_min: 0.0,
        alpha_max: 1.0,
        ..default
    };
    let wide = Wide::new(&gaussians);
    let reference = cameras
        .iter()
        .map(|camera| wide.render(camera, &exact))
        .collect::<Result<Vec<_>>>()?;

    let mut points = points(&default, &exact, &gaussians);
    let renderer = |degree| {
        Renderer::new(
            truncated(&gaussians, degree),
            None,
            RenderOptions::default(),
            &bench.device,
        )
    };
    let mut cut = (0..=gaussians.sh_degree)
        .map(renderer)
        .collect::<Result<Vec<_>>>()?;
    // Round by round, so that a slow moment of the machine meets all points alike; the first round is warm-up.
    for round in 0..=effort.repeats {
        for point in &mut points {
            let mut samples = Samples::default();
            let renderer = point.renderer(&mut cut)?;
            samples.time(|| {
                for camera in &cameras {
                    if point.double {
                        black_box(wide.render(camera, &point.settings)?);
                    } else {
                        black_box(renderer.frame(camera)?);
                    }
                }
                Ok(())
            })?;
            if round > 0 {
                point.seconds.push(samples.sum());
            }
        }
    }
    let milliseconds = 1e3 / cameras.len().max(1) as f64;
    let default_time = points[0].seconds.median();
    for point in &points {
        let mut error = Error::default();
        let renderer = point.renderer(&mut cut)?;
        for (camera, reference) in cameras.iter().zip(&reference) {
            if point.double {
                error.add(&wide.render(camera, &point.settings)?, reference);
            } else {
                let rgb: Vec<f64> = renderer
                    .frame(camera)?
                    .rgb
                    .iter()
                    .map(|&v| f64::from(v))
                    .collect();
                error.add(&rgb, reference);
            }
        }
        let seconds = &point.seconds;
        findings.figures.extend([
            Figure::measured(&point.name, "time", "ms", &seconds.scaled(milliseconds)),
            Figure::counted(
                &point.name,
                "of the first",
                "x",
                seconds.median() / default_time,
            ),
            Figure::counted(&point.name, "mean error", "", error.mean()),
            Figure::counted(&point.name, "largest error", "", error.largest),
        ]);
    }
    Ok(findings)
}

impl Point {
    /// Of those for each SH degree the one that renders this point, on black.
    fn renderer<'a>(&self, of_degrees: &'a mut [Renderer]) -> Result<&'a mut Renderer> {
        let renderer = &mut of_degrees[self.sh_degree];
        renderer.set_options(RenderOptions {
            settings: self.settings,
            ..RenderOptions::default()
        })?;
        Ok(renderer)
    }
}

/// The settings to try: the configured ones first, then each knob from exact to coarse, then all exact, then f64.
fn points(default: &Settings, exact: &Settings, gaussians: &Gaussians) -> Vec<Point> {
    let full = gaussians.sh_degree;
    let point = |name: String, settings: Settings| Point {
        name,
        settings,
        sh_degree: full,
        double: false,
        seconds: Samples::default(),
    };
    let Settings {
        alpha_min,
        t_min,
        alpha_max,
        ..
    } = *default;
    let named = format!(
        "alpha_min {}, t_min {}, alpha_max {alpha_max}",
        number(alpha_min),
        number(t_min)
    );
    let mut points = vec![point(named, *default)];
    for value in [
        NEARLY_ZERO,
        1.0 / 1024.0,
        1.0 / 255.0,
        1.0 / 128.0,
        1.0 / 64.0,
        1.0 / 32.0,
    ] {
        if value != alpha_min {
            points.push(point(
                format!("alpha_min {}", number(value)),
                Settings {
                    alpha_min: value,
                    ..*default
                },
            ));
        }
    }
    for value in [0.0, 1e-5, 1e-4, 1e-3, 1e-2] {
        if value != t_min {
            points.push(point(
                format!("t_min {}", number(value)),
                Settings {
                    t_min: value,
                    ..*default
                },
            ));
        }
    }
    for value in [1.0, 0.999, 0.99, 0.95] {
        if value != alpha_max {
            points.push(point(
                format!("alpha_max {value}"),
                Settings {
                    alpha_max: value,
                    ..*default
                },
            ));
        }
    }
    for degree in (0..full).filter(|&degree| has_terms_above(gaussians, degree)) {
        points.push(Point {
            sh_degree: degree,
            ..point(format!("SH degree {degree} of {full}"), *default)
        });
    }
    points.push(point("all exact, f32".into(), *exact));
    points.push(Point {
        double: true,
        ..point("as the first, f64".into(), *default)
    });
    points.push(Point {
        double: true,
        ..point("all exact, f64 (the reference)".into(), *exact)
    });
    points
}

/// `1/255` for such numbers below 0.1, `1e-5` for other small ones.
fn number(value: f64) -> String {
    let parts = 1.0 / value.max(f64::MIN_POSITIVE);
    let whole =
        (parts - parts.round()).abs() < 1e-9 * parts && parts.round() % 10.0 != 0.0 && parts < 1e6;
    if whole && parts > 10.0 {
        format!("1/{parts:.0}")
    } else if value > 0.0 && value < 0.01 {
        format!("{value:e}")
    } else {
        value.to_string()
    }
}

fn has_terms_above(gaussians: &Gaussians, degree: usize) -> bool {
    let first = 3 * (degree + 1).pow(2);
    gaussians
        .sh
        .chunks_exact(3 * gaussians.sh_len())
        .any(|row| row[first..].iter().any(|&v| v != 0.0))
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
        let colours = eval_sh(
            &self.means,
            &self.sh,
            self.sh_degree,
            self.sh_degree,
            camera.center.to_array(),
        );
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
    fn add(&mut self, found: &[f64], expected: &[f64]) {
        for (a, b) in found.iter().zip(expected) {
            let difference = (a - b).abs();
            self.sum += difference;
            self.largest = self.largest.max(difference);
        }
        self.count += expected.len();
    }

    fn mean(&self) -> f64 {
        self.sum / self.count.max(1) as f64
    }
}
