//! Host values that stay on a device.

use std::sync::{Mutex, PoisonError};

/// The device copy of a host value, made at first use. It is not part of the value: a clone makes its own, and all copies compare
/// equal.
pub struct Resident<T>(Mutex<Option<T>>);

#[cfg_attr(
    not(feature = "cube"),
    allow(dead_code, reason = "only GPUs keep copies")
)]
impl<T: Clone> Resident<T> {
    /// The copy for which `is_here` holds. `make` makes it if there is none.
    pub fn get(&self, is_here: impl Fn(&T) -> bool, make: impl FnOnce() -> T) -> T {
        // A panic in `make` leaves the slot as it was.
        let mut slot = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match &*slot {
            Some(copy) if is_here(copy) => copy.clone(),
            _ => slot.insert(make()).clone(),
        }
    }
}

impl<T> Default for Resident<T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

impl<T> Clone for Resident<T> {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl<T> PartialEq for Resident<T> {
    fn eq(&self, _other: &Self) -> bool {
        true
    }
}

impl<T> std::fmt::Debug for Resident<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Resident")
    }
}
