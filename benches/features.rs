//! Seconds per photo of a feature extractor, eight photos side by side as in a run:
//! `cargo bench --bench features -- descriptor`, or `-- mobilenetv2 WEIGHTS`, or `-- dino WEIGHTS`. The environment variable
//! `BACKEND` chooses the device.

use coseg::backend::device;
use coseg::features::{descriptor, dino::Vit, mobilenet::MobileNetV2};
use image::RgbImage;
use rayon::prelude::*;
use std::path::Path;
use std::time::Instant;

const PHOTOS: u32 = 8;

fn main() -> coseg::Result<()> {
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| argument != "--bench")
        .collect();
    let name = std::env::var("BACKEND").ok();
    let device = device::open(name.and_then(|name| name.parse().ok()))?;
    let extract: Box<dyn Fn(&RgbImage) + Sync> = match arguments.as_slice() {
        [source, path] if source == "mobilenetv2" => {
            let net = MobileNetV2::load(Path::new(path), &device)?;
            Box::new(move |image| drop(net.maps(image).expect("finite activations")))
        }
        [source, path] if source == "dino" => {
            let net = Vit::load(Path::new(path), &device)?;
            Box::new(move |image| drop(net.maps(image).expect("finite activations")))
        }
        _ => Box::new(|image| drop(descriptor::describe(image, 4))),
    };
    for (width, height) in [(480, 360), (960, 540)] {
        let photos: Vec<RgbImage> = (0..PHOTOS).map(|n| picture(width, height, n)).collect();
        extract(&photos[0]);
        let start = Instant::now();
        photos.par_iter().for_each(&extract);
        let seconds = start.elapsed().as_secs_f64() / f64::from(PHOTOS);
        let threads = rayon::current_num_threads();
        println!("{width} x {height}, {threads} threads: {seconds:.3} s a photo");
    }
    Ok(())
}

/// Noise over a gradient.
fn picture(width: u32, height: u32, seed: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let noise = (x ^ y.rotate_left(9) ^ seed.rotate_left(20)).wrapping_mul(2_654_435_761) >> 24;
        image::Rgb([x * 255 / width, (noise + y * 255 / height) / 2, noise].map(|v| v as u8))
    })
}
