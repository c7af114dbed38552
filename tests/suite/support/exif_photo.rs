//! A photo with an EXIF orientation.

use std::fs;
use std::path::Path;

/// A JPEG of this size with an orientation, as cameras write it: a segment of EXIF data with one entry, right after the start.
pub fn photo(path: &Path, (width, height): (usize, usize), orientation: u8) {
    let mut bytes = Vec::new();
    let pixels = image::RgbImage::from_fn(width as u32, height as u32, |x, y| {
        image::Rgb([x as u8, y as u8, 90])
    });
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95);
    pixels.write_with_encoder(encoder).expect("photo");
    let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    let mut segment = vec![0xFF, 0xE1];
    segment.extend((exif.len() as u16 + 2).to_be_bytes());
    segment.extend(exif);
    drop(bytes.splice(2..2, segment));
    fs::write(path, bytes).expect("photo");
}

/// A PNG of these pixels with an orientation.
pub fn with_orientation(path: &Path, pixels: &image::RgbImage, orientation: u8) {
    use image::ImageEncoder;
    let mut exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    encoder.set_exif_metadata(exif).expect("EXIF");
    let (width, height) = pixels.dimensions();
    let color = image::ExtendedColorType::Rgb8;
    encoder
        .write_image(pixels, width, height, color)
        .expect("photo");
    fs::write(path, bytes).expect("photo");
}
