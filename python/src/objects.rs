//! Objects of a scene and what is done to them, as `coseg edit` takes both.

use crate::raised;
use coseg::error::invalid;
use coseg::runs;
use glam::{DQuat, DVec3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// One object or several: ids and names, as `coseg edit` takes them.
#[derive(FromPyObject)]
pub enum Objects {
    One(Object),
    Several(Vec<Object>),
}

/// An object by its id or its name.
#[derive(FromPyObject)]
pub enum Object {
    Id(u16),
    Name(String),
}

impl Object {
    /// The word of the command line.
    pub fn word(self) -> String {
        match self {
            Self::Id(id) => id.to_string(),
            Self::Name(name) => name,
        }
    }
}

impl Objects {
    /// The words of the command line.
    pub fn words(self) -> Vec<String> {
        match self {
            Self::One(object) => vec![object.word()],
            Self::Several(objects) => objects.into_iter().map(Object::word).collect(),
        }
    }
}

/// An axis by its name or as a direction.
#[derive(FromPyObject)]
enum Axis {
    Name(String),
    Direction([f64; 3]),
}

/// Objects with the turns that Python gave them.
pub fn turns(turns: &Bound<'_, PyDict>) -> PyResult<Vec<(String, DQuat)>> {
    let mut all = Vec::new();
    for (object, turn) in turns {
        let object = object.extract::<Object>()?.word();
        let (axis, degrees): (Axis, f64) = turn.extract()?;
        let direction = match &axis {
            Axis::Name(name) => match name.as_str() {
                "x" => Some(DVec3::X),
                "y" => Some(DVec3::Y),
                "z" => Some(DVec3::Z),
                _ => None,
            },
            Axis::Direction(direction) => Some((*direction).into()),
        };
        let rotation = direction.and_then(|axis| runs::turn(axis, degrees));
        let rotation = rotation.ok_or_else(|| {
            raised(invalid!(argument "--turn"; found "{object}={turn}";
                expected "an object, x, y, z or a direction, and degrees"; help "for instance {{\"chair\": (\"z\", 90)}}"))
        })?;
        all.push((object, rotation));
    }
    Ok(all)
}

/// Objects with the moves that Python gave them.
pub fn moves(moves: &Bound<'_, PyDict>) -> PyResult<Vec<(String, DVec3)>> {
    let mut all = Vec::new();
    for (object, offset) in moves {
        let object = object.extract::<Object>()?.word();
        let offset = DVec3::from(offset.extract::<[f64; 3]>()?);
        if !offset.is_finite() {
            return Err(raised(
                invalid!(argument "--move"; found "{object}={offset}";
                expected "an object and three numbers"; help "for instance {{\"chair\": (0.5, 0, 0)}}"),
            ));
        }
        all.push((object, offset));
    }
    Ok(all)
}
