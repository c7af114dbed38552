//! The progress of training on a terminal: bars that carry held-out figures, or plain lines in a log.

use super::terminal;
use coseg::train::progress::{CurvePoint, Event, Progress};
use indicatif::ProgressBar;

/// Shows the events of a run.
#[derive(Debug, Default)]
pub struct Bars {
    stage: &'static str,
    iterations: usize,
    bar: Option<ProgressBar>,
}

/// Held-out figures in a few words.
fn figures(point: &CurvePoint) -> String {
    let psnr = point.held_out.psnr.map(|v| format!("PSNR {v:.2} dB"));
    let ssim = point.held_out.ssim.map(|v| format!("SSIM {v:.3}"));
    let miou = point.miou.map(|v| format!("mIoU {:.1} %", 100.0 * v));
    psnr.into_iter().chain(ssim).chain(miou).collect::<Vec<_>>().join("  ")
}

impl Bars {
    fn clear(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}

impl Progress for Bars {
    fn event(&mut self, event: &Event) {
        match event {
            Event::Started { stage, done, iterations } => {
                self.clear();
                (self.stage, self.iterations) = (stage, *iterations);
                if terminal::draws_bars() {
                    let bar = terminal::bar(stage, *iterations as u64);
                    bar.set_position(*done as u64);
                    bar.reset_eta();
                    self.bar = Some(bar);
                } else if *done > 0 {
                    terminal::note(&format!("{stage}: goes on after {done} of {iterations}"));
                }
            }
            Event::Step { iteration, .. } => {
                if let Some(bar) = &self.bar {
                    bar.set_position(*iteration as u64);
                }
            }
            Event::Evaluated(point) => match &self.bar {
                Some(bar) => bar.set_message(format!("held-out {}", figures(point))),
                None => terminal::note(&format!(
                    "{} {}/{}  loss {:.4}  held-out {}  {} Gaussians  {:.0} s",
                    self.stage,
                    point.iteration,
                    self.iterations,
                    point.loss,
                    figures(point),
                    point.gaussians,
                    point.seconds
                )),
            },
            Event::Densified { .. } | Event::Saved { .. } => {}
            Event::Finished => self.clear(),
            _ => {}
        }
    }
}
