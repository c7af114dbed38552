//! The scene of a run.

use crate::config::{Config, DataConfig};
use crate::data::{self, LoadOptions, Scene, builtin};
use crate::error::Result;

/// The scene that `config.data` names: a folder, or the built-in scene.
///
/// # Errors
/// Those of the loader, each naming file and field.
pub fn load_scene(config: &Config) -> Result<Scene> {
    match &config.data.dir {
        None => {
            let unused = unused_keys(&config.data);
            if !unused.is_empty() {
                let unused = unused.join(", ");
                tracing::warn!(
                    "the built-in room does not use {unused}; --data names a scene folder"
                );
            }
            Ok(builtin::scene(builtin::EVALUATED_SEED))
        }
        Some(dir) => data::load(dir, &LoadOptions::from(config)),
    }
}

/// The keys whose values are not the defaults, and which the built-in room does not use.
fn unused_keys(data: &DataConfig) -> Vec<String> {
    let used = DataConfig {
        raw_labels_note: data.raw_labels_note.clone(),
        labels_by: data.labels_by,
        association: data.association,
        ..DataConfig::default()
    };
    let json = |data: &DataConfig| serde_json::to_value(data).unwrap_or_default();
    let (given, used) = (json(data), json(&used));
    let keys = given.as_object().into_iter().flat_map(|given| given.keys());
    keys.filter(|key| given[*key] != used[*key])
        .map(|key| format!("data.{key}"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Association;

    #[test]
    fn the_built_in_room_uses_few_settings_of_data() {
        let used = DataConfig {
            raw_labels_note: "mine".into(),
            association: Association::Gaussians,
            ..DataConfig::default()
        };
        assert!(unused_keys(&used).is_empty());
        let unused = DataConfig {
            max_side: 120,
            stride: 4,
            ..used
        };
        assert_eq!(unused_keys(&unused), ["data.max_side", "data.stride"]);
    }
}
