//! Ctrl-C and other signals while `coseg train` or `coseg label` runs.

use crate::support::plates::scene;
use crate::support::program::{fails, succeeds, utf8};
use std::ffi::OsStr;
#[cfg(target_os = "linux")]
use std::fs::File;
#[cfg(feature = "serve")]
use std::io::Write;
use std::io::{BufRead, BufReader, Read};
#[cfg(feature = "serve")]
use std::net::TcpStream;
#[cfg(target_os = "linux")]
use std::os::{
    fd::AsRawFd,
    unix::{fs::OpenOptionsExt, process::CommandExt},
};
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};

/// A program that is running; it does not outlive the test.
struct Running {
    child: Child,
    said: BufReader<ChildStderr>,
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Running {
    fn start(program: &str, arguments: &[impl AsRef<OsStr>]) -> Self {
        let mut command = Command::new(program);
        let mut child = command
            .args(arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let said = BufReader::new(child.stderr.take().unwrap());
        Self { child, said }
    }

    fn coseg(arguments: &[&str]) -> Self {
        Self::start(env!("CARGO_BIN_EXE_coseg"), arguments)
    }

    /// Waits for a line that starts so, and returns it.
    #[track_caller]
    fn until(&mut self, start: &str) -> String {
        let mut said = String::new();
        for line in self.said.by_ref().lines() {
            let line = line.unwrap();
            if line.starts_with(start) {
                return line;
            }
            said += &(line + "\n");
        }
        panic!("no {start}: {said}");
    }

    fn send(&self, signal: &str) {
        send(&self.child, signal);
    }

    /// Its exit code, and the lines that were left.
    fn end(&mut self) -> (Option<i32>, String) {
        let lines: Vec<String> = self.said.by_ref().lines().map(Result::unwrap).collect();
        (self.child.wait().unwrap().code(), lines.join("\n"))
    }
}

fn send(program: &Child, signal: &str) {
    let kill = Command::new("kill")
        .args([signal, &program.id().to_string()])
        .status()
        .unwrap();
    assert!(kill.success());
}

/// A run that takes some seconds, and tells where it is after every fifth step.
fn long(data: &Path, run: &Path) -> Vec<String> {
    let sets = [
        "building.iterations=500",
        "building.eval_every=5",
        "building.random_points=200",
        "segmentation.iterations=500",
        "segmentation.eval_every=5",
        "segmentation.rows=vote,per_gaussian",
    ];
    let train = ["train", "--data", utf8(data), "--out", utf8(run)];
    train
        .into_iter()
        .chain(sets.into_iter().flat_map(|set| ["--set", set]))
        .map(str::to_owned)
        .collect()
}

#[test]
fn labelling_that_is_interrupted_is_no_error_and_its_labels_are_not_read() {
    let Some(shared) = crate::support::shared_dir() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let data = shared.join("data/house_kitchen");
    let model = shared.join("weights/deeplab_ade20k/deeplab_mnv2_ade20k.onnx");
    let labels = folder.path().join("labels");
    let [data, model] = [utf8(&data), utf8(&model)];
    let train = ["train", "--data", data, "--segmenter", model, "--out"];
    let label = ["label", "--data", data, "--model", model, "--out"];
    let is_map = |path: &Path| path.extension().is_some_and(|e| e == "png");
    for (command, out, labels, goes_on) in [
        (train, &run, run.join("labels"), "how to go on is printed"),
        (label, &labels, labels.clone(), "the same command goes on"),
    ] {
        let mut running = Running::coseg(&[&command[..], &[utf8(out)]].concat());
        let labelled = || {
            let files = std::fs::read_dir(&labels).into_iter().flatten();
            files.flatten().any(|file| is_map(&file.path()))
        };
        let clock = std::time::Instant::now();
        while !labelled() {
            assert!(clock.elapsed() < std::time::Duration::from_secs(120));
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        running.send("-INT");
        let (code, said) = running.end();
        assert_eq!(code, Some(130), "{said}");
        assert!(
            said.ends_with("stopped; the same command continues"),
            "{said}"
        );
        assert!(
            said.contains(goes_on) && !said.contains("checkpoint"),
            "{said}"
        );
        let set = format!("data.raw_labels={}", utf8(&labels));
        let message = fails(&["data", "check", data, "--set", &set], 1);
        for part in [
            "labelling was stopped",
            "same `coseg label` command again",
            "1 problem",
        ] {
            assert!(message.contains(part), "{part}: {message}");
        }
    }
}

#[test]
fn a_run_that_is_interrupted_saves_and_is_gone_on_with() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("a run");
    let arguments = long(folder.path(), &run);
    let resume = ["train", "--resume", utf8(&run)];
    let line = format!(
        "stopped; resume with: coseg train --resume '{}'",
        run.display()
    );
    let without_results = || {
        for file in [
            "report.html",
            "metrics.json",
            "viewer.html",
            "identities.safetensors",
            "renders",
        ] {
            assert!(!run.join(file).exists(), "{file} of half a run");
        }
    };
    let mut running = Running::coseg(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    running.until("building 5/");
    running.send("-INT");
    let (code, said) = running.end();
    assert_eq!(code, Some(130), "{said}");
    assert!(
        said.contains("press Ctrl-C again to stop at once") && said.ends_with(&line),
        "{said}"
    );
    assert!(
        run.join("checkpoint/building.safetensors").is_file() && run.join("scene.ply").is_file()
    );
    without_results();

    let mut running =
        Running::coseg(&[&resume[..], &["--set", "data.raw_labels_note=mine"]].concat());
    running.until("building: continues after");
    running.until("per_gaussian 5/");
    running.send("-TERM");
    let (code, said) = running.end();
    assert_eq!(code, Some(130), "{said}");
    // What the run was not begun with has to be said again.
    assert!(
        said.ends_with(&format!("{line} --set data.raw_labels_note=mine")),
        "{said}"
    );
    assert!(run.join("checkpoint/per_gaussian.safetensors").is_file());
    without_results();

    let said = succeeds(&resume);
    assert!(said.contains("per-Gaussian CE"), "{said}");
    let metrics = crate::support::program::read_json(&run.join("metrics.json"));
    let lines: Vec<_> = metrics["commands"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| c["line"].as_str().unwrap())
        .collect();
    assert_eq!(lines.len(), 3, "{lines:?}");
    assert!(run.join("report.html").is_file() && run.join("identities.safetensors").is_file());
}

#[test]
fn a_run_under_nohup_outlives_its_terminal() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    let script = r#"trap "" HUP; exec "$0" "$@""#;
    let shell = ["-c", script, env!("CARGO_BIN_EXE_coseg")].map(str::to_owned);
    let mut running = Running::start("sh", &[&shell[..], &long(folder.path(), &run)].concat());
    running.until("building 5/");
    running.send("-HUP");
    let (code, said) = running.end();
    assert_eq!(code, Some(0), "{said}");
    assert!(
        !said.contains("stopping") && run.join("report.html").is_file(),
        "{said}"
    );
}

/// The two ends of a new terminal. No other program inherits them.
#[cfg(target_os = "linux")]
fn terminal() -> (File, File) {
    let opened = |path: &str| {
        let mut options = File::options();
        // It must not become the terminal of the tests.
        options.read(true).write(true).custom_flags(libc::O_NOCTTY);
        options.open(path).unwrap()
    };
    let ours = opened("/dev/ptmx");
    let unlocked: libc::c_int = 0;
    let mut number: libc::c_uint = 0;
    // SAFETY: the descriptor is open; the calls read an int that is 0, and write the number of the other end.
    let made = unsafe {
        libc::ioctl(ours.as_raw_fd(), libc::TIOCSPTLCK, &raw const unlocked)
            | libc::ioctl(ours.as_raw_fd(), libc::TIOCGPTN, &raw mut number)
    };
    assert_eq!(made, 0);
    let theirs = opened(&format!("/dev/pts/{number}"));
    (ours, theirs)
}

#[cfg(target_os = "linux")]
#[test]
fn a_run_whose_terminal_is_closed_saves_and_ends() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let run = folder.path().join("run");
    let (mut ours, theirs) = terminal();
    let mut command = Command::new(env!("CARGO_BIN_EXE_coseg"));
    command
        .args(long(folder.path(), &run))
        .args(["--set", "building.iterations=100_000"])
        .stdout(theirs.try_clone().unwrap())
        .stderr(theirs);
    // The tests may run under `nohup`, which the program would inherit.
    // SAFETY: `signal` may be called between fork and exec.
    unsafe {
        command.pre_exec(|| {
            libc::signal(libc::SIGHUP, libc::SIG_DFL);
            Ok(())
        })
    };
    let mut child = command.spawn().unwrap();
    // The command holds its own copies of the other end.
    drop(command);
    // The bar of stage one with a held-out score.
    let mut said = Vec::new();
    while !String::from_utf8_lossy(&said).contains("held-out PSNR") {
        let mut some = [0; 1024];
        let count = ours.read(&mut some).unwrap();
        said.extend(&some[..count]);
    }
    drop(ours);
    send(&child, "-HUP");
    let clock = std::time::Instant::now();
    let ended = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break Some(status);
        }
        if clock.elapsed() > std::time::Duration::from_secs(60) {
            break None;
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    };
    let _ = child.kill();
    assert_eq!(ended.and_then(|status| status.code()), Some(130));
    assert!(run.join("checkpoint/building.safetensors").is_file());
}

/// A connection to the server of a run, which was asked for something.
#[cfg(feature = "serve")]
fn asked(address: &str, method: &str, what: &str) -> TcpStream {
    let (host, token) = address.split_once('/').unwrap();
    let request = format!(
        "{method} /{token}{what} HTTP/1.1\r\nHost: {host}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    );
    let mut stream = TcpStream::connect(host).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    stream
}

/// What it answers.
#[cfg(feature = "serve")]
fn ask(address: &str, method: &str, what: &str) -> String {
    let mut answer = String::new();
    let mut stream = asked(address, method, what);
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 20"), "{answer}");
    answer
}

#[cfg(feature = "serve")]
#[test]
fn a_run_that_is_watched_gives_the_same_scene_and_can_be_stopped() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path());
    let alone = folder.path().join("alone");
    let watched = folder.path().join("watched");
    let arguments = |run: &Path| {
        let mut arguments = long(folder.path(), run);
        arguments.extend(["--set".to_owned(), "segmentation.rows=vote".to_owned()]);
        arguments
    };
    let words: Vec<String> = arguments(&alone);
    succeeds(&words.iter().map(String::as_str).collect::<Vec<_>>());

    let mut words = arguments(&watched);
    words.push("--view".to_owned());
    let mut running = Running::start(env!("CARGO_BIN_EXE_coseg"), &words);
    let line = running.until("watch: http://127.0.0.1:");
    let address = line.strip_prefix("watch: http://").unwrap();
    while ask(address, "GET", "status").contains("\"copy\":0") {}
    // Tabs that are closed before and in the middle of an answer.
    drop(asked(address, "GET", "scene.html"));
    let mut stream = asked(address, "GET", "scene.html");
    stream.read_exact(&mut [0; 1_000]).unwrap();
    drop(stream);
    ask(address, "GET", "scene.html");
    ask(address, "POST", "stop");
    let (code, said) = running.end();
    assert_eq!(code, Some(130), "{said}");
    assert!(said.contains("stopped; resume with"), "{said}");
    succeeds(&["train", "--resume", utf8(&watched)]);
    let scene = |run: &Path| std::fs::read(run.join("scene.ply")).unwrap();
    assert!(scene(&alone) == scene(&watched), "not the same bytes");
}
