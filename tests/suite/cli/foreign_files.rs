//! No command writes over a file that it did not write.

use crate::support::plates::scene;
use crate::support::program::{fails, read_json, succeeds, utf8};
use coseg::data::formats::transforms::write_cameras;
use coseg::data::{Classes, read_cameras};
use std::fs;
use std::path::Path;

const MINE: &[u8] = b"years of work";

/// Puts a file at `path`, runs the command, and expects a refusal that names it and leaves it as it is.
#[track_caller]
fn refuses(arguments: &[&str], path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, MINE).unwrap();
    let message = fails(arguments, 1);
    assert!(
        message.contains(utf8(path)) && message.contains("did not write"),
        "{message}"
    );
    assert_eq!(fs::read(path).unwrap(), MINE, "{arguments:?}");
    fs::remove_file(path).unwrap();
}

#[test]
fn commands_write_over_their_own_files_alone() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let data = dir.join("data");
    let out = dir.join("out");
    fs::create_dir(&data).unwrap();
    let ply = scene(&data);
    let given = ["--scene", utf8(&ply)];
    let to = |command, file: &Path| {
        [command, "--scene", utf8(&ply), "--out", utf8(file)].map(str::to_owned)
    };
    let run = |command, more: &[&str], file: &Path, clash: &Path| {
        let arguments = to(command, file);
        let arguments: Vec<&str> = arguments
            .iter()
            .map(|word| &**word)
            .chain(more.iter().copied())
            .collect();
        refuses(&arguments, clash);
        succeeds(&arguments);
        // Its own files, again.
        succeeds(&arguments);
    };
    let of_scene = ["--data", utf8(&data)];
    run(
        "vote",
        &of_scene,
        &out.join("vote"),
        &out.join("vote/scene.ply"),
    );
    run(
        "vote",
        &of_scene,
        &out.join("names"),
        &out.join("names/classes.json"),
    );
    run(
        "associate",
        &of_scene,
        &out.join("ids"),
        &out.join("ids/labels/v2.png"),
    );
    let cameras = ["--cameras", utf8(&data), "--split", "test"];
    run(
        "render",
        &cameras,
        &out.join("render"),
        &out.join("render/v5.alpha.png"),
    );
    let page = out.join("page.html");
    run("view", &[], &page, &page);
    for (command, option) in [("edit", "--paint"), ("separate", "--level=0.1")] {
        let file = out.join(command).join("scene.ply");
        let words = to(command, &file);
        let words = words.iter().map(|word| &**word).chain([option]);
        refuses(&words.collect::<Vec<_>>(), &file);
    }
    let sheet = out.join("sheet.png");
    let info = ["data", "info", utf8(&data), "--sheet", utf8(&sheet)];
    refuses(&info, &sheet);
    succeeds(&info);
    succeeds(&info);
    let json = out.join("figures.json");
    let bench = [
        &[
            "bench",
            "--data",
            utf8(&data),
            "--only",
            "curve",
            "--repeats",
            "1",
        ][..],
        &["--set", "building.random_points=100", "--json", utf8(&json)],
    ]
    .concat();
    refuses(&bench, &json);
    // The same name, written by another command.
    let shared = out.join("a");
    succeeds(&[&["vote"][..], &given, &of_scene, &["--out", utf8(&shared)]].concat());
    let associate = [
        &["associate"][..],
        &given,
        &of_scene,
        &["--out", utf8(&shared)],
    ]
    .concat();
    assert!(fails(&associate, 1).contains("did not write"));
    // A table of somebody else.
    let plan = dir.join("plan.toml");
    let text = "title = \"t\"\nscenes = [\"data\"]\nseeds = 1\n[[labels]]\nname = \"raw\"\n[[rows]]\nname = \"vote\"\nvariant = \"vote\"\n";
    fs::write(&plan, text).unwrap();
    let table = out.join("table/table.md");
    refuses(
        &[
            "compare",
            utf8(&plan),
            "--out",
            utf8(table.parent().unwrap()),
        ],
        &table,
    );
}

#[test]
fn names_and_cameras_of_another_scene_in_the_folder_stay() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let [first, second, photos] = ["first", "second", "photos"].map(|name| dir.join(name));
    fs::create_dir(&photos).unwrap();
    let plates = scene(&photos);
    let cameras = read_cameras(&photos, None).unwrap();
    for (folder, name, count) in [(&first, "red", 6), (&second, "sofa", 5)] {
        fs::create_dir(folder).unwrap();
        fs::copy(&plates, folder.join("scene.ply")).unwrap();
        let names = [(1, name), (2, "green"), (3, "blue"), (4, "wall")];
        let table = Classes::from_names(0, names);
        table.write(&folder.join("classes.json")).unwrap();
        write_cameras(&folder.join("cameras.json"), &cameras[..count]).unwrap();
    }
    let out = dir.join("out");
    let [table, views] = ["classes.json", "cameras.json"].map(|name| out.join(name));
    let edit = |scene: &Path, name: &str, more: &[&str]| -> Vec<String> {
        let out = out.join(name);
        let edit = ["edit", "--scene", utf8(scene), "--out", utf8(&out)];
        let all = edit.iter().chain(&["--remove", "green"]).chain(more);
        all.map(|word| (*word).to_owned()).collect()
    };
    let run = |words: Vec<String>| {
        succeeds(&words.iter().map(String::as_str).collect::<Vec<_>>());
    };
    let refused = |arguments: Vec<String>, file: &Path, what: &str| {
        let before = [&table, &views].map(|file| fs::read(file).unwrap());
        let message = fails(&arguments.iter().map(String::as_str).collect::<Vec<_>>(), 1);
        let found = format!("{}: {what}: found those of", file.display());
        assert!(message.contains(&found), "{message}");
        assert_eq!([&table, &views].map(|file| fs::read(file).unwrap()), before);
    };
    run(edit(&first, "a.ply", &[]));
    // Again, and beside it with the same names and cameras.
    run(edit(&first, "a.ply", &[]));
    run(edit(&first, "b.ply", &[]));
    refused(edit(&second, "c.ply", &[]), &table, "classes");
    fs::copy(first.join("classes.json"), second.join("classes.json")).unwrap();
    refused(edit(&second, "c.ply", &[]), &views, "cameras");
    assert!(!out.join("c.ply").exists());
    // A scene without cameras takes none away.
    fs::remove_file(second.join("cameras.json")).unwrap();
    run(edit(&second, "c.ply", &[]));
    assert!(views.is_file());
    let names = ["--pixel", "40,30", "--name", "new"];
    let select = ["select", "--scene", utf8(&first), "--frame", "v2"];
    let d = out.join("d.ply");
    let select = [&select[..], &names, &["--out", utf8(&d)]].concat();
    let message = fails(&select, 1);
    assert!(message.contains("another class table"), "{message}");
    write_cameras(&second.join("cameras.json"), &cameras[..5]).unwrap();
    run(edit(&second, "c.ply", &["--force"]));
    let of_second = fs::read(second.join("cameras.json")).unwrap();
    assert_eq!(fs::read(&views).unwrap(), of_second);
    // A vote has names of its own, and no such option.
    let voted = dir.join("voted");
    let vote = |data: &Path| {
        let vote = ["vote", "--scene", utf8(&plates), "--data", utf8(data)];
        [&vote[..], &["--out", utf8(&voted)]]
            .concat()
            .iter()
            .map(|word| (*word).to_owned())
            .collect::<Vec<_>>()
    };
    run(vote(&photos));
    fs::copy(voted.join("scene.ply"), voted.join("other.ply")).unwrap();
    run(vote(&photos));
    let names = [(1, "sofa"), (2, "green"), (3, "blue"), (4, "wall")];
    let table = Classes::from_names(0, names);
    table.write(&photos.join("classes.json")).unwrap();
    let vote = vote(&photos);
    let message = fails(&vote.iter().map(String::as_str).collect::<Vec<_>>(), 1);
    assert!(message.contains("found those of other.ply"), "{message}");
    assert!(!message.contains("--force"), "{message}");
}

#[test]
fn a_run_starts_in_a_folder_without_files_of_others() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    scene(dir);
    let run = dir.join("run");
    let rows = ["--set", "segmentation.rows=raw"];
    let small = [
        "--set",
        "building.iterations=2",
        "--set",
        "building.random_points=50",
    ];
    let train = ["train", "--data", utf8(dir), "--out", utf8(&run)];
    let train = [&train[..], &rows, &small].concat();
    for name in [
        "classes.json",
        "report.html",
        "renders/v2.rgb.png",
        "checkpoint/notes.txt",
    ] {
        refuses(&train, &run.join(name));
    }
    fs::write(run.join("notes.txt"), MINE).unwrap();
    succeeds(&train);
    assert_eq!(fs::read(run.join("notes.txt")).unwrap(), MINE);
    // Its page may be written anew, but not once somebody has changed it.
    succeeds(&["view", "--scene", utf8(&run)]);
    refuses(&["view", "--scene", utf8(&run)], &run.join("viewer.html"));
    // A run that is resumed is whole afterwards.
    fs::write(run.join("metrics.json"), MINE).unwrap();
    succeeds(&["train", "--resume", utf8(&run)]);
    assert!(read_json(&run.join("metrics.json"))["test"]["psnr"].is_f64());
}

#[test]
fn what_a_killed_process_left_is_removed() {
    let folder = tempfile::tempdir().unwrap();
    let ply = scene(folder.path());
    let (old, new) = (
        folder.path().join(".coseg-a1.tmp"),
        folder.path().join(".coseg-b2.tmp"),
    );
    for path in [&old, &new] {
        fs::write(path, "a part").unwrap();
    }
    let day = std::time::Duration::from_secs(24 * 3600);
    let then = std::time::SystemTime::now() - day;
    fs::File::options()
        .write(true)
        .open(&old)
        .unwrap()
        .set_modified(then)
        .unwrap();
    succeeds(&["view", "--scene", utf8(&ply)]);
    assert!(
        !old.exists() && new.exists(),
        "a write that goes on is left alone"
    );
}
