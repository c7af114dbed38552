//! Photos, and scripts in the place of the programs that `coseg from-photos` calls.

use crate::support::colmap::image_line;
use crate::support::plates::{HEIGHT, WIDTH, camera, plates, scene};
use crate::support::program::{text, utf8};
use glam::DQuat;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// A folder of photos and one for programs, which is all of the PATH.
pub struct Sandbox(pub TempDir);

impl Sandbox {
    pub fn new() -> Self {
        let sandbox = Self(tempfile::tempdir().unwrap());
        fs::create_dir(sandbox.path("bin")).unwrap();
        sandbox
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Six photos of the plates, in a folder whose name is not a plain word, and their model in `model`.
    pub fn photos(&self) -> PathBuf {
        let all = self.path("all");
        let photos = self.path("Küche 1");
        let model = self.path("model");
        fs::create_dir(&all).unwrap();
        scene(&all);
        fs::rename(all.join("images"), &photos).unwrap();
        fs::create_dir(&model).unwrap();
        let cameras = format!("1 PINHOLE {WIDTH} {HEIGHT} 80 80 40 32\n");
        fs::write(model.join("cameras.txt"), cameras).unwrap();
        let mut images = String::new();
        for i in 0..6 {
            let name = format!("Bild ö {i}.png");
            fs::rename(photos.join(format!("v{i}.png")), photos.join(&name)).unwrap();
            let camera = camera(i);
            let q = DQuat::from_mat3(&camera.rotation);
            let t = -(camera.rotation * camera.center);
            images += &image_line(i + 1, (q, t), 1, &name);
        }
        fs::write(model.join("images.txt"), images).unwrap();
        let points = plates().0.means.into_iter().enumerate();
        let points = points.map(|(i, [x, y, z])| format!("{i} {x} {y} {z} 99 99 99 0.5\n"));
        fs::write(model.join("points3D.txt"), points.collect::<String>()).unwrap();
        photos
    }

    pub fn script(&self, name: &str, body: &str) {
        let text = self.path("script");
        fs::write(&text, format!("#!/bin/sh\nPATH=/usr/bin:/bin\n{body}\n")).unwrap();
        // Another process writes what is run: a program that another test starts meanwhile would keep a file of this process open,
        // and nothing runs a file that is open for writing.
        let install = Command::new("install")
            .args(["-m", "755"])
            .args([&text, &self.path("bin").join(name)])
            .status();
        assert!(install.unwrap().success());
    }

    /// A `colmap` that notes its steps in `log` and gives the model of [`Sandbox::photos`].
    pub fn colmap(&self) {
        let dir = utf8(self.0.path()).to_owned();
        self.script(
            "colmap",
            &format!(
                "case \"$1\" in
                help) echo 'COLMAP 3.8 (without CUDA)'; exit 0;;
                esac
                test \"$2\" != -h || exec echo '--SiftExtraction.use_gpu arg (=1)'
                case \"$1\" in
                feature_extractor) echo features >>'{dir}/log'; echo 'Processed file [1/6]'; echo $* >'{dir}/arguments';;
                exhaustive_matcher) echo matches >>'{dir}/log';;
                mapper) echo poses >>'{dir}/log'; for last; do :; done; cp -r '{dir}/model' \"$last/0\";;
                *) exit 9;; esac"
            ),
        );
    }

    /// A `python3` that does the same.
    pub fn pycolmap(&self) {
        let dir = utf8(self.0.path()).to_owned();
        let poses = format!(
            "test \"$3\" != features || echo \"$7\" >'{dir}/arguments'; \
             test \"$3\" != poses || cp -r '{dir}/model' \"$6/0\""
        );
        self.script(
            "python3",
            &format!("test \"$2\" != 'import pycolmap' || exit 0; echo $3 >>'{dir}/log'; {poses}"),
        );
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_coseg"));
        command.arg("from-photos").args(arguments);
        command.env("PATH", self.path("bin"));
        command
    }

    pub fn run(&self, source: &Path, more: &[&str]) -> Output {
        let out = self.path("room");
        let arguments = [&[utf8(source), "--out", utf8(&out)], more].concat();
        self.command(&arguments).output().unwrap()
    }

    #[track_caller]
    pub fn succeeds(&self, source: &Path, more: &[&str]) -> String {
        let output = self.run(source, more);
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    }

    /// Fails with code 1 and a message that has all `parts`.
    #[track_caller]
    pub fn fails(&self, source: &Path, more: &[&str], parts: &[&str]) {
        let output = self.run(source, more);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{message}");
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    }

    pub fn log(&self) -> Vec<String> {
        let log = fs::read_to_string(self.path("log")).unwrap_or_default();
        log.lines().map(str::to_owned).collect()
    }
}
