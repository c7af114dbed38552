//! Settings that somebody gave and that nothing reads, because another one says so.

use super::{BuildingConfig, Config, FeatureSource, SpatialSource, Strategy};

impl Config {
    /// A sentence for each setting that no part of a run reads, because another says so. One that has its default is not told of:
    /// the `config.toml` of a run lists what nobody gave.
    pub fn unread(&self) -> Vec<String> {
        let (f, s) = (&self.features, &self.spatial);
        let reads_weights = !matches!(f.source, FeatureSource::Descriptor | FeatureSource::Import);
        let paths = [
            ("features.weights", &f.weights, reads_weights, "features.source is descriptor or import"),
            ("features.import_dir", &f.import_dir, f.source == FeatureSource::Import, "features.source is not import"),
            ("spatial.weights", &s.weights, s.source == SpatialSource::Pretrained, "spatial.source is not pretrained"),
        ];
        let mut unread = Vec::new();
        for (key, path, read, why) in paths {
            if let (Some(path), false) = (path, read) {
                unread.push(format!("{key} = {} is not read: {why}", path.display()));
            }
        }
        if self.building.strategy == Strategy::Mcmc {
            let b = &self.building;
            let usual = BuildingConfig { absgrad: b.absgrad, ..BuildingConfig::default() };
            for (key, value, usual) in [
                ("densify_threshold", b.densify_threshold(), usual.densify_threshold()),
                ("clone_below", b.clone_below, usual.clone_below),
                ("prune_scale", b.prune_scale, usual.prune_scale),
                ("reset_every", b.reset_every as f32, usual.reset_every as f32),
            ] {
                if value != usual {
                    unread.push(format!("building.{key} = {value} is not read: building.strategy is mcmc"));
                }
            }
        }
        unread
    }
}
