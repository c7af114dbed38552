//! The checkpoint of a variant in training.

use super::adam::{load_vector, parameters, save_vector, with_parameters};
use super::{ClassRecall, IdentityModel, Training, TrainingPlan, TrainingSchedule};
use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::provenance::Provenance;
use std::path::Path;

const KIND: &str = "segmentation variant";
const PARAMETERS: &str = "parameters";

impl<M: IdentityModel> Training<M> {
    /// Writes everything that training needs to continue.
    pub(super) fn save(&self, provenance: &Provenance, path: &Path) -> Result<()> {
        let mut checkpoint = Checkpoint::new(KIND);
        checkpoint.set("iteration", &self.iteration)?;
        checkpoint.set("provenance", provenance)?;
        checkpoint.set("curve", &self.curve)?;
        checkpoint.set("seconds", &self.seconds)?;
        checkpoint.set("losses", &self.losses)?;
        checkpoint.put("recall", &[self.recall.0.len()], self.recall.0.clone())?;
        save_vector(&mut checkpoint, PARAMETERS, parameters(&self.module))?;
        self.adam.save(&mut checkpoint)?;
        checkpoint.save(path)
    }

    /// Continues from the checkpoint of `schedule`, if there is one.
    pub(super) fn resume(
        &mut self,
        plan: &TrainingPlan,
        schedule: &TrainingSchedule,
    ) -> Result<()> {
        let Some(path) = schedule.checkpoint.as_ref().filter(|path| path.is_file()) else {
            return Ok(());
        };
        let mut checkpoint = Checkpoint::load(path, KIND)?;
        let stored: Provenance = checkpoint.get("provenance")?;
        self.iteration = checkpoint.get("iteration")?;
        let finished = self.iteration == plan.config.iterations;
        schedule.provenance.check(&stored, finished, path, None)?;
        let fresh = parameters(&self.module);
        let trained = load_vector(&mut checkpoint, PARAMETERS, &fresh)?;
        self.module = with_parameters(self.module.clone(), trained);
        self.adam.load(&mut checkpoint, &fresh)?;
        self.seconds = checkpoint.get("seconds")?;
        self.losses = checkpoint.get("losses")?;
        self.recall = ClassRecall(checkpoint.take("recall", &[self.recall.0.len()])?);
        self.curve = checkpoint.get("curve")?;
        if !schedule.provenance.renders_as(&stored) {
            // These scores were rendered by a different rule than this run's.
            self.curve.iter_mut().for_each(|point| point.miou = None);
        }
        Ok(())
    }
}
