//! Objects kept, removed, turned and moved by their names.

use super::ObjectScene;
use crate::error::{Result, ensure};
use crate::objects::{Edited, Editing};
use crate::splat::Motion;
use glam::{DQuat, DVec3};

/// What is done to the objects of a scene, which [`ObjectScene::find`] finds: first keep, then remove, turn, move. Flags in errors
/// are those of `coseg edit`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObjectEdits {
    /// Objects to keep, and no others; all where this is empty.
    pub keep: Vec<String>,
    /// Objects to remove.
    pub remove: Vec<String>,
    /// Objects and their rotations about the middle of their boxes.
    pub turns: Vec<(String, DQuat)>,
    /// Objects and how far they move, world units.
    pub moves: Vec<(String, DVec3)>,
}

/// The turn by `degrees` about `axis`, counter-clockwise as seen from its tip; `None` where these are not an axis and an angle.
pub fn turn(axis: DVec3, degrees: f64) -> Option<DQuat> {
    let axis = axis.try_normalize()?;
    let degrees = degrees.is_finite().then_some(degrees)?;
    Some(DQuat::from_axis_angle(axis, degrees.to_radians()))
}

impl ObjectEdits {
    /// Whether nothing is asked for.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Applies the edits to `scene`, whose Gaussians are in `editing`. Returns the result and a few words about it; no words
    /// without edits.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] naming the flag: no such object, one that is removed, a move too far, no Gaussian left.
    pub fn apply(&self, scene: &ObjectScene, mut editing: Editing) -> Result<(Edited, String)> {
        let kept = scene.ids(&self.keep, "--keep")?;
        let removed = scene.ids(&self.remove, "--remove")?;
        let stays =
            |id: u16| (self.keep.is_empty() || kept.contains(&id)) && !removed.contains(&id);
        let staying = |what: &str, flag: &str| {
            let mut objects = scene.find(what, flag)?;
            objects.retain(|object| stays(object.id));
            ensure!(!objects.is_empty(), argument "{flag}"; found "{what}";
                expected "an object that is neither removed nor left out"; help "leave it out, or keep the object");
            Ok(objects)
        };
        let mut motions = 0;
        for (what, rotation) in &self.turns {
            for object in staying(what, "--turn")? {
                let turn = Motion {
                    rotation: *rotation,
                    pivot: object.center(),
                    translation: DVec3::ZERO,
                };
                editing.displace(&object.rows, &turn);
                motions += 1;
            }
        }
        for (what, offset) in &self.moves {
            ensure!(editing.is_near(*offset),
                argument "--move"; found "{what}={offset}"; expected "at most {:.3e} world units", editing.farthest();
                help "move by less: positions that far away lose digits");
            for object in staying(what, "--move")? {
                editing.displace(&object.rows, &Motion::shift(*offset));
                motions += 1;
            }
        }
        let leaving = scene.objects.iter().filter(|object| !stays(object.id));
        let leaving: Vec<_> = leaving.collect();
        for object in &leaving {
            editing.remove(&object.rows);
        }
        let counts = [
            ("objects removed", leaving.len()),
            ("turns and moves", motions),
        ];
        let counts = counts.iter().filter(|(_, count)| *count > 0);
        let done: Vec<String> = counts
            .map(|(what, count)| format!("{what}: {count}"))
            .collect();
        Ok((editing.finish("--keep, --remove")?, done.join(", ")))
    }
}
