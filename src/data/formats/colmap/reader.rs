//! Reads the values of a model file in order, for both forms: `.bin` is little-endian with counts first,
//! `.txt` has one item in each line, two lines for each image, and comments behind `#`.

use super::DAMAGED_HELP;
use crate::error::{Error, Result, ensure, invalid};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::str::FromStr;

/// Longest name of an image, in bytes: beyond what file systems have.
const NAME: usize = 4_096;

/// A number that both forms hold.
pub(super) trait Number: FromStr {
    fn read(bytes: &mut Binary, path: &Path, field: &str) -> Result<Self>;
}

macro_rules! number {
    ($($t:ty)*) => {
        $(impl Number for $t {
            fn read(bytes: &mut Binary, path: &Path, field: &str) -> Result<Self> {
                bytes.take(path, field).map(Self::from_le_bytes)
            }
        })*
    };
}
number!(u8 i32 u32 u64 f64);

/// A file that is read item by item.
pub(super) struct Reader<'p> {
    path: &'p Path,
    form: Form,
}

enum Form {
    Binary(Binary),
    Text(Text),
}

pub(super) struct Binary {
    reader: BufReader<File>,
    at: u64,
    length: u64,
    /// What the items are called in messages.
    item: &'static str,
    /// Number of items, how many were started, and where the last one starts.
    count: u64,
    begun: u64,
    start: u64,
}

struct Text {
    reader: BufReader<File>,
    /// Number of the current line, from 1.
    line: usize,
    /// What is left of the line.
    rest: String,
}

impl<'p> Reader<'p> {
    /// Opens a file of items; a binary one takes at least `smallest` bytes for each `item`.
    pub fn open(path: &'p Path, item: &'static str, smallest: u64) -> Result<Self> {
        let file = crate::files::open(path)?;
        let length = file
            .metadata()
            .map_err(|e| Error::io(path, "measure", e))?
            .len();
        let reader = BufReader::with_capacity(1 << 18, file);
        if path.extension().is_some_and(|extension| extension == "txt") {
            let text = Text {
                reader,
                line: 0,
                rest: String::new(),
            };
            return Ok(Self {
                path,
                form: Form::Text(text),
            });
        }
        let mut binary = Binary {
            reader,
            at: 0,
            length,
            item,
            count: 0,
            begun: 0,
            start: 0,
        };
        binary.count = binary.count(path, smallest, &format!("number of {item}s"))?;
        Ok(Self {
            path,
            form: Form::Binary(binary),
        })
    }

    /// Number of items, if the file gives it in advance.
    pub fn count(&self) -> Option<u64> {
        match &self.form {
            Form::Binary(binary) => Some(binary.count),
            Form::Text(_) => None,
        }
    }

    /// Goes to the next item; `false` at the end of the file.
    pub fn next(&mut self) -> Result<bool> {
        let path = self.path;
        match &mut self.form {
            Form::Binary(binary) => binary.next(path),
            Form::Text(text) => loop {
                if !text.next_line(path)? {
                    return Ok(false);
                }
                if !(text.rest.is_empty() || text.rest.starts_with('#')) {
                    return Ok(true);
                }
            },
        }
    }

    /// Where the item begins, for messages.
    pub fn place(&self) -> String {
        match &self.form {
            Form::Binary(b) => format!("{} {} at byte {}", b.item, b.begun - 1, b.start),
            Form::Text(text) => format!("line {}", text.line),
        }
    }

    pub fn value<T: Number>(&mut self, field: &str) -> Result<T> {
        let path = self.path;
        match &mut self.form {
            Form::Binary(binary) => T::read(binary, path, field),
            Form::Text(text) => {
                let word = text.word(path, field)?;
                word.parse().map_err(|_| {
                    invalid!(path, "line {}: {field}", text.line; found "{word:?}";
                        expected "a number in range"; help "{DAMAGED_HELP}")
                })
            }
        }
    }

    pub fn values<T: Number + Copy + Default, const N: usize>(
        &mut self,
        field: &str,
    ) -> Result<[T; N]> {
        let mut values = [T::default(); N];
        for value in &mut values {
            *value = self.value(field)?;
        }
        Ok(values)
    }

    /// The name of a camera model: binary files have its number, which `name` translates.
    pub fn model(&mut self, name: impl Fn(i32) -> String) -> Result<String> {
        let path = self.path;
        match &mut self.form {
            Form::Binary(binary) => i32::read(binary, path, "MODEL").map(name),
            Form::Text(text) => text.word(path, "MODEL"),
        }
    }

    /// A file name: UTF-8 up to a zero byte, or the rest of the line, as names may hold blanks.
    pub fn name(&mut self) -> Result<String> {
        let path = self.path;
        match &mut self.form {
            Form::Binary(binary) => binary.name(path),
            Form::Text(text) => {
                let name = text
                    .rest
                    .split_ascii_whitespace()
                    .collect::<Vec<_>>()
                    .join(" ");
                ensure!(!name.is_empty(), path, "line {}: NAME", text.line; found "the end of the line";
                    expected "a file name"; help "{DAMAGED_HELP}");
                Ok(name)
            }
        }
    }

    /// Refuses a text item that has more words than were read.
    pub fn expect_end(&mut self, field: &str, expected: &str) -> Result<()> {
        match &self.form {
            Form::Text(text) if !text.rest.is_empty() => Err(
                invalid!(self.path, "line {}: {field}", text.line; found "{:?} behind them", text.rest;
                    expected "{expected}"; help "{DAMAGED_HELP}"),
            ),
            _ => Ok(()),
        }
    }

    /// Skips a list of entries of `each` bytes; in text it takes the line after that of the item, which may be empty.
    pub fn skip_list(&mut self, each: u64, field: &str, own_line: bool) -> Result<()> {
        let path = self.path;
        match &mut self.form {
            Form::Binary(binary) => {
                let entries = binary.count(path, each, &format!("number of {field}"))?;
                binary.skip(path, entries * each)
            }
            // Some writers leave the last of these lines out.
            Form::Text(text) if own_line => text.next_line(path).map(|_| ()),
            Form::Text(_) => Ok(()),
        }
    }
}

impl Binary {
    fn next(&mut self, path: &Path) -> Result<bool> {
        if self.begun < self.count {
            self.begun += 1;
            self.start = self.at;
            return Ok(true);
        }
        match self.length.saturating_sub(self.at) {
            0 => Ok(false),
            more => Err(self.error(
                path,
                "end",
                &format!("{more} bytes more"),
                "the file's end: another version of the format, or a damaged file",
            )),
        }
    }

    fn error(&self, path: &Path, field: &str, found: &str, expected: &str) -> Error {
        invalid!(path, "{field} at byte {}", self.at; found "{found}"; expected "{expected}"; help "{DAMAGED_HELP}")
    }

    fn take<const N: usize>(&mut self, path: &Path, field: &str) -> Result<[u8; N]> {
        let left = self.length.saturating_sub(self.at);
        if left < N as u64 {
            let found = format!("the file's end after {left} bytes");
            return Err(self.error(path, field, &found, &format!("{N} bytes more")));
        }
        let mut bytes = [0; N];
        self.reader
            .read_exact(&mut bytes)
            .map_err(|e| Error::io(path, "read", e))?;
        self.at += N as u64;
        Ok(bytes)
    }

    /// A number of entries of at least `each` bytes, which the rest of the file must be able to hold.
    fn count(&mut self, path: &Path, each: u64, field: &str) -> Result<u64> {
        let start = self.at;
        let count = u64::read(self, path, field)?;
        let left = self.length.saturating_sub(self.at);
        if count <= left / each {
            return Ok(count);
        }
        self.at = start;
        let expected = format!("at most {}, what {left} bytes can hold", left / each);
        Err(self.error(path, field, &count.to_string(), &expected))
    }

    /// Skips `bytes` that are known to be there.
    fn skip(&mut self, path: &Path, bytes: u64) -> Result<()> {
        let offset = i64::try_from(bytes).map_err(std::io::Error::other);
        let skipped = offset.and_then(|offset| self.reader.seek_relative(offset));
        self.at += bytes;
        skipped.map_err(|e| Error::io(path, "seek", e))
    }

    fn name(&mut self, path: &Path) -> Result<String> {
        let start = self.at;
        let mut bytes = Vec::new();
        loop {
            match self.take(path, "NAME")? {
                [0] => break,
                [byte] => bytes.push(byte),
            }
            if bytes.len() > NAME {
                self.at = start;
                let found = format!("more than {NAME} bytes");
                return Err(self.error(
                    path,
                    "NAME",
                    &found,
                    "a file name that ends in a zero byte",
                ));
            }
        }
        String::from_utf8(bytes).map_err(|e| {
            self.at = start;
            self.error(path, "NAME", &e.to_string(), "a file name in UTF-8")
        })
    }
}

impl Text {
    /// Reads the next line; `false` at the end of the file.
    fn next_line(&mut self, path: &Path) -> Result<bool> {
        let mut line = String::new();
        let read = self
            .reader
            .read_line(&mut line)
            .map_err(|e| Error::io(path, "read", e))?;
        self.line += 1;
        self.rest = line.trim().to_owned();
        Ok(read > 0)
    }

    fn word(&mut self, path: &Path, field: &str) -> Result<String> {
        ensure!(!self.rest.is_empty(), path, "line {}: {field}", self.line; found "the end of the line";
            expected "a value"; help "{DAMAGED_HELP}");
        let end = self
            .rest
            .find(|c: char| c.is_ascii_whitespace())
            .unwrap_or(self.rest.len());
        let word = self.rest[..end].to_owned();
        self.rest.replace_range(..end, "");
        let blanks = self.rest.len() - self.rest.trim_start().len();
        self.rest.replace_range(..blanks, "");
        Ok(word)
    }
}
