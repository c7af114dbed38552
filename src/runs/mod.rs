//! Run folders and scene files, and what commands do with them: their names, checks of what is written, training, votes, edits.

mod corrections;
mod folder;
mod merge;
mod object_edits;
mod object_scene;
mod scene_file;
mod side_files;
mod training;
mod vote;

pub use self::corrections::correct;
pub use self::folder::{IDENTITIES, RENDERS, REPORT, RunFolder, StartedRun, identities_beside};
pub use self::merge::{Merged, merge};
pub use self::object_edits::{ObjectEdits, turn};
pub use self::object_scene::{
    ObjectScene, check_output, scene_output, without_labels, write_scene,
};
pub use self::scene_file::{
    CAMERAS, CLASSES, CONFIG, FEATURE_COLORS, SCENE, VIEWER, cameras_for, cameras_path,
    classes_beside, features_beside, frame_with_pixel, named_frame, photos_of, read_scene,
    rendering_beside, scene_path,
};
pub use self::side_files::{Cameras, SideFiles};
pub use self::training::{RunOptions, Trained, check_folder, follow, scene_name, train};
pub use self::vote::{check_vote, load_both, vote};
