//! Runs of the program, with what they say and write.

use coseg::backend::device::BackendName;
use std::path::Path;
use std::process::{Command, Output};

/// Runs the command.
fn coseg(arguments: &[&str]) -> Output {
    coseg_in(Path::new("."), arguments)
}

/// Runs the command in a folder.
pub fn coseg_in(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_coseg"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

/// Output of the program as text.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs, expects success, and returns standard output.
#[track_caller]
pub fn succeeds(arguments: &[&str]) -> String {
    let output = coseg(arguments);
    assert!(
        output.status.success(),
        "{arguments:?}: {}",
        text(&output.stderr)
    );
    text(&output.stdout)
}

/// Runs, expects success, and returns standard error.
#[track_caller]
pub fn warnings(arguments: &[&str]) -> String {
    let output = coseg(arguments);
    let message = text(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {message}");
    message
}

/// Runs, expects `code`, and returns standard error, which must not show a panic or a trace.
#[track_caller]
pub fn fails(arguments: &[&str], code: i32) -> String {
    let output = coseg(arguments);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
    assert!(message.contains("error: "), "{message}");
    assert!(
        !message.contains("panicked") && !message.contains("fault of its own"),
        "{message}"
    );
    message
}

/// Names of the files in a folder, except hidden ones, in order.
pub fn listed(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.filter(|name| !name.starts_with('.')).collect();
    names.sort();
    names
}

/// The path as an argument.
pub fn utf8(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Shape and values of an NPY file.
pub fn read_npy(path: &Path) -> (Vec<u64>, Vec<f32>) {
    let file =
        npyz::NpyFile::new(std::io::BufReader::new(std::fs::File::open(path).unwrap())).unwrap();
    (file.shape().to_vec(), file.into_vec().unwrap())
}

/// The value in a JSON file.
pub fn read_json(path: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// The name of a CPU backend.
pub fn cpu_backend() -> String {
    BackendName::compiled()
        .iter()
        .rfind(|name| **name != BackendName::Wgpu)
        .unwrap()
        .to_string()
}
