//! The columns of the tables.

use super::statistics::best;
use super::{Figures, Statistic};

/// A column of the tables.
pub(super) struct Column {
    /// Name in JSON.
    pub key: &'static str,
    /// Heading in Markdown.
    pub title: &'static str,
    /// The value 1 in the unit of the title.
    pub unit: f64,
    decimals: usize,
    best: Best,
    /// The figure of a cell.
    pub of: fn(&Figures) -> Option<f64>,
}

/// Which figure of a column is the best, set in bold.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Best {
    Highest,
    Lowest,
    /// Costs are not compared.
    None,
}

impl Column {
    const fn score(
        key: &'static str,
        title: &'static str,
        of: fn(&Figures) -> Option<f64>,
    ) -> Self {
        Self {
            best: Best::Highest,
            ..Self::cost(key, title, (100.0, 1), of)
        }
    }

    const fn cost(
        key: &'static str,
        title: &'static str,
        (unit, decimals): (f64, usize),
        of: fn(&Figures) -> Option<f64>,
    ) -> Self {
        Self {
            key,
            title,
            unit,
            decimals,
            best: Best::None,
            of,
        }
    }

    /// The row that is the best beyond the spread, see [`best`].
    pub fn best(&self, rows: &[Option<Statistic>], all: usize) -> Option<usize> {
        let sign = match self.best {
            Best::Highest => 1.0,
            Best::Lowest => -1.0,
            Best::None => return None,
        };
        best(rows, all, sign)
    }

    /// `52.3 ± 0.4`. A cost that is the same under all seeds has no spread.
    pub fn shown(&self, statistic: &Statistic) -> String {
        let number = |value: f64| format!("{:.*}", self.decimals, self.unit * value);
        let mean = number(statistic.mean);
        match statistic.spread {
            Some(spread) if self.best != Best::None || number(spread) != number(0.0) => {
                format!("{mean} ± {}", number(spread))
            }
            _ => mean,
        }
    }
}

pub(super) const MIOU: Column = Column::score("miou", "mIoU, %", |f| f.pixels.miou);
pub(super) const FRAMES: Column = Column::cost("frames_per_second", "frames/s", (1.0, 1), |f| {
    f.frames_per_second
});
pub(super) const SECONDS: Column = Column::cost("seconds", "seconds", (1.0, 0), Figures::seconds);

/// The columns of every table.
pub(super) static COLUMNS: [Column; 8] = [
    MIOU,
    Column::score("miou_per_view", "mIoU per view, %", |f| {
        f.pixels.miou_per_view
    }),
    Column::score("accuracy", "accuracy, %", |f| f.pixels.accuracy),
    Column::score("boundary_iou", "boundary IoU, %", |f| f.boundary_iou),
    FRAMES,
    Column::cost("learnable_bytes", "learnable, MB", (1e-6, 2), |f| {
        Some(f.learnable_bytes as f64)
    }),
    SECONDS,
    Column::cost("psnr", "PSNR, dB", (1.0, 2), |f| f.psnr),
];

/// The columns of feature fields, for tables that have some.
pub(super) static FIELD_COLUMNS: [Column; 4] = [
    Column {
        best: Best::Highest,
        ..Column::cost("calinski_harabasz", "CH", (1.0, 1), |f| {
            f.field?.calinski_harabasz
        })
    },
    Column {
        best: Best::Lowest,
        ..Column::cost("davies_bouldin", "DB", (1.0, 2), |f| {
            f.field?.davies_bouldin
        })
    },
    Column::cost("field_seconds", "features, s", (1.0, 0), |f| {
        Some(f.field?.seconds)
    }),
    Column::cost("field_bytes", "features, MB", (1e-6, 2), |f| {
        Some(f.field?.learnable_bytes as f64)
    }),
];
