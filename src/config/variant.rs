//! Variants of stage two that the label table compares.

use serde::{Deserialize, Serialize};

/// A variant of stage two: one line of the label table. All but `raw` and the votes are trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Variant {
    /// Raw labels of the test views, as they are.
    Raw,
    /// Each Gaussian takes the class with the largest summed alpha' T.
    Vote,
    /// The vote, pooled over superpoints and calibrated.
    PooledVote,
    /// Identities learned per Gaussian with CE (ablation row 1 of the paper).
    PerGaussian,
    /// Gaussian Grouping (Ye et al. 2024): a code per Gaussian, blended and classified.
    Grouping,
    /// Feature 3DGS (Zhou et al. 2024): features distilled from 2D maps, with a linear head.
    Distilled,
    /// The losses of Panoptic Lifting (Siddiqui et al. 2023) on classes of Gaussians.
    PanopticLifting,
    /// The decoder with [`SegmentationConfig::loss`](super::SegmentationConfig::loss).
    Ours,
    /// `Ours` with a free score for each Gaussian and class in place of the decoder.
    NoDecoder,
    /// `Ours` without image features.
    NoImageFeatures,
    /// `Ours` without spatial features.
    NoSpatial,
}

impl std::fmt::Display for Variant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.key())
    }
}

impl Variant {
    /// The variants compared by default.
    pub const COMPARED: [Self; 5] = [
        Self::Raw,
        Self::Vote,
        Self::PooledVote,
        Self::PerGaussian,
        Self::Ours,
    ];
    /// The default where no held-out view has a truth to score by.
    pub const UNSCORED: [Self; 2] = [Self::Vote, Self::Ours];

    /// Whether the variant trains the decoder.
    pub fn trains_decoder(self) -> bool {
        matches!(self, Self::Ours | Self::NoImageFeatures | Self::NoSpatial)
    }

    /// Whether the variant learns with [`SegmentationConfig::loss`](super::SegmentationConfig::loss), as `Ours` does.
    pub fn uses_configured_loss(self) -> bool {
        self == Self::NoDecoder || self.trains_decoder()
    }

    /// Whether the variant reads 2D image features.
    pub fn reads_image_features(self) -> bool {
        self == Self::Distilled || self.reads_lifted_features()
    }

    /// Whether the variant's decoder reads lifted image features.
    pub fn reads_lifted_features(self) -> bool {
        self.trains_decoder() && self != Self::NoImageFeatures
    }

    /// The variant's name in `config.toml` and `metrics.json`.
    pub fn key(self) -> &'static str {
        self.names()[0]
    }

    /// The variant's name in tables for people.
    pub fn title(self) -> &'static str {
        self.names()[1]
    }

    fn names(self) -> [&'static str; 2] {
        match self {
            Self::Raw => ["raw", "raw labels"],
            Self::Vote => ["vote", "vote"],
            Self::PooledVote => ["pooled_vote", "pooled vote"],
            Self::PerGaussian => ["per_gaussian", "per-Gaussian CE"],
            Self::Grouping => ["grouping", "Gaussian Grouping"],
            Self::Distilled => ["distilled", "Feature 3DGS"],
            Self::PanopticLifting => ["panoptic_lifting", "Panoptic Lifting"],
            Self::Ours => ["ours", "ours"],
            Self::NoDecoder => ["no_decoder", "ours without the decoder"],
            Self::NoImageFeatures => ["no_image_features", "ours without image features"],
            Self::NoSpatial => ["no_spatial", "ours without spatial features"],
        }
    }
}
