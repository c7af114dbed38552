//! How far f32 may be from f64, where rounding may turn a decision, and how far it is.

use crate::support::raster_reference::{Decision, Doubt};
use coseg::raster::Settings;
use coseg::splat::camera::Camera;

/// Decisions closer than this to a cut-off, or to another order of depths, may go either way in f32.
const CUT_ROUNDING: f64 = 1e-4;
const DEPTH_ROUNDING: f64 = 1e-5;
/// How much a picture may be off, relative to its largest value, and a gradient, relative to its root mean square or its value.
const PICTURE: f64 = 1e-4;
const GRADIENT: f64 = 1e-3;
/// A GPU rounds a position in an image of `width` pixels by up to `width` times this. At the edge of the smallest splat, of a standard
/// deviation of 0.55 pixels, that moves alpha' and gradients by up to six times as much of their values.
const POSITION_ROUNDING: f64 = 1.0 / (1_u64 << 23) as f64;
const ALPHA_PER_POSITION: f64 = 6.0;
/// How far f32 may be from f64.
pub struct Contract {
    /// Relative distance from a cut-off within which either side is right.
    pub cut: f64,
    pub picture: f64,
    pub gradient: f64,
}

impl Contract {
    /// The CPU computes positions in f64, so only a GPU may round them.
    pub fn of(camera: &Camera, is_gpu: bool) -> Self {
        let width = camera.width.max(camera.height) as f64;
        let position = if is_gpu {
            POSITION_ROUNDING * width
        } else {
            0.0
        };
        Self {
            cut: CUT_ROUNDING.max(ALPHA_PER_POSITION * position),
            picture: PICTURE.max(position),
            gradient: GRADIENT.max(ALPHA_PER_POSITION * position),
        }
    }

    pub fn bound(&self, part: usize) -> f64 {
        if part < 2 {
            self.picture
        } else {
            self.gradient
        }
    }

    /// Whether f32 may decide otherwise.
    pub fn may_turn(&self, doubt: &Doubt) -> bool {
        let rounding = match doubt.decision {
            Decision::Cut | Decision::Cap => self.cut,
            Decision::Order => DEPTH_ROUNDING,
        };
        doubt.distance <= rounding
    }

    /// Both sides of the cut-offs.
    pub fn sides(&self, settings: &Settings) -> [Settings; 4] {
        let [below, above] = [1.0 - self.cut, 1.0 + self.cut];
        let alpha = |factor| Settings {
            alpha_min: settings.alpha_min * factor,
            ..*settings
        };
        let transmittance = |factor| Settings {
            t_min: settings.t_min * factor,
            ..*settings
        };
        [
            alpha(below),
            alpha(above),
            transmittance(below),
            transmittance(above),
        ]
    }
}

/// The largest difference between the gradients `got` and `want`, relative to the value or to the root mean square of all, whichever
/// is larger.
pub fn gradient_error(got: &[f64], want: &[f64]) -> f64 {
    let rms = (want.iter().map(|v| v * v).sum::<f64>() / want.len().max(1) as f64).sqrt();
    let errors = got.iter().zip(want).map(|(g, w)| {
        let difference = (g - w).abs();
        if difference == 0.0 {
            0.0
        } else {
            difference / w.abs().max(rms)
        }
    });
    errors.fold(0.0, f64::max)
}

/// Image and transmittance.
pub type Picture = [Vec<f64>; 2];

/// The largest differences between the picture `got` and the first of `sides`, relative to its largest values; the other sides have a
/// cut-off moved. A pixel with one cut in doubt may be that of any side. One with several, or with two Gaussians in another order, may be
/// off by what these change, where a colour moves by `jump` for a change of 1.
pub fn picture_errors(
    got: [&[f64]; 2],
    sides: &[Picture],
    doubts: &[Vec<Doubt>],
    contract: &Contract,
    jump: f64,
) -> [f64; 2] {
    let mut worst = [0.0_f64; 2];
    for (pixel, doubts) in doubts.iter().enumerate() {
        let off = |side: &Picture| {
            [0, 1].map(|part| {
                let channels = got[part].len() / got[1].len();
                let of_pixel = pixel * channels..(pixel + 1) * channels;
                let pairs = got[part][of_pixel.clone()]
                    .iter()
                    .zip(&side[part][of_pixel]);
                pairs.map(|(g, w)| (g - w).abs()).fold(0.0, f64::max)
            })
        };
        let turning: Vec<_> = doubts
            .iter()
            .filter(|doubt| doubt.decision != Decision::Cap && contract.may_turn(doubt))
            .collect();
        let difference = match &turning[..] {
            [only] if only.decision == Decision::Cut => {
                let nearest = sides.iter().map(off);
                let nearest = nearest.min_by(|a, b| a[0].max(a[1]).total_cmp(&b[0].max(b[1])));
                nearest.expect("one side or more")
            }
            turning => {
                let sum = |of: &dyn Fn(&Doubt) -> bool| -> f64 {
                    let jumps = turning.iter().filter(|doubt| of(doubt));
                    jumps.map(|doubt| doubt.jump).sum()
                };
                let [image, transmittance] = off(&sides[0]);
                [
                    image - jump * sum(&|_| true),
                    transmittance - sum(&|doubt| doubt.decision == Decision::Cut),
                ]
            }
        };
        worst = [0, 1].map(|part| worst[part].max(difference[part]));
    }
    [0, 1].map(|part| {
        let largest = sides[0][part].iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        if worst[part] == 0.0 {
            0.0
        } else {
            worst[part] / largest
        }
    })
}
