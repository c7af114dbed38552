//! The machine that figures were measured on.

use serde::Serialize;

/// Other work that keeps more than this share of one core busy spoils measurements.
const QUIET_LOAD: f64 = 0.5;

/// What a figure cannot be read without.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Machine {
    /// Model of the processor as the system names it.
    pub cpu: String,
    /// Vector instructions that kernels use, of those they know.
    pub instructions: Vec<&'static str>,
    /// Threads of the kernels.
    pub threads: usize,
    /// The backend of tensors.
    pub backend: String,
    /// Whether the program was built with optimisation.
    pub optimised: bool,
    /// Mean number of runnable processes in the minute before the start, where the system says.
    pub load: Option<f64>,
    /// Memory that could be had at the start without swapping, bytes, where the system says.
    pub available_memory_bytes: Option<u64>,
    /// Version of this crate.
    pub version: &'static str,
}

impl Machine {
    /// This one, now; `backend` names where tensors live.
    pub fn here(backend: String) -> Self {
        let cpu = std::fs::read_to_string("/proc/cpuinfo")
            .ok()
            .and_then(|text| {
                let line = text.lines().find(|line| line.starts_with("model name"))?;
                Some(line.split_once(':')?.1.trim().to_owned())
            });
        let load = std::fs::read_to_string("/proc/loadavg").ok();
        Self {
            cpu: cpu.unwrap_or_else(|| format!("unknown model ({})", std::env::consts::ARCH)),
            instructions: instructions(),
            threads: rayon::current_num_threads(),
            backend,
            optimised: !cfg!(debug_assertions),
            load: load.and_then(|text| text.split_whitespace().next()?.parse().ok()),
            available_memory_bytes: available_memory(),
            version: env!("CARGO_PKG_VERSION"),
        }
    }

    /// One or more lines for people.
    pub fn text(&self) -> String {
        let plural = if self.threads == 1 { "" } else { "s" };
        let mut out = format!(
            "{}, {} thread{plural}, {}, {} backend, coseg {}",
            self.cpu,
            self.threads,
            if self.instructions.is_empty() {
                "no wide vectors".to_owned()
            } else {
                self.instructions.join(" ")
            },
            self.backend,
            self.version,
        );
        if !self.optimised {
            out.push_str("\nBuilt without optimisation: these figures say nothing. Use --release.");
        }
        if let Some(load) = self.load.filter(|load| *load > QUIET_LOAD) {
            out.push_str(&format!(
                "\nThe machine was busy before the start (load {load:.1}): figures may be too large."
            ));
        }
        out
    }
}

/// Memory that can be had without swapping, bytes, where the system says.
pub(super) fn available_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

fn instructions() -> Vec<&'static str> {
    let mut found = Vec::new();
    #[cfg(target_arch = "x86_64")]
    for (name, there) in [
        ("AVX2", std::arch::is_x86_feature_detected!("avx2")),
        ("FMA", std::arch::is_x86_feature_detected!("fma")),
        ("AVX-512", std::arch::is_x86_feature_detected!("avx512f")),
    ] {
        if there {
            found.push(name);
        }
    }
    if cfg!(target_arch = "aarch64") {
        found.push("NEON");
    }
    found
}

/// Forgets the largest resident memory so far, so that [`crate::report::peak_memory_bytes`] tells that of what follows.
/// `false` where the system does not allow it: the peak is then that of the process so far.
pub fn reset_peak_memory() -> bool {
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}
