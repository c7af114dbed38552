//! COLMAP's binary model files: little-endian, counts first.

use super::cameras::{Model, ModelCamera};
use super::{AGAIN, ModelPoint, PosedImage, TakePoint};
use crate::data::Limits;
use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// Longest name of an image, in bytes: beyond what file systems have.
const NAME: usize = 4_096;
/// Bytes of the smallest camera, image and point there can be.
const SMALLEST: [u64; 3] = [
    4 + 4 + 16 + 3 * 8,
    4 + 7 * 8 + 4 + 2 + 8,
    8 + 24 + 3 + 8 + 8,
];
/// Bytes of an observation in an image and of one in the track of a point.
const OBSERVATION: [u64; 2] = [24, 8];

/// A file read from front to back that knows where it is and how long it is.
struct Bytes {
    path: PathBuf,
    reader: BufReader<File>,
    at: u64,
    length: u64,
}

impl Bytes {
    fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
        let length = file
            .metadata()
            .map_err(|e| Error::io(path, "measure", e))?
            .len();
        Ok(Self {
            path: path.to_owned(),
            reader: BufReader::with_capacity(1 << 18, file),
            at: 0,
            length,
        })
    }

    fn error(&self, field: &str, found: String, expected: &str) -> Error {
        Error::input(
            &self.path,
            format!("{field} at byte {}", self.at),
            found,
            expected,
            AGAIN,
        )
    }

    /// Refuses what the rest of the file cannot hold.
    fn expect(&self, bytes: u64, field: &str) -> Result<()> {
        let left = self.length.saturating_sub(self.at);
        if bytes <= left {
            return Ok(());
        }
        Err(self.error(
            field,
            format!("the file's end after {left} bytes"),
            &format!("{bytes} bytes more"),
        ))
    }

    fn take<const N: usize>(&mut self, field: &str) -> Result<[u8; N]> {
        self.expect(N as u64, field)?;
        let mut out = [0; N];
        self.reader
            .read_exact(&mut out)
            .map_err(|e| Error::io(&self.path, "read", e))?;
        self.at += N as u64;
        Ok(out)
    }

    fn u32(&mut self, field: &str) -> Result<u32> {
        self.take(field).map(u32::from_le_bytes)
    }

    fn u64(&mut self, field: &str) -> Result<u64> {
        self.take(field).map(u64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self, field: &str) -> Result<[f64; N]> {
        let mut out = [0.0; N];
        for value in &mut out {
            *value = self.take(field).map(f64::from_le_bytes)?;
        }
        Ok(out)
    }

    /// A number of items of at least `each` bytes, which the rest of the file must be able to hold.
    fn count(&mut self, each: u64, field: &str) -> Result<u64> {
        let start = self.at;
        let count = self.u64(field)?;
        let left = self.length.saturating_sub(self.at);
        if count <= left / each {
            return Ok(count);
        }
        self.at = start;
        Err(self.error(
            field,
            count.to_string(),
            &format!("at most {}, what {left} bytes can hold", left / each),
        ))
    }

    fn skip(&mut self, bytes: u64, field: &str) -> Result<()> {
        self.expect(bytes, field)?;
        // `expect` bounds it by the file's length.
        let offset = i64::try_from(bytes)
            .map_err(|e| Error::io(&self.path, "seek", std::io::Error::other(e)))?;
        self.reader
            .seek_relative(offset)
            .map_err(|e| Error::io(&self.path, "seek", e))?;
        self.at += bytes;
        Ok(())
    }

    /// UTF-8 up to a zero byte.
    fn name(&mut self, field: &str) -> Result<String> {
        let start = self.at;
        let mut bytes = Vec::new();
        loop {
            let [byte] = self.take(field)?;
            if byte == 0 {
                break;
            }
            bytes.push(byte);
            if bytes.len() > NAME {
                self.at = start;
                return Err(self.error(
                    field,
                    format!("more than {NAME} bytes"),
                    "a file name that ends in a zero byte",
                ));
            }
        }
        String::from_utf8(bytes).map_err(|e| {
            self.at = start;
            self.error(field, e.to_string(), "a file name in UTF-8")
        })
    }

    /// The file must end here.
    fn end(self) -> Result<()> {
        if self.at == self.length {
            return Ok(());
        }
        let more = format!("{} bytes more", self.length.saturating_sub(self.at));
        Err(self.error(
            "end",
            more,
            "the file's end: another version of the format, or a damaged file",
        ))
    }
}

pub(crate) fn cameras(path: &Path) -> Result<Vec<ModelCamera>> {
    let mut file = Bytes::open(path)?;
    let count = file.count(SMALLEST[0], "number of cameras")?;
    let mut cameras = Vec::new();
    for i in 0..count {
        let place = format!("camera {i} at byte {}", file.at);
        let id = file.u32("CAMERA_ID")?;
        let number = file.take("MODEL").map(i32::from_le_bytes)?;
        let model = Model::from_number(number, path, &place)?;
        let size = [file.u64("WIDTH")?, file.u64("HEIGHT")?];
        let mut params = Vec::with_capacity(model.params);
        for _ in 0..model.params {
            let [value] = file.f64s("PARAMS")?;
            params.push(value);
        }
        cameras.push(ModelCamera {
            id,
            model: model.name,
            size,
            params,
            place,
        });
    }
    file.end()?;
    Ok(cameras)
}

/// How many images the file says that it has.
pub(crate) fn image_count(path: &Path) -> Result<u64> {
    Bytes::open(path)?.count(SMALLEST[1], "number of images")
}

pub(crate) fn images(path: &Path, limits: &Limits) -> Result<Vec<PosedImage>> {
    let mut file = Bytes::open(path)?;
    let count = file.count(SMALLEST[1], "number of images")?;
    // Far more than views are kept may be thinned out later, but not without end.
    let most = (limits.views as u64).saturating_mul(64);
    Limits::check(
        format!("{}: images", path.display()),
        count,
        most,
        "split the model",
    )?;
    let mut images = Vec::new();
    for i in 0..count {
        let place = format!("image {i} at byte {}", file.at);
        file.u32("IMAGE_ID")?;
        let rotation = file.f64s("QW QX QY QZ")?;
        let translation = file.f64s("TX TY TZ")?;
        let camera = file.u32("CAMERA_ID")?;
        let name = file.name("NAME")?;
        let observations = file.count(OBSERVATION[0], "number of POINTS2D")?;
        file.skip(observations * OBSERVATION[0], "POINTS2D")?;
        images.push(PosedImage {
            name,
            rotation,
            translation,
            camera,
            place,
        });
    }
    file.end()?;
    Ok(images)
}

/// Hands each point with its place to `take`.
pub(crate) fn points(path: &Path, limits: &Limits, take: &mut TakePoint<'_>) -> Result<()> {
    let mut file = Bytes::open(path)?;
    let count = file.count(SMALLEST[2], "number of points")?;
    Limits::check(
        format!("{}: points", path.display()),
        count,
        limits.points,
        "thin the cloud out",
    )?;
    for i in 0..count {
        let start = file.at;
        file.u64("POINT3D_ID")?;
        let position = file.f64s("X Y Z")?;
        let color = file.take("R G B")?;
        file.f64s::<1>("ERROR")?;
        let track = file.count(OBSERVATION[1], "length of TRACK")?;
        file.skip(track * OBSERVATION[1], "TRACK")?;
        take(
            &|| format!("point {i} at byte {start}"),
            ModelPoint { position, color },
        )?;
    }
    file.end()
}
