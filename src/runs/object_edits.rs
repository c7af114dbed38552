//! Objects kept, removed, turned and moved by their names.

use super::ObjectScene;
use crate::error::{Result, ensure};
use crate::objects::{Edited, Editing, Object};
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

/// The turn by `degrees` about `axis`, counter-clockwise as seen from its tip; `None` where these are no axis or angle.
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

    /// What they make of `scene`, of which `editing` has the Gaussians, and a few words about it; none where nothing is asked for.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] naming the flag: no such object, one that is removed, a move too far, no Gaussian left.
    pub fn apply(&self, scene: &ObjectScene, mut editing: Editing) -> Result<(Edited, String)> {
        let kept = scene.ids(&self.keep, "--keep")?;
        let removed = scene.ids(&self.remove, "--remove")?;
        let stays =
            |id: u16| (self.keep.is_empty() || kept.contains(&id)) && !removed.contains(&id);
        let motions = self.motions(scene, &editing, &stays)?;
        for (rows, motion) in &motions {
            editing.displace(rows, motion);
        }
        let leaving = scene.objects.iter().filter(|object| !stays(object.id));
        let leaving: Vec<_> = leaving.collect();
        for object in &leaving {
            editing.remove(&object.rows);
        }
        let counts = [
            ("objects removed", leaving.len()),
            ("turns and moves", motions.len()),
        ];
        let counts = counts.iter().filter(|(_, count)| *count > 0);
        let done: Vec<String> = counts
            .map(|(what, count)| format!("{what}: {count}"))
            .collect();
        Ok((editing.finish("--keep, --remove")?, done.join(", ")))
    }

    /// Rows and motions of the objects that stay: first turns, then moves, in their order.
    fn motions(
        &self,
        scene: &ObjectScene,
        editing: &Editing,
        stays: &dyn Fn(u16) -> bool,
    ) -> Result<Vec<(Vec<u32>, Motion)>> {
        let still = Motion {
            rotation: DQuat::IDENTITY,
            pivot: DVec3::ZERO,
            translation: DVec3::ZERO,
        };
        let mut motions = Vec::new();
        let mut add = |what: &str, flag: &str, motion: &dyn Fn(&Object) -> Motion| {
            let staying = scene
                .find(what, flag)?
                .into_iter()
                .filter(|object| stays(object.id));
            let before = motions.len();
            motions.extend(staying.map(|object| (object.rows.clone(), motion(object))));
            ensure!(motions.len() > before, argument "{flag}"; found "{what}";
                expected "an object that is neither removed nor left out"; help "leave it out, or keep the object");
            Ok(())
        };
        for (what, rotation) in &self.turns {
            add(what, "--turn", &|object| Motion {
                rotation: *rotation,
                pivot: object.center(),
                ..still
            })?;
        }
        for (what, translation) in &self.moves {
            ensure!(editing.is_near(*translation),
                argument "--move"; found "{what}={translation}"; expected "at most {:.3e} world units", editing.farthest();
                help "move by less: positions that far away lose digits");
            add(what, "--move", &|_| Motion {
                translation: *translation,
                ..still
            })?;
        }
        Ok(motions)
    }
}
