//! What a job will allocate, compared with the memory of this machine before the job starts.

use crate::error::{Result, ensure};

/// Bytes of a value.
const FLOAT: u64 = size_of::<f32>() as u64;

/// Refuses a stage one of `gaussians` with harmonics of `sh_degree`, whose parameters alone do not fit. Gradients and moments may be on
/// a device with memory of its own.
///
/// # Errors
/// [`crate::Error::Limit`].
pub(crate) fn check_building(gaussians: usize, sh_degree: usize) -> Result<()> {
    let parameters = 11 + 3 * (sh_degree + 1).pow(2);
    let what = format!("memory of {gaussians} Gaussians");
    let help = "lower building.max_gaussians or building.random_points";
    check(&what, &[gaussians, parameters], help)
}

/// Refuses `tables` of scores, of each Gaussian for each class.
///
/// # Errors
/// [`crate::Error::Limit`].
pub(crate) fn check_scores(gaussians: usize, classes: usize, tables: usize) -> Result<()> {
    let what =
        format!("memory of {tables} tables of scores, {gaussians} Gaussians by {classes} classes");
    let help = "have fewer classes, Gaussians or segmentation.rows";
    check(&what, &[gaussians, classes, tables], help)
}

/// Refuses as many values as the product of `counts` where the system tells that less memory is free.
fn check(what: &str, counts: &[usize], help: &str) -> Result<()> {
    let counts = counts.iter().map(|&count| count as u64);
    let bytes = counts.fold(FLOAT, u64::saturating_mul);
    let available = proc_bytes("/proc/meminfo", "MemAvailable:");
    within(what, bytes, available, help)
}

fn within(what: &str, bytes: u64, available: Option<u64>, help: &str) -> Result<()> {
    let most = available.unwrap_or(u64::MAX);
    let megabytes = |bytes: u64| format!("{} MB", bytes.div_ceil(1_000_000));
    ensure!(bytes <= most, limit "{what}"; found "{}", megabytes(bytes);
        expected "{}, which this machine has free", megabytes(most); help "{help}");
    Ok(())
}

/// The bytes in the line of `file` that begins with `key`, where the system has such a file.
pub(crate) fn proc_bytes(file: &str, key: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_beyond_the_memory_are_refused_with_figures() {
        let free = Some(3_000_000);
        within("a table", 3_000_000, free, "shrink it").expect("it fits");
        within("a table", u64::MAX, None, "shrink it").expect("nobody knows");
        let error = within("a table", 3_000_001, free, "shrink it").expect_err("too large");
        let message = error.to_string();
        let parts = ["a table", "4 MB", "3 MB", "shrink it"];
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        // No machine has these.
        check_scores(1 << 40, 65_535, 3).expect_err("too large");
        check_building(usize::MAX, 3).expect_err("too large");
    }
}
