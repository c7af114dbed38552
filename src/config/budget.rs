//! How many Gaussians a scene may have.

use serde::{Deserialize, Serialize};
use std::fmt;

/// The largest number of Gaussians: a rule, or a number from 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Value", into = "Value")]
pub enum Budget {
    /// Held-back training views decide ([`crate::reconstruction`]).
    #[default]
    Auto,
    /// As many as densification makes.
    Unlimited,
    /// No more than this. Larger initial clouds are thinned to it.
    AtMost(usize),
}

/// What a setting may say.
pub(super) const EXPECTED: &str = "\"auto\", \"unlimited\" or a number from 1";

/// A [`Budget`] as files have it.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Value {
    Number(i64),
    Name(String),
}

impl Budget {
    /// The number, where there is one.
    pub fn limit(self) -> Option<usize> {
        match self {
            Self::AtMost(limit) => Some(limit),
            Self::Auto | Self::Unlimited => None,
        }
    }
}

impl fmt::Display for Budget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Unlimited => f.write_str("unlimited"),
            Self::AtMost(limit) => limit.fmt(f),
        }
    }
}

impl TryFrom<Value> for Budget {
    type Error = String;

    fn try_from(value: Value) -> Result<Self, String> {
        match value {
            Value::Name(name) if name == "auto" => Ok(Self::Auto),
            Value::Name(name) if name == "unlimited" => Ok(Self::Unlimited),
            Value::Name(name) => Err(format!("found {name:?}, expected {EXPECTED}")),
            Value::Number(number) => usize::try_from(number)
                .map(Self::AtMost)
                .map_err(|_| format!("found {number}, expected {EXPECTED}")),
        }
    }
}

impl From<Budget> for Value {
    fn from(budget: Budget) -> Self {
        match budget {
            Budget::AtMost(limit) => Self::Number(limit as i64),
            rule => Self::Name(rule.to_string()),
        }
    }
}
