//! Events of a run for a callback, and how a run is stopped.

use coseg::progress::{self, Progress};
use pyo3::prelude::*;
use pyo3::types::PyBool;

/// An event of a run.
#[pyclass(frozen, get_all, module = "coseg")]
#[derive(Clone, Debug, Default)]
pub struct Event {
    kind: &'static str,
    stage: &'static str,
    step: usize,
    total: usize,
    loss: Option<f64>,
    gaussians: Option<usize>,
    psnr: Option<f64>,
    ssim: Option<f64>,
    miou: Option<f64>,
    variant: Option<&'static str>,
}

#[pymethods]
impl Event {
    fn __repr__(&self) -> String {
        let Self {
            kind,
            stage,
            step,
            total,
            ..
        } = self;
        format!("<coseg.Event {kind}: {stage} {step}/{total}>")
    }
}

/// Passes events on to a callback of Python. The run stops after Ctrl-C, where the callback returns False, and where it raises.
pub struct Callback {
    function: Option<Py<PyAny>>,
    /// The last event, which has the stage, step and total of the next one.
    last: Event,
    stopped: bool,
    /// What Ctrl-C or the callback raised.
    raised: Option<PyErr>,
}

impl Callback {
    pub fn new(function: Option<Py<PyAny>>) -> Self {
        Self {
            function,
            last: Event::default(),
            stopped: false,
            raised: None,
        }
    }

    /// What stopped the run, where it was an exception.
    pub fn raised(self) -> Option<PyErr> {
        self.raised
    }

    fn call(&self, event: Event) -> PyResult<bool> {
        let Some(function) = &self.function else {
            return Ok(true);
        };
        Python::attach(|py| {
            let answer = function.call1(py, (event,))?;
            Ok(!answer.bind(py).is(PyBool::new(py, false)))
        })
    }

    /// The event in the form of Python, at the place of the last one where it has none of its own.
    fn form(&self, event: &progress::Event) -> Option<Event> {
        use progress::Event as Of;
        let here = Event {
            stage: self.last.stage,
            step: self.last.step,
            total: self.last.total,
            ..Event::default()
        };
        Some(match event {
            Of::Started {
                stage,
                done,
                iterations,
            } => Event {
                kind: "started",
                stage,
                step: *done,
                total: *iterations,
                ..here
            },
            Of::Step {
                iteration,
                loss,
                gaussians,
            } => Event {
                kind: "step",
                step: *iteration,
                loss: Some(*loss),
                gaussians: Some(*gaussians),
                ..here
            },
            Of::Viewed { done } => Event {
                kind: "viewed",
                step: *done,
                ..here
            },
            Of::Reviewed(review) => Event {
                kind: "reviewed",
                step: review.iteration,
                gaussians: Some(review.kept),
                psnr: Some(review.psnr_after),
                ..here
            },
            Of::Evaluated(point) => Event {
                kind: "evaluated",
                step: point.iteration,
                loss: Some(point.loss),
                gaussians: Some(point.gaussians),
                psnr: point.held_out.psnr,
                ssim: point.held_out.ssim,
                miou: point.miou,
                ..here
            },
            Of::Scored { variant, miou } => Event {
                kind: "scored",
                variant: Some(variant),
                miou: *miou,
                ..here
            },
            Of::Finished => Event {
                kind: "finished",
                ..here
            },
            _ => return None,
        })
    }
}

impl Progress for Callback {
    fn event(&mut self, event: &progress::Event) {
        let Some(event) = self.form(event).filter(|_| !self.stopped) else {
            return;
        };
        self.last = event.clone();
        match self.call(event) {
            Ok(goes_on) => self.stopped = !goes_on,
            Err(error) => (self.stopped, self.raised) = (true, Some(error)),
        }
    }

    fn stop(&mut self) -> bool {
        if !self.stopped
            && let Err(interrupt) = Python::attach(|py| py.check_signals())
        {
            (self.stopped, self.raised) = (true, Some(interrupt));
        }
        self.stopped
    }
}
