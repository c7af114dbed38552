//! Scalar columns of a PLY element, read and written in blocks of rows, for point clouds and Gaussian scenes.
//!
//! The format itself is `ply-rs-bw`'s. Its rows are addressed by property name. Here every wanted property is renamed once to its
//! column number, in a private copy of the element definition. So no row compares names.

use super::{check_points, kind, open};
use crate::error::{Error, Result, bail, invalid};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    Addable, ElementDef, Encoding, Header, PropertyAccess, PropertyAccessResult, PropertyDef,
    PropertyType, ScalarType,
};
use ply_rs_bw::writer::Writer;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Seek, Write};
use std::path::{Path, PathBuf};

/// Rows parsed at once; bounds the memory beside the caller's own.
const BLOCK: usize = 2_048;

/// One row of `N` columns. Every PLY scalar type fits an `f64` exactly.
#[derive(Clone, Debug)]
pub(crate) struct Row<const N: usize>(pub [f64; N]);

/// Column number of a renamed property: its key is one character, which costs nothing to read millions of times.
fn slot(key: &str) -> Option<usize> {
    let mut chars = key.chars();
    match (chars.next(), chars.next()) {
        (Some(c), None) => Some(c as usize),
        _ => None,
    }
}

fn slot_key(column: usize) -> String {
    // Columns number far fewer than the first gap in `char`.
    char::from_u32(column as u32).map_or_else(String::new, String::from)
}

impl<const N: usize> Row<N> {
    fn set(&mut self, key: &str, value: f64) -> PropertyAccessResult {
        match slot(key).and_then(|i| self.0.get_mut(i)) {
            Some(cell) => {
                *cell = value;
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::Ignored,
        }
    }

    fn get(&self, key: &str) -> Option<f64> {
        slot(key).and_then(|i| self.0.get(i)).copied()
    }
}

macro_rules! setters {
    ($($name:ident: $t:ty),*) => {
        $(fn $name(&mut self, key: &str, value: $t) -> PropertyAccessResult { self.set(key, f64::from(value)) })*
    };
}

impl<const N: usize> PropertyAccess for Row<N> {
    fn new() -> Self {
        Self([0.0; N])
    }
    setters!(set_char: i8, set_uchar: u8, set_short: i16, set_ushort: u16, set_int: i32, set_uint: u32,
        set_float: f32, set_double: f64);
    fn get_uchar(&self, key: &str) -> Option<u8> {
        self.get(key).map(|v| v as u8)
    }
    fn get_ushort(&self, key: &str) -> Option<u16> {
        self.get(key).map(|v| v as u16)
    }
    fn get_float(&self, key: &str) -> Option<f32> {
        self.get(key).map(|v| v as f32)
    }
    fn get_double(&self, key: &str) -> Option<f64> {
        self.get(key)
    }
}

/// A PLY file whose header was read: the wanted element can be asked for its columns, then read once.
pub(crate) struct PlyFile {
    path: PathBuf,
    reader: Reader<BufReader<File>>,
    header: Header,
    element: String,
}

impl PlyFile {
    /// Opens `path` and reads the header up to `end_header`; `element` (such as `vertex`) must be declared.
    pub fn open(path: &Path, element: &str) -> Result<Self> {
        let file = open(path)?;
        let mut file = BufReader::with_capacity(1 << 20, file);
        let first = file.fill_buf().map_err(|e| Error::io(path, "read", e))?;
        // A file that begins like one and is cut off, or has other line ends, has a bad header.
        if !first.starts_with(b"ply") {
            let other = if first.is_empty() {
                "an empty file"
            } else {
                "another kind of file"
            };
            bail!(path, "first bytes"; found "{}", kind(first).unwrap_or(other);
                expected "a PLY file"; help "give the .ply file, such as the scene.ply of a run");
        }
        let mut reader = Reader::new(file);
        let header = Parser::<Row<0>>::new().read_header(&mut reader).map_err(|e| {
            let line = e.line().map_or_else(String::new, |line| format!(", line {line}"));
            invalid!(path, "header{line}"; found "{}", cause(&e.to_string()); expected "a PLY header";
                help "export the file again")
        })?;
        let Some(def) = header.elements.get(element) else {
            let found: Vec<_> = header.elements.keys().map(String::as_str).collect();
            bail!(path, "header"; found "elements [{}]", found.join(", ");
                expected "an element `{element}`"; help "export the file as a point cloud or Gaussian scene");
        };
        check_points(path, def.count as u64)?;
        Ok(Self {
            path: path.to_owned(),
            reader,
            header,
            element: element.into(),
        })
    }

    fn def(&self) -> &ElementDef {
        &self.header.elements[&self.element]
    }

    /// Whether the header declares this element.
    pub fn has_element(&self, name: &str) -> bool {
        self.header.elements.contains_key(name)
    }

    /// Scalar type of a column; `None` when there is no such scalar column.
    pub fn scalar(&self, name: &str) -> Option<&ScalarType> {
        match &self.def().properties.get(name)?.data_type {
            PropertyType::Scalar(t) => Some(t),
            PropertyType::List(..) => None,
        }
    }

    /// Names of all columns, in file order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.def().properties.keys().map(String::as_str)
    }

    /// Header comments, in file order.
    pub fn comments(&self) -> &[String] {
        &self.header.comments
    }

    /// Reads every row and hands it to `each` with its number. Cell `i` of a row is column `columns[i]`; a `None`
    /// stays 0. Columns that are not named are ignored.
    ///
    /// # Errors
    /// A named column is absent, the file ends early or a value does not parse; whatever `each` returns.
    pub fn read<const N: usize>(
        mut self,
        columns: &[Option<String>; N],
        mut each: impl FnMut(usize, &[f64; N]) -> Result<()>,
    ) -> Result<()> {
        if let Some(missing) = columns
            .iter()
            .flatten()
            .find(|name| self.scalar(name).is_none())
        {
            let found: Vec<_> = self.names().collect();
            bail!(&self.path, "element {}", self.element; found "columns [{}]", found.join(", ");
                expected "a scalar column `{missing}`"; help "export it with this column");
        }
        self.check_size()?;
        let parser = Parser::<Row<N>>::new();
        let elements: Vec<ElementDef> = self.header.elements.values().cloned().collect();
        for mut element in elements {
            let is_wanted = element.name == self.element;
            let column = |name: &str| {
                columns
                    .iter()
                    .position(|column| column.as_deref() == Some(name))
            };
            let properties: Vec<_> = element.properties.drain(..).collect();
            for (place, (name, def)) in properties.into_iter().enumerate() {
                let key = column(&name).filter(|_| is_wanted).map(slot_key);
                let key = key.unwrap_or_else(|| format!("ignored {place}"));
                element.properties.insert(key, def);
            }
            if is_wanted {
                return self.blocks(&parser, &element, |i, row: &Row<N>| each(i, &row.0));
            }
            self.blocks(&parser, &element, |_, _| Ok(()))?;
        }
        Ok(())
    }

    fn blocks<const N: usize>(
        &mut self,
        parser: &Parser<Row<N>>,
        def: &ElementDef,
        mut each: impl FnMut(usize, &Row<N>) -> Result<()>,
    ) -> Result<()> {
        // Rows without columns take no bytes in a binary file, so their number is not bounded by its size.
        let rows = def.count * usize::from(!def.properties.is_empty());
        let mut block = def.clone();
        for first in (0..rows).step_by(BLOCK) {
            block.count = BLOCK.min(rows - first);
            let parsed = parser.read_payload_for_element(&mut self.reader, &block, &self.header).map_err(|e| {
                invalid!(&self.path, "element {}, rows {first} to {}", def.name, first + block.count - 1;
                    found "{}", cause(&e.to_string()); expected "{rows} complete rows";
                    help "the file is damaged or cut off (in ascii files, nan and inf count as damage); copy or export it again")
            })?;
            for (i, row) in parsed.iter().enumerate() {
                each(first + i, row)?;
            }
        }
        Ok(())
    }

    /// The size of a binary file of scalar columns follows from its header. A file of another size is refused before anything is
    /// read. Much longer files have rows with more in them than declared, such as a column name used twice.
    fn check_size(&mut self) -> Result<()> {
        let unreadable = |e| Error::io(&self.path, "measure", e);
        let file = self.reader.get_mut();
        let start = file.stream_position().map_err(unreadable)?;
        let length = file.get_ref().metadata().map_err(unreadable)?.len();
        if self.header.encoding == Encoding::Ascii {
            return Ok(());
        }
        let mut expected = u128::from(start);
        let mut rows = 0;
        for element in self.header.elements.values() {
            let sizes = element.properties.values();
            let sizes = sizes.map(|property| size_of_scalar(&property.data_type));
            let Some(stride) = sizes.sum::<Option<u128>>() else {
                return Ok(());
            };
            expected += element.count as u128 * stride;
            rows += element.count as u128;
        }
        let length = u128::from(length);
        let help = if length < expected {
            "the file is cut off; copy or export it again"
        } else if rows > 1 && length >= expected + rows {
            "rows are longer than declared (a column name used twice?); export it again"
        } else {
            return Ok(());
        };
        Err(
            invalid!(&self.path, "size"; found "{length} bytes"; expected "{expected} bytes"; help "{help}"),
        )
    }
}

/// Bytes of a property; `None` for a list.
fn size_of_scalar(property: &PropertyType) -> Option<u128> {
    match property {
        PropertyType::Scalar(ScalarType::Char | ScalarType::UChar) => Some(1),
        PropertyType::Scalar(ScalarType::Short | ScalarType::UShort) => Some(2),
        PropertyType::Scalar(ScalarType::Int | ScalarType::UInt | ScalarType::Float) => Some(4),
        PropertyType::Scalar(ScalarType::Double) => Some(8),
        PropertyType::List(..) => None,
    }
}

/// The cause in a message of the parser, without the whole lines of the file that it quotes.
fn cause(message: &str) -> String {
    let first = message.lines().next().unwrap_or_default();
    let detail = message
        .rsplit_once("Error: ")
        .and_then(|(_, detail)| detail.lines().next());
    let text = [first, detail.unwrap_or_default()].join(" ");
    // The rest is the parser's own bookkeeping.
    let text = text.split("ParseError {").next().unwrap_or_default();
    text.trim().chars().take(300).collect()
}

/// Writes one element `vertex` as binary little-endian PLY. `fill(i, row)` sets the cells of row `i`.
///
/// Cells of type float, double, uchar and ushort are rounded to those types.
pub(crate) fn write<const N: usize, W: Write>(
    out: &mut W,
    rows: usize,
    columns: &[(String, ScalarType)],
    comments: Vec<String>,
    mut fill: impl FnMut(usize, &mut [f64; N]),
) -> io::Result<()> {
    let mut named = ElementDef::new("vertex".into());
    named.count = rows;
    let mut renamed = named.clone();
    for (i, (name, scalar)) in columns.iter().enumerate() {
        let def = PropertyDef::new(name.clone(), PropertyType::Scalar(scalar.clone()));
        named.properties.add(def.clone());
        renamed.properties.insert(slot_key(i), def);
    }
    let mut header = Header::new();
    header.encoding = Encoding::BinaryLittleEndian;
    header.comments = comments;
    header.elements.add(named);
    let writer = Writer::<Row<N>>::new();
    writer.write_header(out, &header)?;
    let mut row = Row([0.0; N]);
    for i in 0..rows {
        fill(i, &mut row.0);
        writer.write_little_endian_element(out, &row, &renamed)?;
    }
    Ok(())
}
