//! The progress of training: bars with held-out figures on a terminal, lines in a log.

use super::{interrupt, terminal};
use coseg::progress::{CurvePoint, Event, Progress};
use indicatif::ProgressBar;
use std::time::Instant;

/// Seconds after which a log gets a line about a stage that is silent.
const LOG_EVERY: f64 = 60.0;

/// Shows the events of a run.
#[derive(Debug, Default)]
pub struct Bars {
    stage: &'static str,
    iterations: usize,
    bar: Option<ProgressBar>,
    started: Option<Instant>,
    /// The last point of the stage's curve, where it has one.
    last: Option<CurvePoint>,
    /// Seconds from the start of the stage to the last line of a log.
    logged: f64,
}

/// Held-out figures in a few words; empty if there are none.
fn figures(point: &CurvePoint) -> String {
    let psnr = point.held_out.psnr.map(|v| format!(" PSNR {v:.2} dB"));
    let ssim = point.held_out.ssim.map(|v| format!(" SSIM {v:.3}"));
    let miou = point.miou.map(|v| format!(" mIoU {v:.3}"));
    let all: String = psnr.into_iter().chain(ssim).chain(miou).collect();
    if all.is_empty() {
        all
    } else {
        format!("held-out{all}  ")
    }
}

impl Bars {
    /// Seconds since the stage began.
    fn seconds(&self) -> f64 {
        self.started
            .map_or(0.0, |start| start.elapsed().as_secs_f64())
    }

    /// Prints in a log how far the stage is, if it was silent for long.
    fn log(&mut self, done: usize) {
        let seconds = self.seconds();
        if seconds - self.logged >= LOG_EVERY {
            self.logged = seconds;
            terminal::note(&format!(
                "{} {done}/{}  {seconds:.0} s",
                self.stage, self.iterations
            ));
        }
    }

    /// A line about a stage that is done. Without a terminal its points were printed already.
    fn print_end(&self) {
        let seconds = self.seconds();
        match &self.last {
            None => terminal::note(&format!("{}  {seconds:.1} s", self.stage)),
            Some(point) if self.bar.is_some() => self.print(point, seconds),
            Some(_) => {}
        }
    }

    /// A line about a point of the stage's curve.
    fn print(&self, point: &CurvePoint, seconds: f64) {
        terminal::note(&format!(
            "{} {}/{}  loss {:.4}  {}{} Gaussians  {seconds:.0} s",
            self.stage,
            point.iteration,
            self.iterations,
            point.loss,
            figures(point),
            point.gaussians
        ));
    }

    fn clear(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}

impl Drop for Bars {
    /// Removes the bar of a stage that was stopped or failed.
    fn drop(&mut self) {
        self.clear();
    }
}

impl Progress for Bars {
    fn stop(&mut self) -> bool {
        interrupt::stop_requested()
    }

    fn event(&mut self, event: &Event) {
        match event {
            Event::Started {
                stage,
                done,
                iterations,
            } => {
                self.clear();
                self.stage = stage;
                self.iterations = *iterations;
                self.started = Some(Instant::now());
                self.last = None;
                self.logged = 0.0;
                if terminal::draws_bars() {
                    let bar = terminal::bar(stage, *iterations as u64);
                    bar.set_position(*done as u64);
                    bar.reset_eta();
                    self.bar = Some(bar);
                } else if *done > 0 {
                    terminal::note(&format!("{stage}: continues after {done} of {iterations}"));
                }
            }
            Event::Step {
                iteration: done, ..
            }
            | Event::Viewed { done } => match &self.bar {
                Some(bar) => bar.set_position(*done as u64),
                None => self.log(*done),
            },
            Event::Evaluated(point) => {
                self.last = Some(*point);
                self.logged = self.seconds();
                match &self.bar {
                    Some(bar) => bar.set_message(figures(point)),
                    None => self.print(point, point.seconds),
                }
            }
            Event::Reviewed(review) if self.bar.is_none() => terminal::note(&format!(
                "{} {}/{}  {} of {} Gaussians stay, held-back PSNR {:.2} to {:.2} dB",
                self.stage,
                review.iteration,
                self.iterations,
                review.kept,
                review.gaussians,
                review.psnr_before,
                review.psnr_after
            )),
            Event::Finished => {
                self.print_end();
                self.clear();
            }
            Event::Begun(what) => terminal::note(what),
            Event::Stored { cell, miou } => {
                let miou = miou.map(|miou| format!("mIoU {miou:.3}"));
                terminal::note(&format!("{cell}: {}", miou.unwrap_or("no score".into())));
            }
            _ => {}
        }
    }
}
