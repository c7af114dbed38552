//! Many faults of a few kinds, printed by kind.

use super::terminal;
use coseg::Error;
use coseg::files;
use std::mem::{Discriminant, discriminant};
use std::path::Path;

/// Faults of one kind that are printed by default.
const MAX_SHOWN: usize = 3;

/// Faults of the same kind differ only in their frame, file or pixel.
type FaultKind = (Discriminant<Error>, String, String, String);

/// Prints the first few faults of each kind and how many more there are, or all of them.
pub fn print(faults: &[Error], all: bool) {
    let mut groups: Vec<(FaultKind, Vec<&Error>)> = Vec::new();
    for fault in faults {
        let kind = kind(fault);
        match groups.iter_mut().find(|(of, _)| *of == kind) {
            Some((_, group)) => group.push(fault),
            None => groups.push((kind, vec![fault])),
        }
    }
    for (_, group) in groups {
        // A single further fault is printed: the line that counts it would be as long.
        let shown = if all || group.len() == MAX_SHOWN + 1 {
            group.len()
        } else {
            MAX_SHOWN
        };
        for fault in group.iter().take(shown) {
            terminal::error(fault);
        }
        if group.len() > shown {
            let more = group.len() - shown;
            terminal::note(&format!(
                "error: .. and {more} more like it (--all shows them)"
            ));
        }
    }
}

fn kind(fault: &Error) -> FaultKind {
    let (path, field, help) = match fault {
        Error::Input {
            path, field, help, ..
        } => (folder(path), field.as_str(), help.as_str()),
        Error::Missing { path, what, help } => (folder(path), *what, help.as_str()),
        Error::Io { path, action, .. } => (folder(path), *action, ""),
        Error::Config { key, help, .. }
        | Error::Argument {
            name: key, help, ..
        } => (String::new(), key.as_str(), help.as_str()),
        other => {
            let text = other.to_string();
            return (discriminant(other), String::new(), text, String::new());
        }
    };
    (discriminant(fault), plain(&path), plain(field), plain(help))
}

/// Its folder. Masks have a folder for each photo, which are usually numbered.
fn folder(path: &Path) -> String {
    files::folder(path).display().to_string()
}

/// `text` without numbers and names in brackets: `frames[3] (images/a.png).file_path` is the field of many frames.
fn plain(text: &str) -> String {
    let mut depth = 0_usize;
    let keep = |c: &char| {
        match c {
            '(' | '[' => depth += 1,
            ')' | ']' => depth = depth.saturating_sub(1),
            _ => return depth == 0 && !c.is_ascii_digit(),
        }
        false
    };
    text.chars().filter(keep).collect()
}
