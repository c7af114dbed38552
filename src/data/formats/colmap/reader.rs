//! Reads the values of a model file in order, for both forms: `.bin` is little-endian with counts first,
//! `.txt` has one item in each line, two lines for each image, and comments after `#`.

use super::DAMAGED_HELP;
use crate::error::{Error, Result, invalid};
use num_traits::FromBytes;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::str::FromStr;

/// Longest name of an image, in bytes: beyond what file systems have.
const NAME: usize = 4_096;

/// A number that both forms hold.
pub(super) trait Number: FromStr + FromBytes<Bytes: Sized + Default> {}
impl<T: FromStr + FromBytes<Bytes: Sized + Default>> Number for T {}

/// A file that is read item by item.
pub(super) enum Reader<'p> {
    Binary(Binary<'p>),
    Text(Text<'p>),
}

pub(super) struct Binary<'p> {
    path: &'p Path,
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

pub(super) struct Text<'p> {
    path: &'p Path,
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
        let measured = file.metadata().map_err(|e| Error::io(path, "measure", e));
        let length = measured?.len();
        let reader = BufReader::with_capacity(1 << 18, file);
        if path.extension().is_some_and(|extension| extension == "txt") {
            return Ok(Self::Text(Text {
                path,
                reader,
                line: 0,
                rest: String::new(),
            }));
        }
        let mut binary = Binary {
            path,
            reader,
            at: 0,
            length,
            item,
            count: 0,
            begun: 0,
            start: 0,
        };
        binary.count = binary.count(smallest, &format!("number of {item}s"))?;
        Ok(Self::Binary(binary))
    }

    /// Number of items, if the file gives it in advance.
    pub fn count(&self) -> Option<u64> {
        match self {
            Self::Binary(binary) => Some(binary.count),
            Self::Text(_) => None,
        }
    }

    /// Goes to the next item; `false` at the end of the file.
    pub fn next(&mut self) -> Result<bool> {
        match self {
            Self::Binary(binary) => binary.next(),
            Self::Text(text) => text.next(),
        }
    }

    /// Where the item begins, for messages.
    pub fn place(&self) -> String {
        match self {
            Self::Binary(b) => format!("{} {} at byte {}", b.item, b.begun - 1, b.start),
            Self::Text(text) => format!("line {}", text.line),
        }
    }

    pub fn value<T: Number>(&mut self, field: &str) -> Result<T> {
        match self {
            Self::Binary(binary) => binary.value(field),
            Self::Text(text) => {
                let word = text.word(field)?;
                let fault = |_| text.error(field, &format!("{word:?}"), "a number in range");
                word.parse().map_err(fault)
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
        match self {
            Self::Binary(binary) => binary.value("MODEL").map(name),
            Self::Text(text) => text.word("MODEL"),
        }
    }

    /// A file name: UTF-8 up to a zero byte, or the rest of the line, as names may hold blanks.
    pub fn name(&mut self) -> Result<String> {
        match self {
            Self::Binary(binary) => binary.name(),
            Self::Text(text) => {
                let words: Vec<&str> = text.rest.split_ascii_whitespace().collect();
                let missing = || text.error("NAME", "the end of the line", "a file name");
                (!words.is_empty())
                    .then(|| words.join(" "))
                    .ok_or_else(missing)
            }
        }
    }

    /// Refuses a text item that has more words than were read.
    pub fn expect_end(&self, field: &str, expected: &str) -> Result<()> {
        match self {
            Self::Text(text) if !text.rest.is_empty() => {
                Err(text.error(field, &format!("{:?} behind them", text.rest), expected))
            }
            _ => Ok(()),
        }
    }

    /// Skips a list of entries of `each` bytes; in text it takes the line after that of the item, which may be empty.
    pub fn skip_list(&mut self, each: u64, field: &str, own_line: bool) -> Result<()> {
        match self {
            Self::Binary(binary) => {
                let entries = binary.count(each, &format!("number of {field}"))?;
                binary.skip(entries * each)
            }
            // Some writers leave the last of these lines out.
            Self::Text(text) if own_line => text.next_line().map(|_| ()),
            Self::Text(_) => Ok(()),
        }
    }
}

impl Binary<'_> {
    fn next(&mut self) -> Result<bool> {
        if self.begun < self.count {
            self.begun += 1;
            self.start = self.at;
            return Ok(true);
        }
        let more = self.length.saturating_sub(self.at);
        let expected = "the file's end: another version of the format, or a damaged file";
        match more {
            0 => Ok(false),
            more => Err(self.error("end", &format!("{more} bytes more"), expected)),
        }
    }

    fn error(&self, field: &str, found: &str, expected: &str) -> Error {
        invalid!(self.path, "{field} at byte {}", self.at; found "{found}"; expected "{expected}"; help "{DAMAGED_HELP}")
    }

    fn value<T: Number>(&mut self, field: &str) -> Result<T> {
        let mut bytes = T::Bytes::default();
        let wanted = bytes.as_ref().len() as u64;
        let left = self.length.saturating_sub(self.at);
        if left < wanted {
            let found = format!("the file's end after {left} bytes");
            return Err(self.error(field, &found, &format!("{wanted} bytes more")));
        }
        let read = self.reader.read_exact(bytes.as_mut());
        read.map_err(|e| Error::io(self.path, "read", e))?;
        self.at += wanted;
        Ok(T::from_le_bytes(&bytes))
    }

    /// A number of entries of at least `each` bytes, which the rest of the file must be able to hold.
    fn count(&mut self, each: u64, field: &str) -> Result<u64> {
        let start = self.at;
        let count: u64 = self.value(field)?;
        let left = self.length.saturating_sub(self.at);
        if count <= left / each {
            return Ok(count);
        }
        self.at = start;
        let expected = format!("at most {}, what {left} bytes can hold", left / each);
        Err(self.error(field, &count.to_string(), &expected))
    }

    /// Skips `bytes` that are known to be there.
    fn skip(&mut self, bytes: u64) -> Result<()> {
        let offset = i64::try_from(bytes).map_err(std::io::Error::other);
        let skipped = offset.and_then(|offset| self.reader.seek_relative(offset));
        self.at += bytes;
        skipped.map_err(|e| Error::io(self.path, "seek", e))
    }

    fn name(&mut self) -> Result<String> {
        let start = self.at;
        let mut bytes = Vec::new();
        while let byte @ 1.. = self.value("NAME")? {
            bytes.push(byte);
            if bytes.len() > NAME {
                self.at = start;
                let found = format!("more than {NAME} bytes");
                return Err(self.error("NAME", &found, "a file name that ends in a zero byte"));
            }
        }
        String::from_utf8(bytes).map_err(|e| {
            self.at = start;
            self.error("NAME", &e.to_string(), "a file name in UTF-8")
        })
    }
}

impl Text<'_> {
    /// Goes to the next line with an item.
    fn next(&mut self) -> Result<bool> {
        while self.next_line()? {
            if !(self.rest.is_empty() || self.rest.starts_with('#')) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Reads the next line; `false` at the end of the file.
    fn next_line(&mut self) -> Result<bool> {
        let mut line = String::new();
        let read = self.reader.read_line(&mut line);
        let read = read.map_err(|e| Error::io(self.path, "read", e))?;
        self.line += 1;
        self.rest = line.trim().to_owned();
        Ok(read > 0)
    }

    fn error(&self, field: &str, found: &str, expected: &str) -> Error {
        invalid!(self.path, "line {}: {field}", self.line; found "{found}"; expected "{expected}"; help "{DAMAGED_HELP}")
    }

    fn word(&mut self, field: &str) -> Result<String> {
        if self.rest.is_empty() {
            return Err(self.error(field, "the end of the line", "a value"));
        }
        let parts = self.rest.split_once(|c: char| c.is_ascii_whitespace());
        let (word, rest) = parts.unwrap_or((&self.rest, ""));
        let word = word.to_owned();
        self.rest = rest.trim_start().to_owned();
        Ok(word)
    }
}
