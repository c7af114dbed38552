//! Finite differences, and how close gradients have to be to them.
//!
//! The contract: |analytic - numeric| <= 1e-6 max(|analytic|, rms of the tensor); a NaN fails, and a gradient that is
//! 1 % off must be caught.

use crate::support::raster_reference::{Cloud, numbers};
use coseg::raster::{PixelGradients, Projected, Settings, SplatGradients};
use coseg::splat::camera::Camera;

/// `Err` names the first entry that breaks the contract.
fn agree(analytic: &[f64], numeric: &[f64]) -> Result<(), String> {
    assert_eq!(analytic.len(), numeric.len());
    let rms = (numeric.iter().map(|v| v * v).sum::<f64>() / numeric.len() as f64).sqrt();
    for (i, (&a, &n)) in analytic.iter().zip(numeric).enumerate() {
        let within = (a - n).abs() <= 1e-6 * a.abs().max(rms);
        if !(a.is_finite() && n.is_finite() && within) {
            return Err(format!("entry {i}: analytic {a}, numeric {n}, rms {rms}"));
        }
    }
    Ok(())
}

/// [`agree`], and that it would have seen a corrupted gradient.
pub fn check(what: &str, analytic: &[f64], numeric: &[f64]) {
    agree(analytic, numeric).unwrap_or_else(|e| panic!("{what}: {e}"));
    assert!(
        analytic.iter().any(|&a| a != 0.0),
        "{what}: all zero, the check would be empty"
    );
    let off: Vec<f64> = analytic.iter().map(|a| a * 1.01).collect();
    assert!(
        agree(&off, numeric).is_err(),
        "{what}: a gradient 1 % off goes unnoticed"
    );
    let mut broken = analytic.to_vec();
    broken[0] = f64::NAN;
    assert!(
        agree(&broken, numeric).is_err(),
        "{what}: a NaN goes unnoticed"
    );
}

/// Central differences of `f` at every entry of `x`, with a relative step in the entry's own size.
pub fn differences(x: &[f64], step: f64, mut f: impl FnMut(&[f64]) -> f64) -> Vec<f64> {
    let mut x = x.to_vec();
    (0..x.len())
        .map(|i| {
            let x0 = x[i];
            let mut at = |k: f64| {
                x[i] = x0 + k * step;
                f(&x)
            };
            // Five points: the error is of fourth order in the step.
            let d = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * step);
            x[i] = x0;
            d
        })
        .collect()
}

/// A linear loss over image and transmittance.
pub struct Loss {
    pub image: Vec<f64>,
    pub transmittance: Vec<f64>,
}

impl Loss {
    pub fn new(camera: &Camera, channels: usize) -> Self {
        let pixels = camera.width * camera.height;
        Self {
            image: numbers(pixels * channels, 77),
            transmittance: numbers(pixels, 78),
        }
    }

    pub fn of(&self, image: &[f64], transmittance: &[f64]) -> f64 {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        dot(&self.image, image) + dot(&self.transmittance, transmittance)
    }
}

/// Without a cut-off that matters.
pub const SMOOTH: Settings = Settings {
    alpha_max: 1.0,
    alpha_min: 1e-14,
    t_min: 0.0,
    near: 0.01,
    low_pass: 0.3,
};

pub fn loss_of(
    c: &Cloud,
    values: &[f64],
    channels: usize,
    camera: &Camera,
    s: &Settings,
    loss: &Loss,
) -> f64 {
    let out = Projected::new(&c.splats(), camera, s)
        .expect("valid")
        .blend(values, channels);
    loss.of(&out.image, &out.transmittance)
}

/// Analytic gradients of a loss.
pub fn gradients(
    c: &Cloud,
    values: &[f64],
    channels: usize,
    camera: &Camera,
    s: &Settings,
    l: &Loss,
) -> SplatGradients<f64> {
    let projected = Projected::new(&c.splats(), camera, s).expect("valid");
    let forward = projected.blend(values, channels);
    let pixels = PixelGradients {
        image: &forward.image,
        transmittance: &forward.transmittance,
        d_image: &l.image,
        d_transmittance: Some(&l.transmittance),
    };
    projected.backward(&c.splats(), values, channels, pixels, false)
}
