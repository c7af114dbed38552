//! Ranges of numbers in the settings. Each section names the range of its fields beside them.

use crate::error::{Result, ensure};
use num_traits::AsPrimitive;
use std::fmt::Display;

/// Largest number of views of an optimiser step.
pub(super) const MAX_BATCH: f64 = 65_536.0;

/// Allowed values of a number.
#[derive(Clone, Copy, Debug)]
pub(super) enum Range {
    /// From 1 to 2^32 - 1.
    Positive,
    /// Finite and above 0.
    AboveZero,
    /// Finite and 0 or more.
    NotNegative,
    /// Above 0 and below 1.
    OpenUnit,
    /// Above 0, 1 at most.
    Share,
    /// From 0 to 1, both allowed.
    Unit,
    /// From the first to the second, both allowed.
    Within(f64, f64),
}

impl Range {
    /// Refuses a `value` outside the range.
    ///
    /// # Errors
    /// [`crate::Error::Config`] naming `key`.
    pub fn check(self, key: &str, value: impl AsPrimitive<f64> + Display) -> Result<()> {
        let v: f64 = value.as_();
        let inside = match self {
            Self::Positive => (1.0..=f64::from(u32::MAX)).contains(&v),
            Self::AboveZero => v > 0.0 && v.is_finite(),
            Self::NotNegative => v >= 0.0 && v.is_finite(),
            Self::OpenUnit => v > 0.0 && v < 1.0,
            Self::Share => v > 0.0 && v <= 1.0,
            Self::Unit => (0.0..=1.0).contains(&v),
            Self::Within(low, high) => (low..=high).contains(&v),
        };
        let expected = match self {
            Self::Positive => "a whole number above 0, fewer than 2^32",
            Self::AboveZero => "a finite number above 0",
            Self::NotNegative => "a finite number of 0 or more",
            Self::OpenUnit => "a number above 0 and below 1",
            Self::Share => "a number above 0, at most 1",
            Self::Unit => "a number from 0 to 1",
            Self::Within(low, high) => &format!("a number from {low} to {high}"),
        };
        ensure!(inside, setting "{key}"; found "{value}"; expected "{expected}";
            help "leave the key out for the default");
        Ok(())
    }
}

/// Checks fields of a section: an error names `section.field`.
macro_rules! checked {
    ($config:expr, $section:literal: { $($field:ident: $range:ident),* $(,)? }) => {
        $(
            $crate::config::range::Range::$range
                .check(concat!($section, ".", stringify!($field)), $config.$field)?;
        )*
    };
}
pub(super) use checked;
