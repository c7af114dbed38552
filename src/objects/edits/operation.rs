//! The operations of a file of edits.

use super::Editing;
use crate::error::{Result, ensure, invalid};
use crate::splat::Motion;
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Characters of a name at most.
const MAX_NAME: usize = 200;
const HELP: &str = "save the edits again in the viewer, or correct them there";

/// One edit. Objects are label ids, Gaussians are rows of the scene file from 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "op", rename_all = "snake_case", deny_unknown_fields)]
pub enum Operation {
    /// Names an object, or a class where labels are classes.
    Rename {
        /// What is named.
        object: u16,
        /// Its new name.
        name: String,
    },
    /// Gives an object a colour.
    Recolor {
        /// What is coloured.
        object: u16,
        /// 8-bit sRGB.
        color: [u8; 3],
    },
    /// All Gaussians of `objects` become Gaussians of `into`.
    Merge {
        /// What is merged.
        objects: Vec<u16>,
        /// Where it goes.
        into: u16,
    },
    /// Gives Gaussians to an object.
    Assign {
        /// Rows of the scene file.
        gaussians: Vec<u32>,
        /// A label that is there, or with `new` a free id.
        object: u16,
        /// Name and colour of an object that is new.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        new: Option<NewObject>,
    },
    /// Deletes all Gaussians of objects. Their names stay in the class table.
    DeleteObjects {
        /// What is deleted.
        objects: Vec<u16>,
    },
    /// Deletes Gaussians.
    DeleteGaussians {
        /// Rows of the scene file.
        gaussians: Vec<u32>,
    },
    /// Turns an object, then shifts it.
    Move {
        /// What is moved.
        object: u16,
        /// How it turns.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        turn: Option<Turn>,
        /// World units.
        shift: DVec3,
    },
}

/// Name and colour of an object that an edit makes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewObject {
    /// Its name.
    pub name: String,
    /// 8-bit sRGB.
    pub color: [u8; 3],
}

/// A turn about an axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Turn {
    /// A direction of any length but zero.
    pub axis: DVec3,
    /// Counter-clockwise, seen from the tip of the axis.
    pub degrees: f64,
    /// A point on the axis, world units.
    pub pivot: DVec3,
}

impl Operation {
    /// Applies it to a scene relative to `origin`.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] naming the part of the operation that does not fit the scene.
    pub(super) fn apply(&self, editing: &mut Editing, origin: DVec3) -> Result<()> {
        match self {
            Self::Rename { object, name } => {
                check_named(editing, *object)?;
                check_name("name", name)?;
                editing.entry(*object).name.clone_from(name);
            }
            Self::Recolor { object, color } => {
                check_named(editing, *object)?;
                editing.entry(*object).color = *color;
            }
            Self::Merge { objects, into } => {
                check_known(editing, "into", *into)?;
                check_all_known(editing, objects)?;
                for object in objects {
                    editing.assign(&editing.rows(*object), *into);
                }
            }
            Self::Assign {
                gaussians,
                object,
                new,
            } => {
                check_rows(editing, gaussians)?;
                match new {
                    Some(NewObject { name, color }) => {
                        check_free(editing, *object)?;
                        check_name("new.name", name)?;
                        let entry = editing.entry(*object);
                        entry.name.clone_from(name);
                        entry.color = *color;
                    }
                    None => check_known(editing, "object", *object)?,
                }
                editing.assign(gaussians, *object);
            }
            Self::DeleteObjects { objects } => {
                check_all_known(editing, objects)?;
                for object in objects {
                    editing.remove(&editing.rows(*object));
                }
            }
            Self::DeleteGaussians { gaussians } => {
                check_rows(editing, gaussians)?;
                editing.remove(gaussians);
            }
            Self::Move {
                object,
                turn,
                shift,
            } => {
                check_known(editing, "object", *object)?;
                check_near(editing, "shift", *shift)?;
                let motion = match turn {
                    Some(turn) => turn.then(editing, *shift, origin)?,
                    None => Motion::shift(*shift),
                };
                editing.displace(&editing.rows(*object), &motion);
            }
        }
        Ok(())
    }
}

impl Turn {
    fn then(&self, editing: &Editing, shift: DVec3, origin: DVec3) -> Result<Motion> {
        let pivot = self.pivot - origin;
        check_near(editing, "turn.pivot", pivot)?;
        let axis = self.axis.try_normalize().ok_or_else(|| {
            invalid!(argument "turn.axis"; found "{}", self.axis;
                expected "a direction: three numbers, not all zero"; help "{HELP}")
        })?;
        Ok(Motion {
            rotation: DQuat::from_axis_angle(axis, self.degrees.to_radians()),
            pivot,
            translation: shift,
        })
    }
}

fn check_known(editing: &Editing, field: &str, id: u16) -> Result<()> {
    ensure!(editing.is_known(id), argument "{field}"; found "{id}";
        expected "a label of the scene or of its class table"; help "{HELP}");
    Ok(())
}

fn check_all_known(editing: &Editing, ids: &[u16]) -> Result<()> {
    let field = |i: usize| format!("objects[{i}]");
    let mut all = ids.iter().enumerate();
    all.try_for_each(|(i, &id)| check_known(editing, &field(i), id))
}

/// A label that can have a name.
fn check_named(editing: &Editing, id: u16) -> Result<()> {
    check_known(editing, "object", id)?;
    ensure!(id != editing.ignore(), argument "object"; found "{id}";
        expected "a label other than that of unlabelled Gaussians"; help "{HELP}");
    Ok(())
}

fn check_free(editing: &Editing, id: u16) -> Result<()> {
    // 0 means unlabelled where no class table says otherwise.
    ensure!(id != 0 && !editing.is_known(id), argument "object"; found "{id}";
        expected "an id above 0 that neither the scene nor its class table has"; help "{HELP}");
    Ok(())
}

/// Whether an object can be called `name`: 1 to 200 characters, not all blank, without line ends.
pub fn is_name(name: &str) -> bool {
    let is_plain = !name.trim().is_empty() && !name.chars().any(char::is_control);
    is_plain && name.chars().count() <= MAX_NAME
}

fn check_name(field: &str, name: &str) -> Result<()> {
    let some: String = name.chars().take(MAX_NAME).collect();
    ensure!(is_name(name), argument "{field}"; found "{some:?}";
        expected "a name of 1 to {MAX_NAME} characters, not all blank, without line ends"; help "{HELP}");
    Ok(())
}

fn check_rows(editing: &Editing, rows: &[u32]) -> Result<()> {
    for (i, &row) in rows.iter().enumerate() {
        ensure!((row as usize) < editing.len(), argument "gaussians[{i}]"; found "{row}";
            expected "a row of the scene, 0 to {}", editing.len().saturating_sub(1); help "{HELP}");
        ensure!(!editing.is_removed(row), argument "gaussians[{i}]"; found "{row}, which an earlier operation deletes";
            expected "a row that is left"; help "{HELP}");
    }
    Ok(())
}

fn check_near(editing: &Editing, field: &str, offset: DVec3) -> Result<()> {
    ensure!(offset.is_finite() && editing.is_near(offset), argument "{field}"; found "{offset}";
        expected "at most {:.3e} world units, as positions farther away lose digits", editing.farthest(); help "{HELP}");
    Ok(())
}
