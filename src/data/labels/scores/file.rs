//! The file with the scores of one photo.
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files::{MAX_IMAGE_PIXELS, atomic, check_limit};
use flate2::Compression;
use flate2::bufread::ZlibDecoder;
use flate2::write::ZlibEncoder;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::io::{self, Read, Write};
use std::path::Path;

/// Key of the metadata: `Header` as JSON.
const KEY: &str = "coseg scores 1";
/// Bytes of the names, shapes and metadata in front of the tensors, at most.
const HEADER: u64 = 1 << 16;
/// What to do about a file that is damaged.
const DAMAGED_HELP: &str = "delete it and run `coseg label` again, or copy it again";

/// Where the cells of a grid of scores lie on a photo.
///
/// The point of the photo with pixel coordinates (x, y), pixel centres at half integers, has the grid coordinates
/// `scale * (x, y) + offset`. Cell (column i, row j) is at (i, j).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScoreGrid {
    /// Pixels across and down of the photo.
    pub photo: [usize; 2],
    /// Cells for each pixel, across and down.
    pub scale: [f64; 2],
    /// Cells, across and down.
    pub offset: [f64; 2],
}

/// What the file says beside its tensors.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    grid: ScoreGrid,
    id_limit: u32,
}

/// The best classes of each cell of a segmenter's output for one photo, with their probabilities.
#[derive(Clone, Debug, PartialEq)]
pub struct ScoreMap {
    /// Where the cells lie.
    pub grid: ScoreGrid,
    /// Cells across.
    pub width: usize,
    /// Cells down.
    pub height: usize,
    /// Classes of each cell.
    pub classes: usize,
    /// All ids are below it.
    pub id_limit: u32,
    /// Class ids `[classes, height, width]`, the most probable first. Ids of probability 0 mean nothing.
    pub ids: Vec<u16>,
    /// Probabilities in 1/255, `[classes, height, width]`. Those of a cell descend and add up to 255 at most. The rest belongs to
    /// classes that are not stored.
    pub probabilities: Vec<u8>,
}

impl ScoreMap {
    /// Reads a file that [`ScoreMap::write`] made.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Limit`] for more cells than [`MAX_IMAGE_PIXELS`]; [`Error::Input`] for a file that is cut
    /// off or damaged, tensors of other types or shapes, a grid that is not finite, and probabilities that ascend or
    /// add up to more than 255.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = inflate(path)?;
        let damaged = |e: safetensors::SafeTensorError| invalid!(path, "header"; found "{e}"; expected "scores of a photo as `coseg label` writes them"; help "{DAMAGED_HELP}");
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
        let header = header.metadata().as_ref().and_then(|all| all.get(KEY));
        let header = header.ok_or_else(|| {
            invalid!(path, "metadata"; found "no entry {KEY:?}"; expected "this version of the file"; help "{DAMAGED_HELP}")
        })?;
        let Header { grid, id_limit } = serde_json::from_str(header).map_err(|e| {
            invalid!(path, "metadata"; found "{e}"; expected "grid and id_limit"; help "{DAMAGED_HELP}")
        })?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(damaged)?;
        let (ids, shape) = tensor(path, &tensors, "ids", Dtype::U16)?;
        let (probabilities, of_probabilities) = tensor(path, &tensors, "probabilities", Dtype::U8)?;
        ensure!(of_probabilities == shape,
            path, "tensor probabilities"; found "shape {of_probabilities:?}"; expected "{shape:?}, as of ids";
            help "{DAMAGED_HELP}");
        let [classes, height, width] = shape;
        let ids = ids.as_chunks::<2>().0.iter().copied();
        let scores = Self {
            grid,
            id_limit,
            width,
            height,
            classes,
            ids: ids.map(u16::from_le_bytes).collect(),
            probabilities: probabilities.to_vec(),
        };
        scores.check(path)?;
        Ok(scores)
    }

    /// Writes the file: safetensors, compressed by zlib. In Python: `safetensors.numpy.load(zlib.decompress(bytes))`.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] and [`Error::Limit`] for scores that [`ScoreMap::read`] refuses.
    pub fn write(&self, path: &Path) -> Result<()> {
        atomic::write_bytes(path, &self.encode(path)?)
    }

    /// The bytes of the file; `path` names it in errors.
    pub(crate) fn encode(&self, path: &Path) -> Result<Vec<u8>> {
        self.check(path)?;
        let encode = |e: String| Error::io(path, "encode", io::Error::other(e));
        let ids: Vec<u8> = self.ids.iter().flat_map(|id| id.to_le_bytes()).collect();
        let shape = vec![self.classes, self.height, self.width];
        let tensor = |kind, bytes| {
            TensorView::new(kind, shape.clone(), bytes).map_err(|e| encode(e.to_string()))
        };
        let tensors = [
            ("ids", tensor(Dtype::U16, &ids)?),
            ("probabilities", tensor(Dtype::U8, &self.probabilities)?),
        ];
        let header = Header {
            grid: self.grid,
            id_limit: self.id_limit,
        };
        let header = serde_json::to_string(&header).map_err(|e| encode(e.to_string()))?;
        let metadata = HashMap::from([(KEY.to_owned(), header)]);
        let bytes =
            safetensors::serialize(tensors, Some(metadata)).map_err(|e| encode(e.to_string()))?;
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        let written = encoder.write_all(&bytes).and_then(|()| encoder.finish());
        written.map_err(|e| Error::io(path, "encode", e))
    }

    /// Refuses what the fields cannot be.
    fn check(&self, path: &Path) -> Result<()> {
        let cells = (self.width as u64).saturating_mul(self.height as u64);
        let values = cells.saturating_mul(self.classes as u64);
        let help = "store fewer classes of each cell";
        check_limit(path, "scores", values, MAX_IMAGE_PIXELS, help)?;
        let lengths = [self.ids.len(), self.probabilities.len()];
        ensure!(values > 0 && lengths.map(|n| n as u64) == [values; 2], path, "tensors";
            found "{lengths:?} values of {} classes, {}x{} cells", self.classes, self.width, self.height;
            expected "one value for each class and cell, at least one"; help "{DAMAGED_HELP}");
        let numbers = self.grid.scale.into_iter().chain(self.grid.offset);
        let is_placed = numbers.clone().all(f64::is_finite)
            && self.grid.scale.into_iter().all(|scale| scale > 0.0);
        ensure!(is_placed && !self.grid.photo.contains(&0), path, "grid"; found "{:?}", self.grid;
            expected "a photo with pixels, finite numbers, a positive scale"; help "{DAMAGED_HELP}");
        (0..self.width * self.height).try_for_each(|cell| self.check_cell(path, cell))
    }

    /// Refuses probabilities and ids that a cell cannot have.
    fn check_cell(&self, path: &Path, cell: usize) -> Result<()> {
        let cells = self.width * self.height;
        let at = |n: usize| n * cells + cell;
        let place = format!("column {}, row {}", cell % self.width, cell / self.width);
        let probabilities = (0..self.classes).map(|n| self.probabilities[at(n)]);
        let sum: u32 = probabilities.clone().map(u32::from).sum();
        if sum > 255 || !probabilities.clone().is_sorted_by(|a, b| a >= b) {
            let found = probabilities.collect::<Vec<_>>();
            bail!(path, "tensor probabilities, {place}"; found "{found:?}";
                expected "probabilities in 1/255 that descend and add up to 255 at most"; help "{DAMAGED_HELP}");
        }
        let known = (0..self.classes).filter(|n| self.probabilities[at(*n)] > 0);
        let ids: Vec<u16> = known.map(|n| self.ids[at(n)]).collect();
        let is_fault = |n: usize| u32::from(ids[n]) >= self.id_limit || ids[..n].contains(&ids[n]);
        ensure!(!(0..ids.len()).any(is_fault), path, "tensor ids, {place}"; found "{ids:?}";
            expected "different class ids below {}", self.id_limit; help "{DAMAGED_HELP}");
        Ok(())
    }
}

/// The bytes of a compressed file, no more than scores may take. The file must end where its stream does.
fn inflate(path: &Path) -> Result<Vec<u8>> {
    let most = 3 * MAX_IMAGE_PIXELS + HEADER;
    let help = "store fewer classes of each cell";
    let size = std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?;
    check_limit(path, "bytes", size.len(), most, help)?;
    let file = crate::files::read(path)?;
    let damaged = |found: String| invalid!(path, "compressed data"; found "{found}"; expected "a complete file of scores"; help "{DAMAGED_HELP}");
    let mut stream = ZlibDecoder::new(&file[..]);
    let mut bytes = Vec::new();
    let mut content = stream.by_ref().take(most.saturating_add(1));
    let read = content.read_to_end(&mut bytes);
    read.map_err(|e| damaged(e.to_string()))?;
    check_limit(path, "bytes", bytes.len() as u64, most, help)?;
    let is_whole = stream.get_ref().is_empty();
    is_whole
        .then_some(bytes)
        .ok_or_else(|| damaged("data after the end".to_owned()))
}

/// Bytes and shape of a tensor of three dimensions.
fn tensor<'a>(
    path: &Path,
    all: &SafeTensors<'a>,
    name: &str,
    kind: Dtype,
) -> Result<(&'a [u8], [usize; 3])> {
    let field = format!("tensor {name}");
    let view = all.tensor(name).map_err(|e| {
        invalid!(path, "{field}"; found "{e}"; expected "a tensor of this name"; help "{DAMAGED_HELP}")
    })?;
    match <[usize; 3]>::try_from(view.shape()) {
        Ok(shape) if view.dtype() == kind => Ok((view.data(), shape)),
        _ => {
            bail!(path, "{field}"; found "{:?} {:?}", view.dtype(), view.shape();
                expected "{kind:?} [classes, height, width]"; help "{DAMAGED_HELP}")
        }
    }
}
