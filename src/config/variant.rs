//! Names of the rows of the results table.

use super::Variant;

impl std::fmt::Display for Variant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.key())
    }
}

impl Variant {
    /// What is compared by default.
    pub const COMPARED: [Self; 5] = [
        Self::Raw,
        Self::Vote,
        Self::PerGaussian,
        Self::OursCe,
        Self::Ours,
    ];
    /// What is left of it where no score can be had.
    pub const UNSCORED: [Self; 2] = [Self::Vote, Self::Ours];

    /// The row's name in `config.toml` and `metrics.json`.
    pub fn key(self) -> &'static str {
        match self {
            Self::Raw => "raw",
            Self::Vote => "vote",
            Self::PerGaussian => "per_gaussian",
            Self::OursCe => "ours_ce",
            Self::Ours => "ours",
            Self::NoImageFeatures => "no_image_features",
            Self::NoSpatial => "no_spatial",
            Self::SingleScale => "single_scale",
            Self::RandomSpatial => "random_spatial",
        }
    }

    /// What the row is, for people.
    pub fn title(self) -> &'static str {
        match self {
            Self::Raw => "raw labels",
            Self::Vote => "vote",
            Self::PerGaussian => "per-Gaussian CE",
            Self::OursCe => "ours, CE",
            Self::Ours => "ours",
            Self::NoImageFeatures => "ours without image features",
            Self::NoSpatial => "ours without spatial features",
            Self::SingleScale => "ours, one scale",
            Self::RandomSpatial => "ours, random encoder",
        }
    }
}
