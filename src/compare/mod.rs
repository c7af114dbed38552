//! Tables of variants of stage two on the same Gaussians, features and labels: `coseg compare`.
//!
//! A [`Plan`] states a table completely. [`run`] trains stage one once for each scene, then every missing [`Cell`] on its
//! Gaussians. Each cell has a file of its own, so a table can be made in several parts. [`Tables`] holds the means and spreads of
//! the cells and writes them as JSON, Markdown and plots.

mod cells;
mod columns;
mod figures;
mod plan;
mod plots;
mod run;
mod stage_one;
mod statistics;
mod tables;

pub use self::cells::{Cell, CellId};
pub use self::figures::Figures;
pub use self::plan::{LabelKind, Plan, SceneFolder, TableRow};
pub use self::run::{Finished, Options, run};
pub use self::statistics::Statistic;
pub use self::tables::Tables;
