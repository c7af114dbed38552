//! COLMAP's text model files: one item a line, two lines an image, comments behind `#`.

use super::cameras::{Model, ModelCamera};
use super::{AGAIN, ModelPoint, PosedImage, TakePoint};
use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::str::{FromStr, SplitAsciiWhitespace};

/// Lines of a file that are no comments, each with its number from 1.
struct Lines<'p> {
    path: &'p Path,
    reader: BufReader<File>,
    number: usize,
    text: String,
}

impl<'p> Lines<'p> {
    fn open(path: &'p Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
        Ok(Self {
            path,
            reader: BufReader::with_capacity(1 << 18, file),
            number: 0,
            text: String::new(),
        })
    }

    /// The next line as it stands; `None` at the end.
    fn raw(&mut self) -> Result<Option<&str>> {
        self.text.clear();
        let read = self
            .reader
            .read_line(&mut self.text)
            .map_err(|e| Error::io(self.path, "read", e))?;
        self.number += 1;
        Ok((read > 0).then(|| self.text.trim()))
    }

    /// The next line with something on it.
    fn next(&mut self) -> Result<Option<Fields<'_>>> {
        loop {
            match self.raw()? {
                None => return Ok(None),
                Some(line) if line.is_empty() || line.starts_with('#') => {}
                Some(_) => break,
            }
        }
        Ok(Some(Fields {
            path: self.path,
            line: self.number,
            rest: self.text.trim().split_ascii_whitespace(),
        }))
    }
}

/// What stands on a line, separated by blanks.
struct Fields<'t> {
    path: &'t Path,
    line: usize,
    rest: SplitAsciiWhitespace<'t>,
}

impl<'t> Fields<'t> {
    fn word(&mut self, field: &str) -> Result<&'t str> {
        let word = self.rest.next();
        word.ok_or_else(|| self.error(field, "the end of the line".into(), "a value"))
    }

    fn value<T: FromStr>(&mut self, field: &str) -> Result<T> {
        let word = self.word(field)?;
        word.parse()
            .map_err(|_| self.error(field, format!("{word:?}"), "a number in range"))
    }

    fn values<T: FromStr + Copy + Default, const N: usize>(
        &mut self,
        field: &str,
    ) -> Result<[T; N]> {
        let mut out = [T::default(); N];
        for value in &mut out {
            *value = self.value(field)?;
        }
        Ok(out)
    }

    fn error(&self, field: &str, found: String, expected: &str) -> Error {
        Error::input(
            self.path,
            format!("line {}: {field}", self.line),
            found,
            expected,
            AGAIN,
        )
    }
}

pub(crate) fn cameras(path: &Path) -> Result<Vec<ModelCamera>> {
    let mut lines = Lines::open(path)?;
    let mut cameras = Vec::new();
    while let Some(mut fields) = lines.next()? {
        let place = format!("line {}", fields.line);
        let id = fields.value("CAMERA_ID")?;
        let model = Model::from_name(fields.word("MODEL")?, path, &place)?;
        let size = fields.values("WIDTH HEIGHT")?;
        let mut params = Vec::with_capacity(model.params);
        for _ in 0..model.params {
            params.push(fields.value("PARAMS")?);
        }
        if let Some(more) = fields.rest.next() {
            let expected = format!("{} numbers for {}", model.params, model.name);
            return Err(fields.error("PARAMS", format!("{more:?} behind them"), &expected));
        }
        cameras.push(ModelCamera {
            id,
            model: model.name,
            size,
            params,
            place,
        });
    }
    Ok(cameras)
}

pub(crate) fn images(path: &Path) -> Result<Vec<PosedImage>> {
    let mut lines = Lines::open(path)?;
    let mut images = Vec::new();
    while let Some(mut fields) = lines.next()? {
        let place = format!("line {}", fields.line);
        fields.word("IMAGE_ID")?;
        let rotation = fields.values("QW QX QY QZ")?;
        let translation = fields.values("TX TY TZ")?;
        let camera = fields.value("CAMERA_ID")?;
        // Names may hold blanks.
        let name = fields.rest.by_ref().collect::<Vec<_>>().join(" ");
        if name.is_empty() {
            return Err(fields.error("NAME", "the end of the line".into(), "a file name"));
        }
        images.push(PosedImage {
            name,
            rotation,
            translation,
            camera,
            place,
        });
        // The observations: a line that may well be empty, and is never a comment. Some writers leave the last one out.
        lines.raw()?;
    }
    Ok(images)
}

/// Hands each point with its place to `take`.
pub(crate) fn points(path: &Path, take: &mut TakePoint<'_>) -> Result<()> {
    let mut lines = Lines::open(path)?;
    while let Some(mut fields) = lines.next()? {
        fields.word("POINT3D_ID")?;
        let position = fields.values("X Y Z")?;
        let color = fields.values("R G B")?;
        fields.value::<f64>("ERROR")?;
        let line = fields.line;
        take(&|| format!("line {line}"), ModelPoint { position, color })?;
    }
    Ok(())
}
