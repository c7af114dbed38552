//! How well two clicks select a thing: random pairs of clicks inside masks drawn by hand, the selections of which are compared with
//! masks of views that were not clicked.
//!
//! `fox.json` has masks of the fox in the scene `fox` of instant-ngp: the fur, without the board. A mask is a polygon, its corners in
//! units of an image of `size`. Give another file for another thing.
//!
//!     cargo run --release -- train --data fox --set data.transforms=transforms_4.json --set 'segmentation.rows=[]' --out runs/fox
//!     cargo run --release --example select_clicks -- runs/fox

use coseg::data::{Limits, NamedCamera, read_cameras};
use coseg::objects::{Growth, Regions, seed};
use coseg::raster::{Projected, Settings};
use coseg::splat::{Gaussians, ply};
use rand::{Rng, SeedableRng};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;

/// Pairs of clicks.
const PAIRS: usize = 20;

#[derive(Deserialize)]
struct Masks {
    size: [f64; 2],
    clicked: BTreeMap<String, Vec<[f64; 2]>>,
    judged: BTreeMap<String, Vec<[f64; 2]>>,
}

/// A view with its mask.
struct Drawn {
    projected: Projected<f32>,
    inside: Vec<bool>,
    /// Coverage of each pixel.
    alpha: Vec<f32>,
}

impl Drawn {
    /// IoU of the pixels of which `selected` gives most with the mask.
    fn iou(&self, selected: &[f32]) -> f64 {
        let image = self.projected.blend(selected, 1).image;
        let (mut both, mut either) = (0, 0);
        for ((share, alpha), inside) in image.iter().zip(&self.alpha).zip(&self.inside) {
            let shown = *share > 0.5 * alpha.max(0.5);
            both += usize::from(shown && *inside);
            either += usize::from(shown || *inside);
        }
        both as f64 / either as f64
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let run = arguments.next().unwrap_or_else(|| "runs/fox".to_owned());
    let text = match arguments.next() {
        Some(file) => std::fs::read_to_string(file)?,
        None => include_str!("fox.json").to_owned(),
    };
    let masks: Masks = serde_json::from_str(&text)?;
    let scene = ply::read(&Path::new(&run).join("scene.ply"), &Limits::default())?;
    let cameras = read_cameras(&Path::new(&run).join("cameras.json"), None)?;
    let draw = |(name, polygon): (&String, &Vec<[f64; 2]>)| -> Result<Drawn, Box<dyn Error>> {
        let named = cameras.iter().find(|camera| camera.name == *name);
        let NamedCamera { camera, .. } = named.ok_or_else(|| format!("no frame {name}"))?;
        let (width, height) = (camera.width, camera.height);
        let scale = [width as f64 / masks.size[0], height as f64 / masks.size[1]];
        let center = |i: usize| [(i % width) as f64 + 0.5, (i / width) as f64 + 0.5];
        let at = |i| [0, 1].map(|axis| center(i)[axis] / scale[axis]);
        let camera = camera.moved(-scene.origin);
        let projected = Projected::new(&scene.gaussians.splats(), &camera, &Settings::default())?;
        let ones = vec![1.0; scene.gaussians.len()];
        Ok(Drawn {
            alpha: projected.blend(&ones, 1).image,
            inside: (0..width * height)
                .map(|i| is_inside(at(i), polygon))
                .collect(),
            projected,
        })
    };
    let clicked = masks
        .clicked
        .iter()
        .map(draw)
        .collect::<Result<Vec<_>, _>>()?;
    let judged = masks
        .judged
        .iter()
        .map(draw)
        .collect::<Result<Vec<_>, _>>()?;
    let regions = Regions::new(&scene.gaussians)?;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let mut ious = Vec::new();
    for _ in 0..PAIRS {
        let mut seeds = Vec::new();
        for view in &clicked {
            let pixels: Vec<usize> = (0..view.inside.len()).filter(|&i| view.inside[i]).collect();
            if pixels.is_empty() {
                return Err("a mask without pixels".into());
            }
            let pixel = pixels[rng.random_range(0..pixels.len())];
            let width = view.projected.size()[0];
            seeds.extend(seed([pixel % width, pixel / width], &view.projected));
        }
        if seeds.is_empty() {
            println!("a pair of clicks on the background is left out");
            continue;
        }
        let growth = Growth::new(&regions, &seeds);
        ious.push(mean_iou(&judged, &growth, &scene.gaussians));
    }
    if ious.is_empty() {
        return Err("no click shows a Gaussian".into());
    }
    println!("{}", summary(ious));
    Ok(())
}

/// Mean over the judged views, at the proposed threshold.
fn mean_iou(judged: &[Drawn], growth: &Growth, gaussians: &Gaussians) -> f64 {
    let mut selected = vec![0.0; gaussians.len()];
    for row in growth.rows(growth.proposed) {
        selected[row as usize] = 1.0;
    }
    let sum: f64 = judged.iter().map(|view| view.iou(&selected)).sum();
    sum / judged.len() as f64
}

/// Whether a ray from the point to the right crosses the polygon an odd number of times.
fn is_inside([x, y]: [f64; 2], polygon: &[[f64; 2]]) -> bool {
    let next = polygon.iter().cycle().skip(1);
    let crosses = polygon.iter().zip(next).filter(|([ax, ay], [bx, by])| {
        (*ay > y) != (*by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax)
    });
    crosses.count() % 2 == 1
}

fn summary(mut ious: Vec<f64>) -> String {
    ious.sort_by(f64::total_cmp);
    let median = 0.5 * (ious[(ious.len() - 1) / 2] + ious[ious.len() / 2]);
    let mean = ious.iter().sum::<f64>() / ious.len() as f64;
    let all: Vec<String> = ious.iter().map(|iou| format!("{iou:.2}")).collect();
    format!("median IoU {median:.3}, mean {mean:.3}: {}", all.join(" "))
}
