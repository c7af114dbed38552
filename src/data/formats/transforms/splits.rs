//! Which frames of a `transforms.json` are trained on and which are held out: `split` of the frames, or nerfstudio's
//! `train_filenames`, `val_filenames` and `test_filenames`.

use super::schema::Transforms;
use crate::data::Split;
use crate::data::formats::listing::Problems;
use crate::error::Error;
use std::collections::HashMap;
use std::path::Path;

/// The frames that are read.
pub(crate) struct Splits {
    /// Index in the file, and the split where the file says one: of all of them or none.
    pub frames: Vec<(usize, Option<Split>)>,
    /// What was left out.
    pub notices: Vec<String>,
}

/// What a file says of a frame.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Use {
    Train,
    /// For choosing settings, where there are test frames besides.
    Validation,
    Test,
}

impl Use {
    fn of(word: &str) -> Option<Self> {
        match word {
            "train" => Some(Self::Train),
            "val" | "validation" | "eval" => Some(Self::Validation),
            "test" => Some(Self::Test),
            _ => None,
        }
    }
}

impl Splits {
    /// All `count` frames of a file, of one split.
    pub fn all(count: usize, split: Option<Split>) -> Self {
        Self {
            frames: (0..count).map(|i| (i, split)).collect(),
            notices: Vec::new(),
        }
    }
}

impl Transforms {
    /// What the file says of the split of its frames. Validation frames are held out where no others are, and left out
    /// beside test frames.
    pub fn splits(&self, path: &Path, problems: &mut Problems) -> Splits {
        let mut notices = Vec::new();
        let uses = match (
            self.frames.iter().any(|f| f.split.is_some()),
            self.lists().is_empty(),
        ) {
            (true, _) => self.named_uses(path, problems),
            (false, false) => self.listed_uses(&mut notices),
            (false, true) => return Splits::all(self.frames.len(), None),
        };
        let tested = uses.iter().any(|(_, of)| *of == Use::Test);
        let split = |of: Use| match of {
            Use::Train => Some(Split::Train),
            Use::Test => Some(Split::Test),
            Use::Validation => (!tested).then_some(Split::Test),
        };
        let frames: Vec<_> = uses
            .iter()
            .filter_map(|&(i, of)| split(of).map(|split| (i, Some(split))))
            .collect();
        let left_out = uses.len() - frames.len();
        if left_out > 0 {
            notices.push(format!(
                "{left_out} validation frames left out: the test frames are what is held out"
            ));
        }
        Splits { frames, notices }
    }

    /// By `split` of the frames.
    fn named_uses(&self, path: &Path, problems: &mut Problems) -> Vec<(usize, Use)> {
        let mut uses = Vec::with_capacity(self.frames.len());
        for (i, frame) in self.frames.iter().enumerate() {
            let of = frame.split.as_deref().and_then(Use::of);
            if of.is_none() {
                problems.push(Error::input(
                    path,
                    format!("{}.split", self.field(i)),
                    frame
                        .split
                        .as_ref()
                        .map_or("nothing, though other frames have one".into(), |s| {
                            format!("{s:?}")
                        }),
                    "\"train\", \"test\" or \"val\"",
                    "give every frame a split, or none (then every 8th is test)",
                ));
            }
            uses.push((i, of.unwrap_or(Use::Train)));
        }
        uses
    }

    /// By lists of files. As in nerfstudio, frames in none of them are not used.
    fn listed_uses(&self, notices: &mut Vec<String>) -> Vec<(usize, Use)> {
        let plain = |file: &str| file.trim_start_matches("./").to_owned();
        let mut of_file = HashMap::new();
        for (of, files) in self.lists() {
            files
                .iter()
                .for_each(|file| _ = of_file.insert(plain(file), of));
        }
        let frames = self.frames.iter().enumerate();
        let uses: Vec<_> = frames
            .filter_map(|(i, f)| Some((i, *of_file.get(&plain(&f.file_path))?)))
            .collect();
        let unlisted = self.frames.len() - uses.len();
        if unlisted > 0 {
            let lists = "train_filenames, val_filenames and test_filenames";
            notices.push(format!(
                "{unlisted} of {} frames left out: they are in none of {lists}",
                self.frames.len()
            ));
        }
        uses
    }

    fn lists(&self) -> Vec<(Use, &[String])> {
        let lists = [
            (Use::Train, &self.train_filenames),
            (Use::Validation, &self.val_filenames),
            (Use::Test, &self.test_filenames),
        ];
        lists
            .into_iter()
            .filter_map(|(of, files)| Some((of, files.as_deref()?)))
            .collect()
    }
}
