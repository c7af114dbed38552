//! Which frames of a `transforms.json` are for training and which are held out: `split` of the frames, or nerfstudio's
//! `train_filenames`, `val_filenames` and `test_filenames`.

use super::schema::Transforms;
use crate::data::Split;
use crate::data::formats::folder::Problems;
use crate::error::invalid;
use std::collections::HashMap;

/// The frames that are read: index in the file, and split. The file gives splits for all frames or for none.
pub(super) type Splits = Vec<(usize, Option<Split>)>;

/// The use of a frame as its file gives it: a split, or [`VALIDATION`].
type Use = Option<Split>;
/// For choosing settings, if there are test frames too.
const VALIDATION: Use = None;

/// All `count` frames of a file, with one split.
pub(super) fn all(count: usize, split: Option<Split>) -> Splits {
    (0..count).map(|i| (i, split)).collect()
}

impl Transforms {
    /// The split of each frame. Validation frames are held out if there are no test frames, else left out.
    pub fn splits(&self, notices: &mut Vec<String>, problems: &mut Problems) -> Splits {
        let uses = if self.frames.iter().any(|f| f.split.is_some()) {
            self.uses_by_frame(problems)
        } else if self.lists().next().is_some() {
            self.uses_by_list(notices)
        } else {
            return all(self.frames.len(), None);
        };
        let is_tested = uses.iter().any(|(_, used)| *used == Some(Split::Test));
        let held_out = (!is_tested).then_some(Split::Test);
        let split = |&(i, used): &(usize, Use)| Some((i, Some(used.or(held_out)?)));
        let frames: Splits = uses.iter().filter_map(split).collect();
        let left_out = uses.len() - frames.len();
        if left_out > 0 {
            notices.push(format!(
                "{left_out} validation frames left out: the test frames are held out instead"
            ));
        }
        frames
    }

    fn uses_by_frame(&self, problems: &mut Problems) -> Vec<(usize, Use)> {
        let mut uses = Vec::with_capacity(self.frames.len());
        for (i, frame) in self.frames.iter().enumerate() {
            let used = match frame.split.as_deref() {
                Some("train") => Some(Split::Train),
                Some("val" | "validation" | "eval") => VALIDATION,
                Some("test") => Some(Split::Test),
                other => {
                    let nothing = "nothing, though other frames have one".to_owned();
                    let found = other.map_or(nothing, |other| format!("{other:?}"));
                    problems.push(
                        invalid!(&self.path, "{}.split", self.field(i); found "{found}";
                        expected "\"train\", \"test\" or \"val\"";
                        help "give every frame a split, or none (then every 8th is test)"),
                    );
                    Some(Split::Train)
                }
            };
            uses.push((i, used));
        }
        uses
    }

    /// As in nerfstudio, frames in none of the lists are not used.
    fn uses_by_list(&self, notices: &mut Vec<String>) -> Vec<(usize, Use)> {
        let plain = |file: &str| file.trim_start_matches("./").to_owned();
        let listed = self
            .lists()
            .flat_map(|(used, files)| files.iter().map(move |file| (plain(file), used)));
        let listed: HashMap<String, Use> = listed.collect();
        let frames = self.frames.iter().enumerate();
        let uses: Vec<_> = frames
            .filter_map(|(i, f)| Some((i, *listed.get(&plain(&f.file_path))?)))
            .collect();
        let unlisted = self.frames.len() - uses.len();
        if unlisted > 0 {
            notices.push(format!(
                "{unlisted} of {} frames left out: they are in none of train_filenames, val_filenames and test_filenames",
                self.frames.len()
            ));
        }
        uses
    }

    fn lists(&self) -> impl Iterator<Item = (Use, &Vec<String>)> {
        let lists = [
            (Some(Split::Train), &self.train_filenames),
            (VALIDATION, &self.val_filenames),
            (Some(Split::Test), &self.test_filenames),
        ];
        let lists = lists.into_iter();
        lists.filter_map(|(used, files)| Some((used, files.as_ref()?)))
    }
}
