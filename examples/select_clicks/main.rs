//! How well two clicks select a thing: random pairs of clicks on it, whose selections are compared with masks of views that were
//! not clicked. With the image features of the run, if it has lifted some, and without.
//!
//! Masks are polygons in a JSON file, or the instance maps NAME.png of all frames of the run in a folder. `fox.json` has masks of
//! the fox in the scene `fox` of instant-ngp: the fur, without the board.
//!
//!     cargo run --release -- train --data fox --set data.transforms=transforms_4.json --set 'segmentation.rows=[]' --out runs/fox
//!     cargo run --release --example select_clicks -- runs/fox examples/select_clicks/fox.json
//!     cargo run --release --example select_clicks -- runs/room room/instances

mod masks;

use coseg::data::{NamedCamera, read_cameras};
use coseg::objects::{Growth, Regions, seed};
use coseg::raster::{Projected, Settings};
use coseg::runs::features_beside;
use coseg::splat::{Gaussians, ply};
use masks::{Mask, Thing};
use rand::Rng;
use rand::SeedableRng;
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use std::error::Error;
use std::path::Path;

/// Pairs of clicks on a thing that is the only one, and on each of several.
const PAIRS: [usize; 2] = [20, 5];

/// What a camera of the run sees.
struct View {
    projected: Projected<f32>,
    /// Coverage of each pixel.
    alpha: Vec<f32>,
}

impl View {
    fn new(named: &NamedCamera, scene: &ply::PlyScene) -> Result<Self, Box<dyn Error>> {
        let camera = named.camera.moved(-scene.origin);
        let projected = Projected::new(&scene.gaussians.splats(), &camera, &Settings::default())?;
        let ones = vec![1.0; scene.gaussians.len()];
        Ok(Self {
            alpha: projected.blend(&ones, 1).image,
            projected,
        })
    }

    /// IoU of the mask and the pixels to which `selected` contributes most.
    fn iou(&self, selected: &[f32], mask: &Mask) -> f64 {
        let image = self.projected.blend(selected, 1).image;
        let (mut both, mut either) = (0, 0);
        for ((share, alpha), inside) in image.iter().zip(&self.alpha).zip(&mask.inside) {
            let shown = *share > 0.5 * alpha.max(0.5);
            both += usize::from(shown && *inside);
            either += usize::from(shown || *inside);
        }
        both as f64 / either as f64
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [run, masks] = arguments.as_slice() else {
        return Err("give a run folder, and a file or folder of masks".into());
    };
    let path = Path::new(run).join("scene.ply");
    let scene = ply::read(&path)?;
    let cameras = read_cameras(&Path::new(run).join("cameras.json"), None)?;
    let views = cameras.iter().map(|camera| View::new(camera, &scene));
    let views: Vec<View> = views.collect::<Result<_, _>>()?;
    let things = masks::read(Path::new(masks), &cameras)?;
    let features = features_beside(&path, scene.gaussians.len());
    let clicks = clicks(&things, &views);
    println!("{} things, {} pairs of clicks", things.len(), clicks.len());
    let regions = Regions::new(&scene.gaussians, &[])?;
    let ious = |regions: &Regions| ious(&clicks, regions, &views, &scene.gaussians);
    println!("colours and normals: {}", summary(ious(&regions)));
    if !features.is_empty() {
        let regions = Regions::new(&scene.gaussians, &features)?;
        println!("and image features: {}", summary(ious(&regions)));
    }
    Ok(())
}

/// Random pairs of clicks, each in two views of the thing: the Gaussians that they show.
fn clicks<'a>(things: &'a [Thing], views: &[View]) -> Vec<(&'a Thing, Vec<u32>)> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut clicks = Vec::new();
    for thing in things {
        for _ in 0..PAIRS[usize::from(things.len() > 1)] {
            let mut seeds = Vec::new();
            for mask in sample(&mut rng, thing.clicked.len(), 2) {
                let mask = &thing.clicked[mask];
                let projected = &views[mask.view].projected;
                let pixels = mask.pixels();
                let pixel = pixels[rng.random_range(0..pixels.len())];
                let width = projected.size()[0];
                seeds.extend(seed([pixel % width, pixel / width], projected));
            }
            // Both may be on the background.
            if !seeds.is_empty() {
                clicks.push((thing, seeds));
            }
        }
    }
    clicks
}

/// Of each pair the mean over the judged views, at the proposed threshold.
fn ious(
    clicks: &[(&Thing, Vec<u32>)],
    regions: &Regions,
    views: &[View],
    gaussians: &Gaussians,
) -> Vec<f64> {
    let iou = |(thing, seeds): &(&Thing, Vec<u32>)| {
        let growth = Growth::new(regions, seeds);
        let mut selected = vec![0.0; gaussians.len()];
        for row in growth.rows(growth.proposed) {
            selected[row as usize] = 1.0;
        }
        let judged = thing.judged.iter();
        let sum: f64 = judged
            .map(|mask| views[mask.view].iou(&selected, mask))
            .sum();
        sum / thing.judged.len() as f64
    };
    clicks.iter().map(iou).collect()
}

fn summary(mut ious: Vec<f64>) -> String {
    if ious.is_empty() {
        return "no click shows a Gaussian".to_owned();
    }
    ious.sort_by(f64::total_cmp);
    let median = 0.5 * (ious[(ious.len() - 1) / 2] + ious[ious.len() / 2]);
    let mean = ious.iter().sum::<f64>() / ious.len() as f64;
    format!("median IoU {median:.3}, mean {mean:.3}")
}
