//! What is computed for each view at its first use, and kept while memory allows it.

use crate::error::Result;
use std::sync::Arc;

/// One value for each view, computed again at each use once the byte budget is spent.
pub struct ViewCache<T> {
    kept: Vec<Option<Arc<T>>>,
    /// Bytes left.
    budget: usize,
}

impl<T> ViewCache<T> {
    /// Nothing yet for `views` views. Keeps at most `budget` bytes.
    pub fn new(views: usize, budget: usize) -> Self {
        let kept = (0..views).map(|_| None).collect();
        Self { kept, budget }
    }

    /// The value of view `view`: the kept one, or what `make` returns, with its bytes.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn get(
        &mut self,
        view: usize,
        make: impl FnOnce() -> Result<(T, usize)>,
    ) -> Result<Arc<T>> {
        if let Some(kept) = &self.kept[view] {
            return Ok(kept.clone());
        }
        let (made, bytes) = make()?;
        let made = Arc::new(made);
        if let Some(left) = self.budget.checked_sub(bytes) {
            self.budget = left;
            self.kept[view] = Some(made.clone());
        }
        Ok(made)
    }
}
