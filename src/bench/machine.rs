//! The machine that figures were measured on.

use serde::Serialize;

/// Other work that keeps more than this share of one core busy spoils measurements.
const MAX_OTHER_LOAD: f64 = 0.5;

/// What a reader of the figures has to know.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Machine {
    /// Model of the processor as the system names it.
    pub cpu: String,
    /// Threads of the kernels.
    pub threads: usize,
    /// The backend of tensors.
    pub backend: String,
    /// Whether the program was built with optimisation.
    pub optimised: bool,
    /// Mean number of runnable processes in the last minute, where the system reports it.
    pub load: Option<f64>,
    /// Version of this crate.
    pub version: &'static str,
}

impl Machine {
    /// This one, now; `backend` names where tensors live.
    pub fn here(backend: String) -> Self {
        let cpu = first_line("/proc/cpuinfo", "model name")
            .and_then(|line| Some(line.split_once(':')?.1.trim().to_owned()));
        let load = first_line("/proc/loadavg", "");
        Self {
            cpu: cpu.unwrap_or_else(|| format!("unknown {}", std::env::consts::ARCH)),
            threads: rayon::current_num_threads(),
            backend,
            optimised: !cfg!(debug_assertions),
            load: load.and_then(|line| line.split(' ').next()?.parse().ok()),
            version: env!("CARGO_PKG_VERSION"),
        }
    }

    /// One or more lines of text.
    pub fn text(&self) -> String {
        let mut out = format!(
            "{}, {} threads, {} backend, coseg {}",
            self.cpu, self.threads, self.backend, self.version,
        );
        if !self.optimised {
            out.push_str("\nThis is a debug build: the figures mean nothing. Use --release.");
        }
        if let Some(load) = self.load.filter(|load| *load > MAX_OTHER_LOAD) {
            out.push_str(&format!(
                "\nOther programs are running (load {load:.1}): times may be too long."
            ));
        }
        out
    }
}

fn first_line(path: &str, prefix: &str) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find(|line| line.starts_with(prefix))?;
    Some(line.to_owned())
}

/// Makes [`crate::report::peak_memory_bytes`] count from now on. Where the system does not allow that, it counts on.
pub(super) fn reset_peak_memory() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}
