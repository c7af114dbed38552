//! Class tables: `classes.json` in and out, and the colours of legends.

use crate::data::{Class, Classes, ObjectOf, atomic, class_color};
use crate::error::{Error, Result};
use serde::{Deserialize, Deserializer, Serialize, de};
use std::path::Path;

/// The id that `classes.json` maps to a name in [`VOID_NAMES`].
const VOID: u16 = 0;
/// Names of id 0 that mean 'unlabelled'.
const VOID_NAMES: [&str; 7] = [
    "void",
    "ignore",
    "ignored",
    "unlabelled",
    "unlabeled",
    "unknown",
    "undefined",
];

impl Classes {
    /// A table of classes with colours from [`class_color`], ascending by id. Entries with the ignored id and repeated
    /// ids (after the first) are left out.
    pub fn from_names<S: Into<String>>(
        ignore: u16,
        names: impl IntoIterator<Item = (u16, S)>,
    ) -> Self {
        let mut entries: Vec<Class> = names
            .into_iter()
            .filter(|(id, _)| *id != ignore)
            .map(|(id, name)| Class {
                id,
                name: name.into(),
                color: class_color(id),
                object_of: None,
            })
            .collect();
        entries.sort_by_key(|c| c.id);
        entries.dedup_by_key(|c| c.id);
        Self { entries, ignore }
    }

    /// Colour of a label id, 8-bit sRGB; black for the ignored one and for ids not in the table.
    pub fn color(&self, id: u16) -> [u8; 3] {
        self.index(id).map_or([0; 3], |i| self.entries[i].color)
    }

    /// Colour of a label id, 8-bit sRGB: [`Classes::color`], or one of its own where no class is known.
    pub fn legend_color(&self, id: u16) -> [u8; 3] {
        if self.is_empty() {
            class_color(id)
        } else {
            self.color(id)
        }
    }

    /// Name of a label id where the table has one: that of its class, or `void` for the ignored one.
    pub fn known_name(&self, id: u16) -> Option<&str> {
        let known = self.index(id).is_some() || (id == self.ignore && !self.is_empty());
        known.then(|| self.name(id))
    }

    /// Name of a label id; `void` for the ignored one and for ids not in the table.
    pub fn name(&self, id: u16) -> &str {
        self.index(id).map_or("void", |i| &self.entries[i].name)
    }

    /// Reads `classes.json`, in either form:
    /// `{"0": "void", "1": "wall", ...}`, where id 0 must be absent or mean 'unlabelled' and is ignored;
    /// `{"ignore": 0, "classes": [{"id": 1, "name": "wall", "color": [r, g, b]}, ...]}` as [`Classes::write`] makes it
    /// (`color` may be absent; objects have `class` and `thing` besides, see [`ObjectOf`]).
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Input`] naming line or id: malformed JSON, ids that are not u16 or appear twice.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
        let expected = "{\"0\": \"void\", \"1\": \"NAME\", ..} or {\"ignore\": 0, \"classes\": [{\"id\": 1, \"name\": ..}, ..]}";
        let malformed = |e: serde_json::Error| {
            Error::input(
                path,
                format!("line {}", e.line()),
                e.to_string(),
                expected,
                "correct the file there",
            )
        };
        let Pairs(pairs) = serde_json::from_str(&text).map_err(malformed)?;
        if pairs.iter().any(|(key, _)| key == "classes") {
            let file: ClassFile = serde_json::from_str(&text).map_err(malformed)?;
            return file.into_classes(path);
        }
        let mut named = Vec::with_capacity(pairs.len());
        for (key, value) in pairs {
            let Ok(id) = key.parse::<u16>() else {
                let help = "renumber the classes";
                return Err(Error::input(
                    path,
                    "id",
                    format!("{key:?}"),
                    "a whole number from 0 to 65535",
                    help,
                ));
            };
            let serde_json::Value::String(name) = value else {
                return Err(Error::input(
                    path,
                    format!("id {id}"),
                    value.to_string(),
                    "a name",
                    "put it in quotes",
                ));
            };
            named.push((id, name));
        }
        check_unique(path, named.iter().map(|(id, _)| *id))?;
        let is_void = |name: &str| VOID_NAMES.contains(&name.trim().to_lowercase().as_str());
        if let Some((_, name)) = named
            .iter()
            .find(|(id, name)| *id == VOID && !is_void(name))
        {
            return Err(Error::input(
                path,
                "id 0",
                format!("{name:?}"),
                "\"void\": id 0 is the ignored one in this form of the file",
                "use the form with \"ignore\" and \"classes\", or add one to all ids",
            ));
        }
        Ok(Self::from_names(VOID, named))
    }

    /// Writes `{"ignore": .., "classes": [{"id", "name", "color"}, ..]}`, of objects `class` and `thing` too.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write(&self, path: &Path) -> Result<()> {
        let classes = self.entries.iter().map(ClassEntry::from).collect();
        let file = ClassFile {
            ignore: self.ignore,
            classes,
        };
        atomic::write(path, |out| {
            serde_json::to_writer_pretty(out, &file).map_err(Into::into)
        })
    }
}

fn check_unique(path: &Path, ids: impl Iterator<Item = u16>) -> Result<()> {
    let mut seen = std::collections::HashSet::new();
    for id in ids {
        if !seen.insert(id) {
            let help = "give each class an id of its own";
            return Err(Error::input(
                path,
                format!("id {id}"),
                "two entries",
                "one entry an id",
                help,
            ));
        }
    }
    Ok(())
}

/// The file's second form.
#[derive(Serialize, Deserialize)]
struct ClassFile {
    ignore: u16,
    classes: Vec<ClassEntry>,
}

#[derive(Serialize, Deserialize)]
struct ClassEntry {
    id: u16,
    name: String,
    color: Option<[u8; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    class: Option<u16>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    thing: Option<bool>,
}

impl From<&Class> for ClassEntry {
    fn from(c: &Class) -> Self {
        let (class, thing) = c.object_of.map(|of| (of.class, of.thing)).unzip();
        Self {
            id: c.id,
            name: c.name.clone(),
            color: Some(c.color),
            class,
            thing,
        }
    }
}

impl ClassFile {
    fn into_classes(self, path: &Path) -> Result<Classes> {
        check_unique(path, self.classes.iter().map(|c| c.id))?;
        let mut classes = Classes::from_names(
            self.ignore,
            self.classes.iter().map(|c| (c.id, c.name.clone())),
        );
        for entry in self.classes {
            let Some(i) = classes.index(entry.id) else {
                continue;
            };
            let class = &mut classes.entries[i];
            class.color = entry.color.unwrap_or(class.color);
            class.object_of = entry.class.map(|class| ObjectOf {
                class,
                thing: entry.thing.unwrap_or(true),
            });
        }
        Ok(classes)
    }
}

/// A JSON object as it stands: keys in order, repeated ones kept.
struct Pairs(Vec<(String, serde_json::Value)>);

impl<'de> Deserialize<'de> for Pairs {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> de::Visitor<'de> for Visitor {
            type Value = Pairs;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a JSON object")
            }
            fn visit_map<A: de::MapAccess<'de>>(self, mut map: A) -> Result<Pairs, A::Error> {
                let mut pairs = Vec::new();
                while let Some(pair) = map.next_entry()? {
                    pairs.push(pair);
                }
                Ok(Pairs(pairs))
            }
        }
        deserializer.deserialize_map(Visitor)
    }
}
