//! The checkpoint of a variant in training.

use super::adam::{parameters, restored};
use super::{ClassRecall, IdentityModel, Losses, Training, TrainingPlan, TrainingSchedule};
use crate::backend::device::read;
use crate::checkpoint::Checkpoint;
use crate::error::Result;
use crate::provenance::Provenance;
use burn::module::Module;
use std::collections::HashMap;
use std::path::Path;

const KIND: &str = "segmentation variant";
const PARAMETERS: &str = "parameters";

impl<M: IdentityModel> Training<M> {
    /// Writes everything that training goes on from.
    pub(super) fn save(&self, provenance: &Provenance, path: &Path) -> Result<()> {
        let mut checkpoint = Checkpoint::new(KIND);
        checkpoint.set("iteration", &self.iteration)?;
        checkpoint.set("provenance", provenance)?;
        checkpoint.put_curve(&self.curve)?;
        let Losses { sum, count } = self.losses;
        checkpoint.put("running", &[3], vec![self.seconds, sum, count])?;
        checkpoint.put("recall", &[self.recall.0.len()], self.recall.0.clone())?;
        let mut vectors = self.adam.state()?;
        vectors.push((
            PARAMETERS.to_owned(),
            read(PARAMETERS, parameters(&self.module))?,
        ));
        let lengths: Vec<(&str, usize)> = vectors
            .iter()
            .map(|(name, values)| (name.as_str(), values.len()))
            .collect();
        checkpoint.set("vectors", &lengths)?;
        for (name, values) in vectors {
            checkpoint.put(name, &[values.len()], values)?;
        }
        checkpoint.save(path)
    }

    /// Goes on from the checkpoint of `schedule`, where there is one.
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
        schedule.provenance.check(&stored, finished, path)?;
        let lengths: Vec<(String, usize)> = checkpoint.get("vectors")?;
        let mut vectors: HashMap<String, Vec<f32>> = HashMap::new();
        for (name, length) in lengths {
            let values = checkpoint.take(&name, &[length])?;
            vectors.insert(name, values);
        }
        if self.restore(&|name| vectors.get(name).cloned()).is_none() {
            return Err(checkpoint.wrong(
                "vectors",
                "those of another model",
                "parameters and moments of this variant",
            ));
        }
        let running: Vec<f64> = checkpoint.take("running", &[3])?;
        self.seconds = running[0];
        self.losses = Losses {
            sum: running[1],
            count: running[2],
        };
        self.recall = ClassRecall(checkpoint.take("recall", &[self.recall.0.len()])?);
        self.curve = checkpoint.take_curve()?;
        if !schedule.provenance.renders_as(&stored) {
            // Scores by another rule than this run's.
            self.curve.iter_mut().for_each(|point| point.miou = None);
        }
        Ok(())
    }

    /// Takes back parameters and the state of Adam. `None` when a vector is missing or has another length.
    fn restore(&mut self, state: &dyn Fn(&str) -> Option<Vec<f32>>) -> Option<()> {
        let device = self.module.devices().into_iter().next()?;
        self.module = restored(self.module.clone(), state(PARAMETERS)?, &device)?;
        self.adam.restore(state, &device)
    }
}
