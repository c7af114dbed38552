//! Diffusion of a row's identities, where settings ask for it, and how compact they are.

use super::segmentation_inputs::Inputs;
use super::variants::VariantOutcome;
use crate::config::{Blend, SegmentationConfig};
use crate::error::Result;
use crate::metrics::{Compactness, WithoutDiffusion};
use crate::objects::{Diffusion, Identities, NeighbourGraph};

/// The graph of a run, made once for all rows.
pub struct Compacting<'a> {
    graph: NeighbourGraph<'a>,
    config: &'a SegmentationConfig,
}

impl<'a> Compacting<'a> {
    /// The graph over the Gaussians of `inputs`, with the image features of the finest scale where a row needs them.
    ///
    /// # Errors
    /// Those of [`NeighbourGraph::new`].
    pub fn new(inputs: &'a Inputs) -> Result<Self> {
        let config = &inputs.config.segmentation;
        let features = inputs.seen.as_ref().map_or(&[][..], |seen| &seen.lifted[0]);
        let graph = NeighbourGraph::new(
            &inputs.gaussians.means,
            features,
            config.diffusion_neighbours,
        )?;
        Ok(Self { graph, config })
    }

    /// `row` with its identities diffused and scored again by `score`, and with its compactness.
    ///
    /// # Errors
    /// Those of [`NeighbourGraph::diffused`].
    pub fn finish(
        &self,
        row: VariantOutcome,
        score: impl Fn(&Identities, VariantOutcome) -> Result<VariantOutcome>,
    ) -> Result<VariantOutcome> {
        let Some(identities) = &row.identities else {
            return Ok(row);
        };
        let before = self.graph.disagreement(identities);
        if self.config.diffusion_steps == 0 {
            let compactness = Some(Compactness {
                neighbours_differ: before,
                without_diffusion: None,
            });
            return Ok(VariantOutcome { compactness, ..row });
        }
        let diffusion = Diffusion {
            steps: self.config.diffusion_steps,
            strength: self.config.diffusion_strength,
            temperature: self.config.diffusion_temperature,
        };
        let diffused = match (self.config.blend, row.rate) {
            // Trained under blended logits: what they stand for are their softmaxes.
            (Blend::Logits, Some(_)) => self.graph.diffused(&identities.softmax(), &diffusion)?,
            _ => self.graph.diffused(identities, &diffusion)?,
        };
        let without = WithoutDiffusion::new(&row.scores, before);
        let neighbours_differ = self.graph.disagreement(&diffused);
        let compactness = Some(Compactness {
            neighbours_differ,
            without_diffusion: Some(without),
        });
        let scored = score(&diffused, row)?;
        Ok(VariantOutcome {
            identities: Some(diffused),
            compactness,
            ..scored
        })
    }
}
