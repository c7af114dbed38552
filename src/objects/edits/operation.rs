//! The operations of a file of edits.

use crate::objects::Editing;
use crate::splat::Motion;
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Characters of a name at most.
const MAX_NAME: usize = 200;

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

/// A part of an operation that does not fit the scene.
#[derive(Debug)]
pub(super) struct Fault {
    pub field: String,
    pub found: String,
    pub expected: String,
}

fn fault(field: impl Into<String>, found: impl Into<String>, expected: impl Into<String>) -> Fault {
    Fault {
        field: field.into(),
        found: found.into(),
        expected: expected.into(),
    }
}

impl Operation {
    /// Applies it to a scene relative to `origin`.
    pub(super) fn apply(&self, editing: &mut Editing, origin: DVec3) -> Result<(), Fault> {
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
                    None => Motion {
                        rotation: DQuat::IDENTITY,
                        pivot: DVec3::ZERO,
                        translation: *shift,
                    },
                };
                editing.displace(&editing.rows(*object), &motion);
            }
        }
        Ok(())
    }
}

impl Turn {
    fn then(&self, editing: &Editing, shift: DVec3, origin: DVec3) -> Result<Motion, Fault> {
        let pivot = self.pivot - origin;
        check_near(editing, "turn.pivot", pivot)?;
        let axis = self.axis.try_normalize().ok_or_else(|| {
            fault(
                "turn.axis",
                self.axis.to_string(),
                "a direction: three numbers, not all zero",
            )
        })?;
        Ok(Motion {
            rotation: DQuat::from_axis_angle(axis, self.degrees.to_radians()),
            pivot,
            translation: shift,
        })
    }
}

fn check_known(editing: &Editing, field: &str, id: u16) -> Result<(), Fault> {
    if editing.is_known(id) {
        return Ok(());
    }
    let expected = "a label of the scene or of its class table";
    Err(fault(field, id.to_string(), expected))
}

fn check_all_known(editing: &Editing, ids: &[u16]) -> Result<(), Fault> {
    let field = |i: usize| format!("objects[{i}]");
    let mut all = ids.iter().enumerate();
    all.try_for_each(|(i, &id)| check_known(editing, &field(i), id))
}

/// A label that can have a name.
fn check_named(editing: &Editing, id: u16) -> Result<(), Fault> {
    check_known(editing, "object", id)?;
    if id == editing.ignore() {
        let expected = "a label other than that of unlabelled Gaussians";
        return Err(fault("object", id.to_string(), expected));
    }
    Ok(())
}

fn check_free(editing: &Editing, id: u16) -> Result<(), Fault> {
    // 0 means unlabelled where no class table says otherwise.
    if id == 0 || editing.is_known(id) {
        let expected = "an id above 0 that neither the scene nor its class table has";
        return Err(fault("object", id.to_string(), expected));
    }
    Ok(())
}

/// Whether an object can be called `name`: 1 to 200 characters, not all blank, without line ends.
pub fn is_name(name: &str) -> bool {
    let is_plain = !name.trim().is_empty() && !name.chars().any(char::is_control);
    is_plain && name.chars().count() <= MAX_NAME
}

fn check_name(field: &str, name: &str) -> Result<(), Fault> {
    if is_name(name) {
        return Ok(());
    }
    let some: String = name.chars().take(MAX_NAME).collect();
    let expected =
        format!("a name of 1 to {MAX_NAME} characters, not all blank, without line ends");
    Err(fault(field, format!("{some:?}"), expected))
}

fn check_rows(editing: &Editing, rows: &[u32]) -> Result<(), Fault> {
    for (i, &row) in rows.iter().enumerate() {
        if row as usize >= editing.len() {
            let expected = format!(
                "a row of the scene, 0 to {}",
                editing.len().saturating_sub(1)
            );
            return Err(fault(format!("gaussians[{i}]"), row.to_string(), expected));
        }
        if editing.is_removed(row) {
            let found = format!("{row}, which an earlier operation deletes");
            return Err(fault(
                format!("gaussians[{i}]"),
                found,
                "a row that is left",
            ));
        }
    }
    Ok(())
}

fn check_near(editing: &Editing, field: &str, offset: DVec3) -> Result<(), Fault> {
    if offset.is_finite() && editing.is_near(offset) {
        return Ok(());
    }
    let expected = format!(
        "at most {:.3e} world units, as positions farther away lose digits",
        editing.farthest()
    );
    Err(fault(field, offset.to_string(), expected))
}
