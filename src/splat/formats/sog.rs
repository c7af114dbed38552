//! SOG of PlayCanvas, version 2: a zip archive of `meta.json` and lossless WebP pictures, a texel for each Gaussian. It is read here;
//! the program splat-transform writes it.
//!
//! Positions have 16 bits of `sign(x) ln(1 + |x|)`, the low bytes in one picture and the high bytes in another. Log-scales and constant
//! SH coefficients are entries of codebooks of 256. Opacities have 8 bits, and so has each of the three smaller components of a
//! quaternion. Higher SH coefficients are rows of a palette, 64 in a row of its picture.
//!
//! Format: <https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/>

use super::{PlyScene, from_smallest_three, logit, opacity, scene_of};
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files;
use crate::splat::{Gaussians, SH_0};
use glam::DVec3;
use image::{ImageFormat, ImageReader};
use serde::Deserialize;
use std::collections::HashMap;
use std::f64::consts::FRAC_1_SQRT_2;
use std::fmt::Display;
use std::io::{Cursor, Read};
use std::path::Path;
use zip::ZipArchive;

/// The part of the archive that names the others.
const META: &str = "meta.json";
/// Largest code of a coordinate.
const MAX_CODE: f64 = 65_535.0;
/// Rows of the palette of higher SH coefficients in a row of its picture.
const PALETTE_COLUMNS: usize = 64;
/// The fourth byte of a quaternion whose largest component is the first one, w.
const LARGEST_W: u8 = 252;
/// Gaussians for a byte of the file, at most. Trained scenes have one for ten bytes or more.
const MAX_RATIO: u64 = 4;
/// Bytes that reading may allocate for each Gaussian, and besides. A picture has four bytes for each, and may have margins.
const BYTES_OF_GAUSSIAN: u64 = 32;
const EXTRA_BYTES: u64 = 64 << 20;
const REMEDY: &str = "export the file again";

/// What `meta.json` says.
#[derive(Deserialize)]
struct Meta {
    version: u32,
    count: usize,
    means: Means,
    scales: Coded,
    quats: Pictures,
    sh0: Coded,
    #[serde(rename = "shN")]
    higher: Option<Palette>,
}

#[derive(Deserialize)]
struct Means {
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Deserialize)]
struct Coded {
    codebook: Vec<f32>,
    files: [String; 1],
}

#[derive(Deserialize)]
struct Pictures {
    files: [String; 1],
}

#[derive(Deserialize)]
struct Palette {
    bands: usize,
    codebook: Vec<f32>,
    files: [String; 2],
}

/// RGBA texels, row after row.
struct Texels {
    width: usize,
    values: Vec<[u8; 4]>,
}

/// The parts of a file.
struct Archive<'a> {
    path: &'a Path,
    zip: ZipArchive<Cursor<Vec<u8>>>,
    bytes: u64,
}

impl<'a> Archive<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let file = files::read(path)?;
        let bytes = file.len() as u64;
        let expected = "a .sog file, which is a zip archive";
        let zip = ZipArchive::new(Cursor::new(file));
        let zip = zip.map_err(|e| damaged(path, "first bytes", e, expected))?;
        Ok(Self { path, zip, bytes })
    }

    fn meta(&mut self) -> Result<Meta> {
        let text = self.part(META, EXTRA_BYTES)?;
        let path = self.path;
        let meta: Meta = serde_json::from_slice(&text)
            .map_err(|e| damaged(path, META, e, "version 2 of the format"))?;
        let (version, count) = (meta.version, meta.count as u64);
        ensure!(version == 2, path, "version"; found "{version}"; expected "2"; help "{REMEDY}");
        files::check_points(path, count)?;
        ensure!(count <= MAX_RATIO * self.bytes, path, "count"; found "{count} Gaussians in {} bytes", self.bytes;
            expected "fewer"; help "{REMEDY}");
        Ok(meta)
    }

    /// The bytes of a part, which must not be more than `most`.
    fn part(&mut self, name: &str, most: u64) -> Result<Vec<u8>> {
        let path = self.path;
        let part = self.zip.by_name(name);
        let part = part.map_err(|e| damaged(path, name, e, "a part of the archive"))?;
        let mut bytes = Vec::new();
        let read = part.take(most + 1).read_to_end(&mut bytes);
        read.map_err(|e| damaged(path, name, e, "a complete part"))?;
        ensure!(bytes.len() as u64 <= most, path, "{name}"; found "more than {most} bytes"; expected "fewer"; help "{REMEDY}");
        Ok(bytes)
    }

    /// The picture `name`, with a texel or more for each of `count` Gaussians.
    fn texels(&mut self, name: &str, count: usize) -> Result<Texels> {
        let most = BYTES_OF_GAUSSIAN * count as u64 + EXTRA_BYTES;
        let bytes = self.part(name, most)?;
        let mut reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::WebP);
        let mut limits = image::Limits::no_limits();
        limits.max_alloc = Some(most);
        reader.limits(limits);
        let picture = reader.decode();
        let picture = picture.map_err(|e| damaged(self.path, name, e, "a WebP picture"))?;
        let picture = picture.into_rgba8();
        let width = picture.width() as usize;
        let values = picture.into_raw().as_chunks().0.to_vec();
        ensure!(values.len() >= count, self.path, "{name}"; found "{} texels", values.len();
            expected "one for each of {count} Gaussians"; help "{REMEDY}");
        Ok(Texels { width, values })
    }
}

fn damaged(path: &Path, field: &str, found: impl Display, expected: &str) -> Error {
    invalid!(path, "{field}"; found "{found}"; expected "{expected}"; help "{REMEDY}")
}

/// The 256 entries of a codebook.
fn codebook<'a>(path: &Path, name: &str, entries: &'a [f32]) -> Result<&'a [f32; 256]> {
    entries.try_into().map_err(|_| {
        let found = format!("{} entries", entries.len());
        damaged(path, &format!("{name}.codebook"), found, "256")
    })
}

/// Reads such a file.
///
/// # Errors
/// [`Error::Input`], [`Error::Limit`], [`Error::Io`].
pub(super) fn read(path: &Path) -> Result<PlyScene> {
    scene_of(path, Decoded::read(path)?.gaussians)
}

/// The content of a file.
struct Decoded {
    means: Means,
    /// Of the positions.
    codes: Vec<[u16; 3]>,
    gaussians: Gaussians,
}

impl Decoded {
    fn read(path: &Path) -> Result<Self> {
        let mut archive = Archive::open(path)?;
        let meta = archive.meta()?;
        let count = meta.count;
        let codes = codes(&mut archive, &meta)?;
        let position =
            |code: &[u16; 3]| [0, 1, 2].map(|axis| meta.means.coordinate(axis, code[axis]));
        let scales = codebook(path, "scales", &meta.scales.codebook)?;
        let scale_texels = archive.texels(&meta.scales.files[0], count)?.values;
        let scale = |&[x, y, z, _]: &[u8; 4]| [x, y, z].map(|code| scales[usize::from(code)]);
        let quaternions = archive.texels(&meta.quats.files[0], count)?.values;
        let colors = codebook(path, "sh0", &meta.sh0.codebook)?;
        let color_texels = archive.texels(&meta.sh0.files[0], count)?.values;
        let higher = match &meta.higher {
            Some(palette) => palette.coefficients(&mut archive, count)?,
            None => Vec::new(),
        };
        let width = higher.len() / count.max(1);
        let mut sh = Vec::with_capacity(3 * count + higher.len());
        for (row, [r, g, b, _]) in color_texels[..count].iter().enumerate() {
            sh.extend([r, g, b].map(|&code| colors[usize::from(code)]));
            sh.extend(&higher[row * width..][..width]);
        }
        let gaussians = Gaussians {
            means: codes.iter().map(position).collect(),
            log_scales: scale_texels[..count].iter().map(scale).collect(),
            rotations: quaternions[..count].iter().map(rotation).collect(),
            opacity_logits: color_texels[..count].iter().map(|t| logit(t[3])).collect(),
            sh,
            sh_degree: meta.higher.map_or(0, |palette| palette.bands),
        };
        Ok(Self {
            means: meta.means,
            codes,
            gaussians,
        })
    }
}

/// The codes of the positions.
fn codes(archive: &mut Archive<'_>, meta: &Meta) -> Result<Vec<[u16; 3]>> {
    let [low, high] = meta.means.files.each_ref();
    let low = archive.texels(low, meta.count)?.values;
    let high = archive.texels(high, meta.count)?.values;
    let code = |(low, high): (&[u8; 4], &[u8; 4])| {
        [0, 1, 2].map(|axis| u16::from_le_bytes([low[axis], high[axis]]))
    };
    Ok(low.iter().zip(&high).take(meta.count).map(code).collect())
}

impl Means {
    /// The coordinate of a code.
    fn coordinate(&self, axis: usize, code: u16) -> f32 {
        let share = f64::from(code) / MAX_CODE;
        let log = self.mins[axis] + (self.maxs[axis] - self.mins[axis]) * share;
        (log.signum() * log.abs().exp_m1()) as f32
    }

    /// The inverse of [`Means::coordinate`].
    fn code(&self, axis: usize, coordinate: f64) -> u16 {
        let log = coordinate.signum() * coordinate.abs().ln_1p();
        let share = (log - self.mins[axis]) / (self.maxs[axis] - self.mins[axis]);
        (MAX_CODE * share) as u16
    }
}

impl Palette {
    /// Higher SH coefficients of `count` Gaussians, red, green and blue of each coefficient together.
    fn coefficients(&self, archive: &mut Archive<'_>, count: usize) -> Result<Vec<f32>> {
        let path = archive.path;
        let bands = self.bands;
        ensure!(bands <= 3, path, "shN.bands"; found "{bands}"; expected "0 to 3"; help "{REMEDY}");
        let entries = codebook(path, "shN", &self.codebook)?;
        let terms = (bands + 1).pow(2) - 1;
        let [palette, labels] = self.files.each_ref();
        let palette = archive.texels(palette, 0)?;
        let width = PALETTE_COLUMNS * terms;
        ensure!(palette.width == width || bands == 0, path, "{}", self.files[0]; found "{} columns", palette.width;
            expected "{width}"; help "{REMEDY}");
        let mut coefficients = Vec::with_capacity(3 * terms * count);
        for label in &archive.texels(labels, count)?.values[..count] {
            let row = usize::from(u16::from_le_bytes([label[0], label[1]]));
            let texels = palette.values.get(row * terms..(row + 1) * terms);
            let Some(texels) = texels else {
                bail!(path, "{}", self.files[1]; found "row {row}"; expected "a row of the palette"; help "{REMEDY}");
            };
            let codes = texels.iter().flat_map(|[r, g, b, _]| [r, g, b]);
            coefficients.extend(codes.map(|&code| entries[usize::from(code)]));
        }
        Ok(coefficients)
    }
}

/// The quaternion w x y z of a texel.
fn rotation(&[a, b, c, largest]: &[u8; 4]) -> [f32; 4] {
    let three = [a, b, c].map(|v| (f64::from(v) / 127.5 - 1.0) * FRAC_1_SQRT_2);
    match largest.checked_sub(LARGEST_W) {
        Some(place) => from_smallest_three(usize::from(place), three),
        None => [1.0, 0.0, 0.0, 0.0],
    }
}

/// The labels of the rows of the file `path`, made from `gaussians` with `origin` added, which have the `labels`.
///
/// The rows have another order there. Positions tell which is which, as far as they are apart; Gaussians of one place are told apart by
/// size, opacity and colour.
///
/// # Errors
/// Those of reading; [`Error::Input`] where the file is of other Gaussians.
pub fn labels_of(
    path: &Path,
    (gaussians, origin): (&Gaussians, DVec3),
    labels: &[u16],
) -> Result<Vec<u16>> {
    gaussians.check(Some(labels))?;
    let found = Decoded::read(path)?;
    let mut by_code: HashMap<[u16; 3], Vec<usize>> = HashMap::new();
    for (row, position) in gaussians.positions(origin).iter().enumerate() {
        // The program reads floats.
        let position = position.as_vec3().as_dvec3().to_array();
        let code = [0, 1, 2].map(|axis| found.means.code(axis, position[axis]));
        by_code.entry(code).or_default().push(row);
    }
    let mut original = |row: usize, code: [u16; 3]| {
        around(code).find_map(|code| {
            let rows = by_code.get_mut(&code)?;
            let differences = rows
                .iter()
                .map(|&of| difference(&found.gaussians, row, gaussians, of));
            let nearest = differences.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
            Some(rows.swap_remove(nearest.0))
        })
    };
    let codes = found.codes.iter().enumerate();
    let label = |(row, &code): (usize, &[u16; 3])| {
        let original = original(row, code).ok_or_else(|| {
            let expected = "the position of a Gaussian of the scene";
            damaged(path, &format!("row {row}"), "another position", expected)
        })?;
        Ok(labels[original])
    };
    codes.map(label).collect()
}

/// `code` and the 26 codes around it, which rounding may have given instead.
fn around(code: [u16; 3]) -> impl Iterator<Item = [u16; 3]> {
    let steps = [0_i16, -1, 1];
    let moves = steps.into_iter().flat_map(move |x| {
        steps
            .into_iter()
            .flat_map(move |y| steps.map(|z| [x, y, z]))
    });
    moves.map(move |step| [0, 1, 2].map(|axis| code[axis].saturating_add_signed(step[axis])))
}

/// How different row `row` of `a` and row `other` of `b` are in log-scales, opacity and colour, roughly in steps of the format.
fn difference(a: &Gaussians, row: usize, b: &Gaussians, other: usize) -> f64 {
    let squares = |a: &[f32], b: &[f32], step: f64| -> f64 {
        let pairs = a.iter().zip(b);
        pairs
            .map(|(a, b)| ((f64::from(*a) - f64::from(*b)) / step).powi(2))
            .sum()
    };
    let color = |g: &Gaussians, row: usize| g.sh[3 * g.sh_len() * row..][..3].to_vec();
    let opacities = opacity(a.opacity_logits[row]) - opacity(b.opacity_logits[other]);
    squares(&a.log_scales[row], &b.log_scales[other], 0.05)
        + squares(&color(a, row), &color(b, other), 0.01 / f64::from(SH_0))
        + (255.0 * opacities).powi(2)
}
