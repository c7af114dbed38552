//! Several ranks against one, by the program itself.

use crate::support::plates::scene;
use crate::support::program::{cpu_backend, read_json, text, utf8};
use crate::support::skip_without_program;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// `coseg` on `ranks` ranks, or by itself on one; `None` without `mpirun`.
fn command(ranks: usize, arguments: &[&str]) -> Option<Command> {
    let program = env!("CARGO_BIN_EXE_coseg");
    let mut command = match ranks {
        1 => Command::new(program),
        _ => {
            if Command::new("mpirun").arg("--version").output().is_err() {
                skip_without_program("mpirun is not there");
                return None;
            }
            let mut command = Command::new("mpirun");
            command.args(["--oversubscribe", "-n", &ranks.to_string(), program]);
            command
        }
    };
    command.args(arguments).args(["--backend", &cpu_backend()]);
    // For containers whose only user is root.
    command.env("OMPI_ALLOW_RUN_AS_ROOT", "1");
    command.env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
    Some(command)
}

fn run(ranks: usize, arguments: &[&str]) -> Option<Output> {
    Some(command(ranks, arguments)?.output().unwrap())
}

#[track_caller]
fn succeeds(ranks: usize, arguments: &[&str]) -> Option<String> {
    let output = run(ranks, arguments)?;
    assert!(output.status.success(), "{}", text(&output.stderr));
    Some(text(&output.stdout))
}

/// A run of a hundred steps of `batch` views, and as many of stage two, into `name` of `folder`.
#[track_caller]
fn hundred_steps(folder: &Path, name: &str, ranks: usize, batch: usize) -> Option<String> {
    let data = folder.join("scene");
    let run = folder.join(name);
    let views = 100 * batch;
    let sets = [
        format!("building.iterations={views}"),
        format!("building.batch={batch}"),
        format!("building.eval_every={views}"),
        "building.random_points=300".to_owned(),
        format!("segmentation.iterations={views}"),
        format!("segmentation.batch={batch}"),
        format!("segmentation.eval_every={views}"),
        "segmentation.rows=vote,per_gaussian,ours".to_owned(),
    ];
    let mut arguments = vec!["train", "--data", utf8(&data), "--out", utf8(&run)];
    arguments.extend(sets.iter().flat_map(|set| ["--set", set]));
    succeeds(ranks, &arguments)
}

/// The last loss of stage one, and the held-out PSNR.
fn figures(run: &Path) -> [f64; 2] {
    let metrics = read_json(&run.join("metrics.json"));
    let losses = metrics["curves"]["building"]["loss"].as_array().unwrap();
    let loss = losses.last().unwrap()[1].as_f64().unwrap();
    [loss, metrics["test"]["psnr"].as_f64().unwrap()]
}

#[test]
fn two_and_four_ranks_are_one_rank_with_the_same_batch() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    scene(&folder.join("scene"));
    for batch in [2, 4] {
        let [alone, together] = ["alone", "together"].map(|name| format!("{name}_{batch}"));
        hundred_steps(folder, &alone, 1, batch).unwrap();
        let Some(said) = hundred_steps(folder, &together, batch, batch) else {
            return;
        };
        assert!(
            said.contains(&format!("{batch} ranks; each put ")),
            "{said}"
        );
        let [alone, together] = [alone, together].map(|name| folder.join(name));
        let [loss, psnr] = figures(&alone);
        let [other_loss, other_psnr] = figures(&together);
        let apart = (loss - other_loss).abs() / loss;
        assert!(
            apart <= 1e-5,
            "{batch} ranks: {other_loss} for {loss}, {apart:e}"
        );
        assert!(
            (psnr - other_psnr).abs() <= 0.1,
            "{batch} ranks: {other_psnr} dB for {psnr}"
        );
        let scenes = [&alone, &together].map(|run| fs::read(run.join("scene.ply")).unwrap());
        if batch == 2 {
            // The sum of two gradients is the same in either order.
            assert!(
                scenes[0] == scenes[1],
                "two ranks give other Gaussians than one"
            );
        }
        let traffic = read_json(&together.join("metrics.json"))["ranks"].clone();
        assert_eq!(traffic["ranks"], batch);
        assert!(
            traffic["building_step_bytes"].as_u64().unwrap() > 10_000,
            "{traffic}"
        );
    }
}

/// The process of rank `rank` that has `word` on its command line.
fn process_of(rank: usize, word: &str) -> Option<u32> {
    let variable = format!("OMPI_COMM_WORLD_RANK={rank}");
    let has = |file: &Path, word: &str| {
        let bytes = fs::read(file).unwrap_or_default();
        bytes
            .split(|byte| *byte == 0)
            .any(|part| part == word.as_bytes())
    };
    let processes = fs::read_dir("/proc").unwrap().flatten();
    let found = processes.filter_map(|entry| {
        let id = entry.file_name().to_str()?.parse().ok()?;
        let folder = entry.path();
        let matches = has(&folder.join("environ"), &variable) && has(&folder.join("cmdline"), word);
        matches.then_some(id)
    });
    found.max()
}

/// Waits until `is_done`, at most a minute.
#[track_caller]
fn until(what: &str, mut is_done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_done() {
        assert!(start.elapsed() < Duration::from_secs(60), "no {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn ends(child: &mut Child) -> bool {
    child.try_wait().unwrap().is_some()
}

#[test]
fn a_killed_rank_ends_the_job_and_its_checkpoint_resumes_on_any_number() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let data = folder.join("scene");
    let out = folder.join("run");
    scene(&data);
    let arguments = [
        "train",
        "--data",
        utf8(&data),
        "--out",
        utf8(&out),
        "--set",
        "building.iterations=3000",
        "--set",
        "building.random_points=300",
        "--set",
        "segmentation.rows=vote",
    ];
    let Some(mut command) = command(2, &arguments) else {
        return;
    };
    let mut child = command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let checkpoint = out.join("checkpoint").join("building.safetensors");
    until("checkpoint", || checkpoint.is_file());
    let rank = process_of(1, utf8(&out)).expect("a process of rank 1");
    let kill = |signal: &str, process: u32| {
        let process = process.to_string();
        assert!(
            Command::new("kill")
                .args([signal, &process])
                .status()
                .unwrap()
                .success()
        );
    };
    kill("-KILL", rank);
    until("end of the job", || ends(&mut child));
    assert!(!child.wait().unwrap().success());

    // Three ranks share the batches of two. One is asked to stop: all stop, with a checkpoint.
    let resume = ["train", "--resume", utf8(&out)];
    let mut child = self::command(3, &resume).unwrap();
    let mut child = child
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let before = fs::metadata(&checkpoint).unwrap().modified().unwrap();
    let mut rank = None;
    until("rank 2", || {
        rank = process_of(2, utf8(&out));
        rank.is_some()
    });
    until("checkpoint after the resumption", || {
        fs::metadata(&checkpoint).unwrap().modified().unwrap() > before
    });
    kill("-TERM", rank.unwrap());
    until("end of the stopped job", || ends(&mut child));
    assert_eq!(child.wait().unwrap().code(), Some(130));

    succeeds(1, &resume).unwrap();
    let metrics = read_json(&out.join("metrics.json"));
    assert!(metrics["test"]["psnr"].as_f64().unwrap() > 20.0);
    assert_eq!(metrics["commands"].as_array().unwrap().len(), 3);
}

#[test]
fn what_ranks_cannot_do_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("scene");
    let out = folder.path().join("run");
    scene(&data);
    let train = ["train", "--data", utf8(&data), "--out", utf8(&out), "--set"];
    let refused = |ranks, set: &str, parts: &[&str]| {
        let Some(output) = run(ranks, &[&train[..], &[set]].concat()) else {
            return;
        };
        let message = text(&output.stderr);
        assert!(!output.status.success(), "{message}");
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    };
    refused(
        8,
        "seed=1",
        &["mpirun: found 8 processes", "training photos"],
    );
    let distilled = "segmentation.rows=distilled";
    refused(
        2,
        distilled,
        &["segmentation.rows: found distilled", "without mpirun"],
    );
    refused(2, "building.batch=0", &["building.batch: found 0"]);
}
