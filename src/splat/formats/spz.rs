//! SPZ of Niantic: a gzip stream of a header and one array for each property. Version 3 is written, 2 and 3 are read.
//!
//! Positions have 24 bits, of which the header says how many are behind the point. Log-scales, opacities and colours have 8 bits,
//! quaternions 32 in version 3 and 24 in version 2. Higher SH coefficients have 8 bits for -1 to 1, of which 5 are used for degree 1
//! and 4 for others, as in Niantic's own program. Coordinates stay as they are, as splat-transform has it.

use super::{from_smallest_three, logit, opacity, scene_of, smallest_three};
use crate::error::{Result, bail, ensure, invalid};
use crate::files::atomic;
use crate::files::{Limits, kind, open};
use crate::splat::Gaussians;
use crate::splat::ply::PlyScene;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::DVec3;
use std::f64::consts::FRAC_1_SQRT_2;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::Path;

const MAGIC: [u8; 4] = *b"NGSP";
const HEADER: usize = 16;
/// Largest position in steps.
const MAX_POSITION: f64 = 8_388_607.0;
/// Bits behind the point of a position, at most.
const MAX_FRACTION: u8 = 23;
/// A colour has this slope in the constant SH coefficient.
const COLOR_SLOPE: f64 = 0.15;
/// Largest value of a component of a quaternion, which stands for sqrt(1/2).
const MAX_COMPONENT: f64 = 511.0;
const REMEDY: &str = "export the file again";

/// Bytes of a Gaussian.
fn stride(version: u32, sh_degree: usize) -> usize {
    let quaternion = if version == 2 { 3 } else { 4 };
    9 + 1 + 3 + 3 + quaternion + 3 * ((sh_degree + 1).pow(2) - 1)
}

/// Writes `gaussians` at the world positions `positions`.
///
/// # Errors
/// [`crate::Error::Argument`] for positions of more than 8,388,607 world units; [`crate::Error::Io`].
pub(super) fn write(path: &Path, gaussians: &Gaussians, positions: &[DVec3]) -> Result<()> {
    let farthest = |most: f64, p: &DVec3| most.max(p.abs().max_element());
    let farthest = positions.iter().fold(0.0, farthest);
    ensure!(farthest <= MAX_POSITION, argument "positions"; found "{farthest:e}"; expected "at most {MAX_POSITION}";
        help "write a .ply file, or make the scene smaller");
    // A cast of infinity gives the largest number.
    let fraction = ((MAX_POSITION / farthest).log2().floor() as u8).min(MAX_FRACTION);
    let steps = f64::from(1_u32 << fraction);
    let count = gaussians.len();
    let mut content = Vec::with_capacity(HEADER + count * stride(3, gaussians.sh_degree));
    content.extend(MAGIC);
    content.extend(3_u32.to_le_bytes());
    content.extend((count as u32).to_le_bytes());
    content.extend([gaussians.sh_degree as u8, fraction, 0, 0]);
    for value in positions.iter().flat_map(DVec3::to_array) {
        let value = (value * steps).round() as i32;
        content.extend(&value.to_le_bytes()[..3]);
    }
    // Casts to u8 end at 0 and 255.
    let byte = |v: f64| v.round() as u8;
    let opacities = gaussians.opacity_logits.iter();
    content.extend(opacities.map(|&v| byte(255.0 * opacity(v))));
    let sh = || gaussians.sh.chunks_exact(3 * gaussians.sh_len());
    let color = |&v: &f32| byte(255.0 * (COLOR_SLOPE * f64::from(v) + 0.5));
    content.extend(sh().flat_map(|sh| &sh[..3]).map(color));
    let scales = gaussians.log_scales.as_flattened().iter();
    content.extend(scales.map(|&v| byte(16.0 * (f64::from(v) + 10.0))));
    for rotation in &gaussians.rotations {
        content.extend(pack_rotation(*rotation).to_le_bytes());
    }
    for sh in sh() {
        for (i, &value) in sh.iter().enumerate().skip(3) {
            let step = if i < 12 { 8.0 } else { 16.0 };
            let rounded = (f64::from(value) * 128.0 / step).round() * step;
            content.push(byte(rounded + 128.0));
        }
    }
    atomic::write(path, |out| {
        let mut out = GzEncoder::new(out, Compression::default());
        out.write_all(&content)?;
        out.finish().map(drop)
    })
}

/// The components x, y, z, w: two bits for the place of the largest, then a sign and nine bits for each other one.
fn pack_rotation([w, x, y, z]: [f32; 4]) -> u32 {
    let (largest, three) = smallest_three([x, y, z, w].map(f64::from), [0.0, 0.0, 0.0, 1.0]);
    three.iter().fold(largest as u32, |bits, v| {
        let size = (v.abs() / FRAC_1_SQRT_2 * MAX_COMPONENT).round() as u32;
        bits << 10 | u32::from(*v < 0.0) << 9 | size
    })
}

/// The inverse of [`pack_rotation`].
fn unpack_rotation(bits: u32) -> [f32; 4] {
    let three = [20, 10, 0].map(|shift| {
        let part = bits >> shift;
        let size = f64::from(part & 511) * FRAC_1_SQRT_2 / MAX_COMPONENT;
        if part & 512 == 0 { size } else { -size }
    });
    let [x, y, z, w] = from_smallest_three((bits >> 30) as usize, three);
    [w, x, y, z]
}

/// Reads such a file.
///
/// # Errors
/// [`crate::Error::Input`], [`crate::Error::Limit`], [`crate::Error::Io`].
pub(super) fn read(path: &Path, limits: &Limits) -> Result<PlyScene> {
    let damaged = |e: io::Error| invalid!(path, "content"; found "{e}"; expected "a complete file"; help "{REMEDY}");
    let mut file = BufReader::new(open(path)?);
    let first = file.fill_buf().map_err(damaged)?;
    ensure!(!first.starts_with(&MAGIC), path, "header"; found "version 4"; expected "version 2 or 3";
        help "convert it: splat-transform FILE.spz FILE.ply");
    if !first.starts_with(&[0x1F, 0x8B]) {
        bail!(path, "first bytes"; found "{}", kind(first).unwrap_or("another kind of file"); expected "a .spz file"; help "{REMEDY}");
    }
    let mut file = GzDecoder::new(file);
    let mut header = [0; HEADER];
    file.read_exact(&mut header).map_err(damaged)?;
    let number = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|i| header[at + i]));
    let [sh_degree, fraction] = [header[12], header[13]];
    let (version, count) = (number(4), number(8) as usize);
    ensure!(header.starts_with(&MAGIC) && (2..=3).contains(&version), path, "header"; found "version {version}";
        expected "version 2 or 3"; help "{REMEDY}");
    ensure!(sh_degree <= 3, path, "SH degree"; found "{sh_degree}"; expected "0 to 3"; help "export with a lower degree");
    ensure!(fraction <= 31, path, "bits behind the point"; found "{fraction}"; expected "0 to 31"; help "{REMEDY}");
    limits.check_points(path, count as u64)?;
    let sh_degree = usize::from(sh_degree);
    let size = count * stride(version, sh_degree);
    // What a header promises is not allocated before it is there.
    let mut content = Vec::new();
    file.by_ref()
        .take(size as u64)
        .read_to_end(&mut content)
        .map_err(damaged)?;
    ensure!(content.len() == size, path, "content"; found "{} bytes", content.len(); expected "{size}";
        help "the file is cut off; copy or export it again");
    // The checksum comes last, perhaps behind extensions of others.
    io::copy(&mut file, &mut io::sink()).map_err(damaged)?;
    scene_of(path, unpack(&content, version, sh_degree, fraction))
}

/// The Gaussians of the arrays behind the header.
fn unpack(content: &[u8], version: u32, sh_degree: usize, fraction: u8) -> Gaussians {
    let count = content.len() / stride(version, sh_degree);
    let mut rest = content;
    let mut next = |bytes: usize| {
        let (array, behind) = rest.split_at(count * bytes);
        rest = behind;
        array
    };
    let step = 0.5_f64.powi(i32::from(fraction));
    let position =
        |&[a, b, c]: &[u8; 3]| (f64::from(i32::from_le_bytes([0, a, b, c]) >> 8) * step) as f32;
    let positions: Vec<f32> = next(9).as_chunks().0.iter().map(position).collect();
    let opacity_logits = next(1).iter().map(|&v| logit(v)).collect();
    let color = |&v: &u8| ((f64::from(v) / 255.0 - 0.5) / COLOR_SLOPE) as f32;
    let colors: Vec<f32> = next(3).iter().map(color).collect();
    let scales: Vec<f32> = next(3)
        .iter()
        .map(|&v| f32::from(v) / 16.0 - 10.0)
        .collect();
    let rotations = if version == 2 {
        let part = |&v: &u8| f32::from(v) / 127.5 - 1.0;
        let rotation = |bytes: &[u8; 3]| {
            let [x, y, z] = bytes.each_ref().map(part);
            [(1.0 - x * x - y * y - z * z).max(0.0).sqrt(), x, y, z]
        };
        next(3).as_chunks().0.iter().map(rotation).collect()
    } else {
        let rotation = |&bytes: &[u8; 4]| unpack_rotation(u32::from_le_bytes(bytes));
        next(4).as_chunks().0.iter().map(rotation).collect()
    };
    let mut higher = next(3 * ((sh_degree + 1).pow(2) - 1))
        .iter()
        .map(|&v| (f32::from(v) - 128.0) / 128.0);
    let width = higher.len() / count.max(1);
    let mut sh = Vec::with_capacity(colors.len() + higher.len());
    for color in colors.as_chunks::<3>().0 {
        sh.extend(color);
        sh.extend(higher.by_ref().take(width));
    }
    Gaussians {
        means: positions.as_chunks().0.to_vec(),
        log_scales: scales.as_chunks().0.to_vec(),
        rotations,
        opacity_logits,
        sh,
        sh_degree,
    }
}
