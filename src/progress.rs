//! Progress of a running stage, as events for its caller.

use crate::data::Scene;
use crate::error::{Error, Result};
use crate::metrics::ImageScores;
use crate::ranks;
use crate::splat::Gaussians;
use serde::{Deserialize, Serialize};

/// An event of a stage; iterations count from 1.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// A stage begins, or resumes, after `done` of `iterations`.
    Started {
        /// Name of the stage.
        stage: &'static str,
        /// Iterations done before.
        done: usize,
        /// Iterations of the whole stage.
        iterations: usize,
    },
    /// One iteration is done.
    Step {
        /// Its number.
        iteration: usize,
        /// Its training loss.
        loss: f64,
        /// Gaussians in the scene.
        gaussians: usize,
    },
    /// A stage that learns nothing has gone through one or more views.
    Viewed {
        /// Views done, each counted as often as the stage reads it.
        done: usize,
    },
    /// The number of Gaussians was reviewed.
    Reviewed(Review),
    /// The held-out views were scored.
    Evaluated(CurvePoint),
    /// A variant of the labels is done.
    Scored {
        /// Its name for people.
        variant: &'static str,
        /// Mean IoU of the held-out labels, where some have a truth.
        miou: Option<f64>,
    },
    /// A comparison begins to train this.
    Begun(String),
    /// A cell of a comparison is stored.
    Stored {
        /// Its name.
        cell: String,
        /// Mean IoU of the held-out labels, where some have a truth.
        miou: Option<f64>,
    },
    /// The stage is done. Not sent for stages that were stopped early.
    Finished,
}

/// One point of the curves of a report.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Iterations done.
    pub iteration: usize,
    /// Seconds of training so far, evaluations and earlier parts of a resumed run included.
    pub seconds: f64,
    /// Mean training loss since the point before.
    pub loss: f64,
    /// Mean scores of the held-out views.
    pub held_out: ImageScores,
    /// Mean IoU of the held-out labels, in stages that have labels.
    pub miou: Option<f64>,
    /// Gaussians in the scene.
    pub gaussians: usize,
}

/// A review of the number of Gaussians: what held-back views do not miss was left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Review {
    /// Iterations done.
    pub iteration: usize,
    /// Gaussians before it.
    pub gaussians: usize,
    /// Gaussians after it.
    pub kept: usize,
    /// Mean PSNR of the held-back views before it, dB.
    pub psnr_before: f64,
    /// The same after it.
    pub psnr_after: f64,
    /// Mean PSNR of views that are trained on before it, dB.
    pub psnr_trained: f64,
}

/// Listens to a running stage.
pub trait Progress {
    /// Called after each event.
    fn event(&mut self, event: &Event);

    /// Whether to end the run with [`Error::Stopped`]. Called after each step of training, after each view of features,
    /// unprojection and association, and between the parts of a run. A resumed run continues training from a checkpoint, and
    /// repeats a stage that learns nothing.
    fn stop(&mut self) -> bool {
        false
    }

    /// Called once the scene is loaded, and again when association has made other classes.
    fn scene(&mut self, _scene: &Scene) {}

    /// Whether to call [`Progress::gaussians`] after this iteration. Copying them costs time.
    fn wants_gaussians(&mut self) -> bool {
        false
    }

    /// Called where [`Progress::wants_gaussians`] says so, after lifting, and after each variant: the Gaussians as they are now,
    /// relative to the origin of the scene, and a label id of each once they have labels.
    fn gaussians(&mut self, _gaussians: &Gaussians, _labels: Option<&[u16]>) {}
}

/// Progress of a stage that goes through views and learns nothing.
pub(crate) struct Viewing<'p> {
    progress: &'p mut dyn Progress,
    done: usize,
}

impl<'p> Viewing<'p> {
    /// Starts a stage of `views` views, each counted as often as the stage reads it.
    pub fn begin(progress: &'p mut dyn Progress, stage: &'static str, views: usize) -> Self {
        progress.event(&Event::Started {
            stage,
            done: 0,
            iterations: views,
        });
        Self { progress, done: 0 }
    }

    /// Reports `more` views.
    ///
    /// # Errors
    /// As [`go_on`].
    pub fn advance(&mut self, more: usize) -> Result<()> {
        if more > 0 {
            self.done += more;
            self.progress.event(&Event::Viewed { done: self.done });
        }
        // Each rank goes through views of its own, and waits for no other.
        if ranks::count() > 1 {
            return Ok(());
        }
        go_on(self.progress)
    }

    /// The stage is done.
    pub fn end(self) {
        self.progress.event(&Event::Finished);
    }
}

/// Asks whether to continue; ranks agree.
///
/// # Errors
/// [`Error::Stopped`] if the work is to end.
pub(crate) fn go_on(progress: &mut dyn Progress) -> Result<()> {
    if ranks::any(progress.stop())? {
        return Err(Error::Stopped);
    }
    Ok(())
}

/// Ignores all events.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn event(&mut self, _event: &Event) {}
}
