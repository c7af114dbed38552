//! Per-pixel features of your own on Gaussians: lifted from training views, rendered in a view that gave none.
//!
//! For fixed Gaussians rendering is a linear map, S = W s; its adjoint, W^T F, carries features of pixels back to
//! Gaussians. Here a feature is the one-hot class of a pixel, so that what comes out can be scored.
//!
//! For a run of the built-in room, whose photos and true labels are made anew; `coseg::data::load` reads a folder instead.
//!
//!     cargo run --release -- train                       # writes runs/builtin
//!     cargo run --release --example lift_features -- runs/builtin
use coseg::data::Split;
use coseg::data::builtin;
use coseg::raster::{Projected, Settings};
use coseg::splat::ply;
use coseg::splat::ply::PlyScene;
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let run = std::env::args()
        .nth(1)
        .unwrap_or_else(|| "runs/builtin".to_owned());
    let PlyScene {
        gaussians, origin, ..
    } = ply::read(&Path::new(&run).join("scene.ply"))?;
    let scene = builtin::scene(builtin::EVALUATED_SEED);
    if origin != scene.origin {
        return Err(format!("{run}: not a run of the built-in room").into()); // else cameras move by -origin
    }
    let n = gaussians.len();
    let channels = scene.classes.len();

    // s = W^T F / W^T 1, summed over the training views
    let (mut sums, mut weights) = (vec![0.0_f32; n * channels], vec![0.0_f32; n]);
    for view in scene.split(Split::Train) {
        let Some(raw) = &view.raw else { continue };
        let projected = Projected::new(&gaussians.splats(), &view.camera, &Settings::default())?;
        let ids = raw.map().ids;
        let mut image = vec![0.0; ids.len() * channels];
        for (pixel, id) in image.chunks_exact_mut(channels).zip(&ids) {
            if let Some(class) = scene.classes.index(*id) {
                pixel[class] = 1.0;
            }
        }
        let lifted = projected.blend_adjoint(&image, channels);
        sums.iter_mut().zip(&lifted).for_each(|(sum, v)| *sum += v);
        weights
            .iter_mut()
            .zip(projected.weight_sums())
            .for_each(|(sum, w)| *sum += w);
    }
    for (row, weight) in sums.chunks_exact_mut(channels).zip(&weights) {
        row.iter_mut().for_each(|v| *v /= weight.max(1e-6));
    }

    let (mut right, mut counted) = (0_usize, 0_usize);
    for view in scene.split(Split::Test) {
        let Some(truth) = &view.truth else { continue };
        let projected = Projected::new(&gaussians.splats(), &view.camera, &Settings::default())?;
        let blended = projected.blend(&sums, channels);
        for (pixel, id) in blended.image.chunks_exact(channels).zip(&truth.map().ids) {
            let Some(class) = scene.classes.index(*id) else {
                continue;
            };
            let best = (0..channels).max_by(|&a, &b| pixel[a].total_cmp(&pixel[b]));
            right += usize::from(best == Some(class));
            counted += 1;
        }
    }
    println!(
        "{n} Gaussians, {channels} channels: {:.1} % of held-out pixels right",
        100.0 * right as f64 / counted as f64
    );
    Ok(())
}
