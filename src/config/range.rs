//! Ranges of numbers in the settings. Each section names the range of its fields beside them.

use crate::error::{Error, Result};

/// Allowed values of a number.
#[derive(Clone, Copy, Debug)]
pub(super) enum Range {
    /// 1 or more.
    Positive,
    /// Finite and above 0.
    AboveZero,
    /// Finite and 0 or more.
    NotNegative,
    /// Above 0 and below 1.
    OpenUnit,
    /// Above 0, 1 at most.
    Share,
    /// From the first to the second, both allowed.
    Within(f64, f64),
}

pub(super) const POSITIVE: Range = Range::Positive;
pub(super) const ABOVE_ZERO: Range = Range::AboveZero;
pub(super) const NOT_NEGATIVE: Range = Range::NotNegative;
pub(super) const OPEN_UNIT: Range = Range::OpenUnit;
pub(super) const SHARE: Range = Range::Share;
pub(super) const UNIT: Range = Range::Within(0.0, 1.0);

/// A number of the settings.
pub(super) trait Number: Copy + std::fmt::Display {
    /// For comparison with the ends of a range.
    fn as_f64(self) -> f64;
}

impl Number for f64 {
    fn as_f64(self) -> f64 {
        self
    }
}

impl Number for f32 {
    fn as_f64(self) -> f64 {
        self.into()
    }
}

impl Number for usize {
    fn as_f64(self) -> f64 {
        self as f64
    }
}

impl Range {
    /// Refuses a `value` outside the range.
    ///
    /// # Errors
    /// [`Error::Config`] naming `key`.
    pub fn check(self, key: &str, value: impl Number) -> Result<()> {
        let v = value.as_f64();
        let (inside, expected) = match self {
            Self::Positive => (v >= 1.0, "a whole number above 0".to_owned()),
            Self::AboveZero => (
                v > 0.0 && v.is_finite(),
                "a finite number above 0".to_owned(),
            ),
            Self::NotNegative => (
                v >= 0.0 && v.is_finite(),
                "a finite number of 0 or more".to_owned(),
            ),
            Self::OpenUnit => (
                v > 0.0 && v < 1.0,
                "a number above 0 and below 1".to_owned(),
            ),
            Self::Share => (
                v > 0.0 && v <= 1.0,
                "a number above 0, at most 1".to_owned(),
            ),
            Self::Within(low, high) => (
                v >= low && v <= high,
                format!("a number from {low} to {high}"),
            ),
        };
        if inside {
            return Ok(());
        }
        let help = "leave the key out for the default";
        Err(Error::config(key, value.to_string(), expected, help))
    }
}

/// Checks fields of a section: an error names `section.field`.
macro_rules! checked {
    ($config:expr, $section:literal: { $($field:ident: $range:ident),* $(,)? }) => {
        $(
            $crate::config::range::$range
                .check(concat!($section, ".", stringify!($field)), $config.$field)?;
        )*
    };
}
pub(super) use checked;
