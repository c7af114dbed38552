//! SPZ of Niantic: a gzip stream of a header and one array for each property. Version 3 is written, 2 to 4 are read.
//! Version 4 has a zstd stream for each array.
//!
//! Positions have 24 bits, of which the header says how many are fractional. Log-scales, opacities and colours have 8 bits,
//! quaternions 32 in version 3 and 24 in version 2. Higher SH coefficients have 8 bits for -1 to 1, of which 5 are used for degree 1
//! and 4 for others, as in Niantic's own program. Coordinates stay as they are, as in splat-transform.

use super::{PlyScene, from_smallest_three, logit, opacity, scene_of, smallest_three};
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files::{self, atomic, kind};
use crate::splat::Gaussians;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::DVec3;
use ruzstd::decoding::StreamingDecoder;
use std::f64::consts::FRAC_1_SQRT_2;
use std::fmt::Display;
use std::io::{self, Read, Write};
use std::ops::RangeInclusive;
use std::path::Path;

const MAGIC: [u8; 4] = *b"NGSP";
const HEADER: usize = 16;
/// Largest position in steps.
const MAX_POSITION: f64 = 8_388_607.0;
/// Fractional bits of a position, at most.
const MAX_FRACTION: u8 = 23;
/// A colour has this slope in the constant SH coefficient.
const COLOR_SLOPE: f64 = 0.15;
/// Largest value of a component of a quaternion, which stands for sqrt(1/2).
const MAX_COMPONENT: f64 = 511.0;
/// Bytes of positions for a byte of a file, at most. zstd has no such limit of its own.
const MAX_RATIO: usize = 1_024;
const REMEDY: &str = "export the file again";

/// What a header says.
struct Header {
    version: u32,
    count: usize,
    sh_degree: usize,
    /// Fractional bits of a position.
    fraction: u8,
}

impl Header {
    fn read(path: &Path, bytes: &[u8; HEADER], versions: RangeInclusive<u32>) -> Result<Self> {
        let number = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|i| bytes[at + i]));
        let (version, count) = (number(4), number(8));
        let [sh_degree, fraction] = [bytes[12], bytes[13]];
        ensure!(bytes.starts_with(&MAGIC) && versions.contains(&version), path, "header"; found "version {version}";
            expected "version 2 to 4"; help "{REMEDY}");
        ensure!(sh_degree <= 3, path, "SH degree"; found "{sh_degree}"; expected "0 to 3"; help "export with a lower degree");
        ensure!(fraction <= 31, path, "fractional bits"; found "{fraction}"; expected "0 to 31"; help "{REMEDY}");
        files::check_points(path, count.into())?;
        Ok(Self {
            version,
            count: count as usize,
            sh_degree: usize::from(sh_degree),
            fraction,
        })
    }

    /// Bytes of a Gaussian in each array: position, opacity, colour, log-scale, quaternion, higher SH coefficients.
    fn widths(&self) -> [usize; 6] {
        let quaternion = if self.version == 2 { 3 } else { 4 };
        let higher = 3 * ((self.sh_degree + 1).pow(2) - 1);
        [9, 1, 3, 3, quaternion, higher]
    }
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
    let mut content = Vec::new();
    content.extend(MAGIC);
    content.extend(3_u32.to_le_bytes());
    content.extend((count as u32).to_le_bytes());
    content.extend([gaussians.sh_degree as u8, fraction, 0, 0]);
    for value in positions.iter().flat_map(DVec3::to_array) {
        let value = (value * steps).round() as i32;
        content.extend(&value.to_le_bytes()[..3]);
    }
    // Casts to u8 saturate at 0 and 255.
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
pub(super) fn read(path: &Path) -> Result<PlyScene> {
    let file = files::read(path)?;
    let (header, content) = if file.starts_with(&MAGIC) {
        zstd_arrays(path, &file)?
    } else {
        gzip_arrays(path, &file)?
    };
    scene_of(path, unpack(&header, &content))
}

fn damaged(path: &Path, found: impl Display) -> Error {
    invalid!(path, "content"; found "{found}"; expected "a complete file"; help "copy or export it again")
}

/// Header and arrays of versions 2 and 3: one stream.
fn gzip_arrays(path: &Path, file: &[u8]) -> Result<(Header, Vec<u8>)> {
    if !file.starts_with(&[0x1F, 0x8B]) {
        bail!(path, "first bytes"; found "{}", kind(file).unwrap_or("another kind of file"); expected "a .spz file"; help "{REMEDY}");
    }
    let mut stream = GzDecoder::new(file);
    let mut header = [0; HEADER];
    let read = stream.read_exact(&mut header);
    read.map_err(|e| damaged(path, e))?;
    let header = Header::read(path, &header, 2..=3)?;
    let mut content = Vec::new();
    let bytes = header.count * header.widths().iter().sum::<usize>();
    add(path, &mut stream, bytes, &mut content)?;
    // The checksum comes last, perhaps after extensions of others.
    let rest = io::copy(&mut stream, &mut io::sink());
    rest.map_err(|e| damaged(path, e))?;
    Ok((header, content))
}

/// Header and arrays of version 4: a table with the packed and the unpacked size of each array, then a stream for each.
fn zstd_arrays(path: &Path, file: &[u8]) -> Result<(Header, Vec<u8>)> {
    const TABLE_AT: usize = 16;
    let short = || damaged(path, format!("{} bytes", file.len()));
    let header = Header::read(path, file.first_chunk().ok_or_else(short)?, 4..=4)?;
    let fits = header.count * header.widths()[0] <= MAX_RATIO * file.len();
    ensure!(fits, path, "header"; found "{} Gaussians in {} bytes", header.count, file.len(); expected "fewer"; help "{REMEDY}");
    let number = |at: usize| Some(u64::from_le_bytes(*file.get(at..)?.first_chunk()?));
    let table = number(TABLE_AT).ok_or_else(short)? as u32 as usize;
    let widths = header.widths();
    let widths: Vec<usize> = widths.into_iter().filter(|&width| width > 0).collect();
    let mut at = table + 16 * widths.len();
    let mut content = Vec::new();
    for (i, width) in widths.iter().enumerate() {
        let size = number(table + 16 * i).and_then(|size| usize::try_from(size).ok());
        let packed = size.and_then(|size| file.get(at..at.checked_add(size)?));
        let packed = packed.ok_or_else(short)?;
        at += packed.len();
        let stream = StreamingDecoder::new(packed);
        let mut stream = stream.map_err(|e| damaged(path, e))?;
        add(path, &mut stream, width * header.count, &mut content)?;
    }
    Ok((header, content))
}

/// Adds `bytes` bytes of a stream. What a header promises is not allocated before it is there.
fn add(path: &Path, stream: &mut impl Read, bytes: usize, content: &mut Vec<u8>) -> Result<()> {
    let found = stream.take(bytes as u64).read_to_end(content);
    let found = found.map_err(|e| damaged(path, e))?;
    ensure!(found == bytes, path, "content"; found "{found} bytes"; expected "{bytes}"; help "the file is cut off; copy or export it again");
    Ok(())
}

/// The Gaussians of the arrays after the header.
fn unpack(header: &Header, content: &[u8]) -> Gaussians {
    let mut rest = content;
    let arrays = header.widths().map(|width| {
        let (array, behind) = rest.split_at(header.count * width);
        rest = behind;
        array
    });
    let [positions, opacities, colors, scales, rotations, higher] = arrays;
    let step = 0.5_f64.powi(i32::from(header.fraction));
    let position =
        |&[a, b, c]: &[u8; 3]| (f64::from(i32::from_le_bytes([0, a, b, c]) >> 8) * step) as f32;
    let positions: Vec<f32> = positions.as_chunks().0.iter().map(position).collect();
    let opacity_logits = opacities.iter().map(|&v| logit(v)).collect();
    let color = |&v: &u8| ((f64::from(v) / 255.0 - 0.5) / COLOR_SLOPE) as f32;
    let colors: Vec<f32> = colors.iter().map(color).collect();
    let scales: Vec<f32> = scales.iter().map(|&v| f32::from(v) / 16.0 - 10.0).collect();
    let rotations = if header.version == 2 {
        let part = |&v: &u8| f32::from(v) / 127.5 - 1.0;
        let rotation = |bytes: &[u8; 3]| {
            let [x, y, z] = bytes.each_ref().map(part);
            [(1.0 - x * x - y * y - z * z).max(0.0).sqrt(), x, y, z]
        };
        rotations.as_chunks().0.iter().map(rotation).collect()
    } else {
        let rotation = |&bytes: &[u8; 4]| unpack_rotation(u32::from_le_bytes(bytes));
        rotations.as_chunks().0.iter().map(rotation).collect()
    };
    let mut higher = higher.iter().map(|&v| (f32::from(v) - 128.0) / 128.0);
    let width = header.widths()[5];
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
        sh_degree: header.sh_degree,
    }
}
