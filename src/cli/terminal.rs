//! Output: lines, warnings, errors, and progress bars.

use coseg::ranks;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{self, IsTerminal, Write};
use std::sync::{LazyLock, OnceLock};

/// All bars; lines are printed above them.
static BARS: LazyLock<MultiProgress> =
    LazyLock::new(|| MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(4)));

/// The first error of standard output, except for a closed pipe.
static FAILURE: OnceLock<io::Error> = OnceLock::new();

/// Calls `write` without the bars, which are drawn again at their next step. `MultiProgress::suspend` panics if the terminal is gone.
fn above_bars<T>(write: impl FnOnce() -> T) -> T {
    let _ = BARS.clear();
    write()
}

/// Prints a line of the result on standard output. A closed pipe ends the output, not the work.
pub fn say(line: &str) {
    let line = escaped(line);
    let written = above_bars(|| writeln!(io::stdout(), "{line}"));
    if let Err(error) = written
        && error.kind() != io::ErrorKind::BrokenPipe
    {
        let _ = FAILURE.set(error);
    }
}

/// Prints each line of a result.
pub fn say_lines(text: &str) {
    text.lines().for_each(say);
}

/// What went wrong with standard output.
///
/// # Errors
/// [`coseg::Error::Io`].
pub fn finish() -> coseg::Result<()> {
    match FAILURE.get() {
        Some(error) => {
            let error = io::Error::new(error.kind(), error.to_string());
            Err(coseg::Error::io("standard output", "write", error))
        }
        None => Ok(()),
    }
}

/// Prints a line on standard error. Of several ranks only the first one does: the others would say the same.
pub fn note(line: &str) {
    if ranks::index() == 0 {
        print(line);
    }
}

fn print(line: &str) {
    let line = escaped(line);
    above_bars(|| {
        let _ = writeln!(io::stderr(), "{line}");
    });
}

/// `line` with its control characters as JSON writes them: names of files and classes may have some, which would command the
/// terminal.
pub fn escaped(line: &str) -> String {
    let commands =
        |c: char| c.is_control() || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let shown = |c: char| match c {
        '\n' => "\\n".to_owned(),
        c if commands(c) => format!("\\u{:04x}", u32::from(c)),
        c => c.to_string(),
    };
    line.chars().map(shown).collect()
}

/// Prints an error.
pub fn error(error: &coseg::Error) {
    match ranks::index() {
        0 => note(&format!("error: {error}")),
        rank => print(&format!("error of rank {rank}: {error}")),
    }
}

/// Reports a panic as a fault of this program, with a trace only if RUST_BACKTRACE asks for it.
pub fn report_panics() {
    let trace = std::env::var_os("RUST_BACKTRACE").is_some_and(|v| v != "0");
    let default = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        if coseg::segmenter::is_guarded() {
            return;
        }
        let place = info
            .location()
            .map_or(String::new(), |l| format!(" at {}:{}", l.file(), l.line()));
        print(&format!(
            "error: coseg {} has an internal error{place}: {}",
            env!("CARGO_PKG_VERSION"),
            info.payload_as_str().unwrap_or("no message"),
        ));
        note(
            "This is a bug. Please report it with the command line. Checkpoints and results written before are intact.",
        );
        if trace {
            default(info);
        }
    }));
}

/// Shows the library's warnings above the bars, with `verbose` its other messages too.
pub fn show_warnings(verbose: bool) {
    let level = if verbose {
        tracing::Level::INFO
    } else {
        tracing::Level::WARN
    };
    let color = io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    tracing_subscriber::fmt()
        .with_max_level(level)
        .with_target(false)
        .without_time()
        .with_ansi(color)
        .with_writer(|| AboveBars(Vec::new()))
        .init();
}

/// Collects one message and writes it above the bars.
struct AboveBars(Vec<u8>);

impl Write for AboveBars {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for AboveBars {
    fn drop(&mut self) {
        if ranks::index() > 0 {
            return;
        }
        // The colours of the message are commands too; those in its text are escaped before.
        let text = String::from_utf8_lossy(&self.0);
        let line = text.trim_end_matches('\n').replace('\n', "\\n");
        above_bars(|| {
            let _ = writeln!(io::stderr(), "{line}");
        });
    }
}

/// Whether bars can be drawn.
pub fn draws_bars() -> bool {
    io::stderr().is_terminal()
}

/// A bar of `steps`; hidden when standard error is not a terminal.
pub fn bar(name: &str, steps: u64) -> ProgressBar {
    let bar = BARS.add(ProgressBar::new(steps));
    let template = "{prefix:>14} {bar:28} {pos}/{len} {elapsed_precise} left {eta_precise} {msg}";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("━╸─"));
    }
    bar.set_prefix(name.to_owned());
    bar
}
