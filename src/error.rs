//! The one error type of the library.
//!
//! Every variant tells the caller a different thing to do:
//! [`Error::Input`] - correct the named field of the named file; [`Error::Config`] - correct a setting;
//! [`Error::Argument`] - pass something else to the command or the function; [`Error::Missing`] - name another path;
//! [`Error::Program`] - see what the other program says;
//! [`Error::Io`] - look at the path; [`Error::Limit`] - the request does not fit, the numbers are in the message;
//! [`Error::NonFinite`] - training met a NaN or an infinity, and where; [`Error::Device`] - the backend is not usable;
//! [`Error::Stopped`] - make the same call again to continue.

use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Shorthand for results of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// All results, or the first error in their order, whichever thread met one first: a run names the same error every time.
pub(crate) fn in_order<T: Send>(
    results: impl IndexedParallelIterator<Item = Result<T>>,
) -> Result<Vec<T>> {
    results.collect::<Vec<_>>().into_iter().collect()
}

/// An error with its parts by name; each part is a format string, perhaps with arguments. [`Error::Input`] names a file and a
/// field of it: `invalid!(path, "line {line}"; found "{word:?}"; expected "a number"; help "correct the file")`.
/// [`Error::Argument`], [`Error::Config`] and [`Error::Limit`] start with `invalid!(argument "--out"; ..`, `invalid!(setting "seed"; ..`
/// and `invalid!(limit "points"; ..`.
#[doc(hidden)]
#[macro_export]
macro_rules! invalid {
    (argument $($parts:tt)+) => {
        $crate::error::invalid!(@variant Argument, name, expected; $($parts)+)
    };
    (setting $($parts:tt)+) => {
        $crate::error::invalid!(@variant Config, key, expected; $($parts)+)
    };
    (limit $($parts:tt)+) => {
        $crate::error::invalid!(@variant Limit, what, limit; $($parts)+)
    };
    (@variant $kind:ident, $name:ident, $allowed:ident; $($what:expr),+; found $($found:expr),+; expected $($expected:expr),+;
        help $($help:expr),+) => {
        $crate::error::Error::$kind {
            $name: std::fmt::format(format_args!($($what),+)),
            found: $crate::error::clipped(std::fmt::format(format_args!($($found),+))),
            $allowed: std::fmt::format(format_args!($($expected),+)),
            help: std::fmt::format(format_args!($($help),+)),
        }
    };
    ($path:expr, $($field:expr),+; found $($found:expr),+; expected $($expected:expr),+; help $($help:expr),+) => {
        $crate::error::Error::input(
            $path,
            std::fmt::format(format_args!($($field),+)),
            std::fmt::format(format_args!($($found),+)),
            std::fmt::format(format_args!($($expected),+)),
            std::fmt::format(format_args!($($help),+)),
        )
    };
}
#[doc(hidden)]
pub use invalid;

/// Returns the error that `invalid!` makes of the same parts.
#[doc(hidden)]
#[macro_export]
macro_rules! bail {
    ($($parts:tt)+) => {
        return Err($crate::error::invalid!($($parts)+))
    };
}
#[doc(hidden)]
pub use bail;

/// Returns the error that `invalid!` makes of the other parts, unless the first one holds.
#[doc(hidden)]
#[macro_export]
macro_rules! ensure {
    ($condition:expr, $($parts:tt)+) => {
        let holds: bool = $condition;
        if !holds {
            $crate::error::bail!($($parts)+);
        }
    };
}
#[doc(hidden)]
pub use ensure;

/// What went wrong, with the file, the field, what was found, what was expected and how to correct it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written.
    #[error("{}: {action} failed: {source}{}", path.display(), what_to_do(source))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was being done, such as `read` or `create`.
        action: &'static str,
        /// The system's own error.
        source: std::io::Error,
    },
    /// A file or folder that was named, or a program, is not there.
    #[error("no such {what}: {}; {help}", path.display())]
    Missing {
        /// `file`, `folder` or `program`, for instance.
        what: &'static str,
        /// Where it should be.
        path: PathBuf,
        /// What the user can do.
        help: String,
    },
    /// The content of a file cannot be used.
    #[error("{}: {field}: found {found}, expected {expected}; {help}", path.display())]
    Input {
        /// The file.
        path: PathBuf,
        /// Line, field or tensor name within it.
        field: String,
        /// What is there.
        found: String,
        /// What should be there.
        expected: String,
        /// What the user can do.
        help: String,
    },
    /// A setting, in a config file or by `--set`, has an unusable value.
    #[error("setting {key}: found {found}, expected {expected}; {help}")]
    Config {
        /// The setting, as a dotted path.
        key: String,
        /// The value given.
        found: String,
        /// What is allowed.
        expected: String,
        /// What the user can do.
        help: String,
    },
    /// What was passed to a command or to a function of the library cannot be used.
    #[error("{name}: found {found}, expected {expected}; {help}")]
    Argument {
        /// The option, with its dashes, or what the argument is.
        name: String,
        /// What was passed.
        found: String,
        /// What is allowed.
        expected: String,
        /// What the user can do.
        help: String,
    },
    /// The request is larger than this device or this format can hold.
    #[error("{what}: {found} exceeds the limit of {limit}; {help}")]
    Limit {
        /// The quantity.
        what: String,
        /// Its value.
        found: String,
        /// The largest value that works.
        limit: String,
        /// What the user can do.
        help: String,
    },
    /// A tensor holds a NaN or an infinity.
    #[error("non-finite value in {tensor}, row {row}{context}")]
    NonFinite {
        /// The tensor's name.
        tensor: String,
        /// Its first offending row.
        row: usize,
        /// View and iteration, where known; starts with `, ` when not empty.
        context: String,
    },
    /// Another program failed.
    #[error("{program} failed ({status}); its last lines: {output}; {help}")]
    Program {
        /// Its name.
        program: String,
        /// How it ended.
        status: String,
        /// The last lines that it printed.
        output: String,
        /// What the user can do.
        help: String,
    },
    /// [`Progress::stop`](crate::progress::Progress::stop) ended the work. Files of finished parts stay; the same call continues.
    #[error("stopped")]
    Stopped,
    /// The compute device is missing or refused the work.
    #[error("device {device}: {reason}; {help}")]
    Device {
        /// The requested backend.
        device: String,
        /// Why it cannot be used.
        reason: String,
        /// What the user can do.
        help: String,
    },
}

/// Characters of what was found that a message shows, at most.
const MAX_FOUND: usize = 400;

/// `text`, cut off where it is long: files may hold values of any length.
#[doc(hidden)]
pub fn clipped(mut text: String) -> String {
    if let Some((end, _)) = text.char_indices().nth(MAX_FOUND) {
        let bytes = text.len();
        text.truncate(end);
        text.push_str(&format!(".. ({bytes} bytes)"));
    }
    text
}

/// What to do about an error of the system, where its kind says so.
fn what_to_do(error: &std::io::Error) -> &'static str {
    use std::io::ErrorKind as Kind;
    match error.kind() {
        Kind::NotFound => "; check the path",
        Kind::PermissionDenied => "; change the permissions, or choose another path",
        Kind::StorageFull | Kind::QuotaExceeded => "; free some space, or choose another folder",
        Kind::IsADirectory => "; name a file",
        Kind::NotADirectory => "; name a folder",
        _ => "",
    }
}

impl Error {
    /// An [`Error::Io`] for `path`.
    pub fn io(path: impl AsRef<Path>, action: &'static str, source: std::io::Error) -> Self {
        Self::Io {
            path: path.as_ref().to_owned(),
            action,
            source,
        }
    }

    /// An [`Error::Missing`] for the `file` or `folder` at `path`.
    pub fn missing(what: &'static str, path: impl AsRef<Path>, help: impl Into<String>) -> Self {
        Self::Missing {
            what,
            path: path.as_ref().to_owned(),
            help: help.into(),
        }
    }

    /// An [`Error::Input`] naming file, field, found, expected and help.
    pub fn input(
        path: impl AsRef<Path>,
        field: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        Self::Input {
            path: path.as_ref().to_owned(),
            field: clipped(field.into()),
            found: clipped(found.into()),
            expected: expected.into(),
            help: help.into(),
        }
    }

    /// An [`Error::NonFinite`] without context.
    pub fn non_finite(tensor: impl Into<String>, row: usize) -> Self {
        Self::NonFinite {
            tensor: tensor.into(),
            row,
            context: String::new(),
        }
    }
}
