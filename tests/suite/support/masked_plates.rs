//! The plates with a mask that leaves a corner of a photo out.

use crate::support::plates::{HEIGHT, WIDTH, scene};
use crate::support::transforms_json::edit;
use coseg::data::mask::Mask;
use image::{DynamicImage, GrayImage, Luma};
use serde_json::json;
use std::fs;
use std::path::Path;

/// The upper left corner of the plates' photos is what masks leave out here.
const CORNER: (u32, u32) = (20, 16);
/// Its pixels.
pub const PIXELS: usize = 320;
/// The corner in black, as a PNG of one bit a pixel, 80x64.
pub const ONE_BIT: &str = "89504e470d0a1a0a0000000d4948445200000050000000400100000000a5bccd9b000000194944415478da63\
    6060e0ff0f010c4382f91f0e4699a3ccff004f754ebfc2d49adc0000000049454e44ae426082";

pub fn used(x: u32, y: u32) -> bool {
    x >= CORNER.0 || y >= CORNER.1
}

/// Black where not `used`, nearly black elsewhere.
pub fn grey(width: u32, height: u32, used: impl Fn(u32, u32) -> bool) -> DynamicImage {
    GrayImage::from_fn(width, height, |x, y| Luma([u8::from(used(x, y))])).into()
}

/// The mask.
pub fn corner() -> DynamicImage {
    grey(WIDTH as u32, HEIGHT as u32, used)
}

/// The plates, and a mask for photo 1 that leaves the corner out.
pub fn masked(dir: &Path) {
    scene(dir);
    fs::create_dir_all(dir.join("masks")).unwrap();
    corner().save(dir.join("masks/v1.png")).unwrap();
    edit(dir, |v| v["frames"][1]["mask_path"] = json!("masks/v1.png"));
}

/// Whether exactly the corner is left out of the plates' photos.
pub fn is_corner(mask: &Mask) -> bool {
    (0..WIDTH * HEIGHT).all(|i| mask.uses(i) == used((i % WIDTH) as u32, (i / WIDTH) as u32))
}
