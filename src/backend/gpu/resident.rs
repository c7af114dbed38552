//! Host values that stay on a device.

use super::Gpu;
use burn_cubecl::CubeDevice;
use std::sync::{Mutex, PoisonError};

/// The device copy of a host value, made at first use. It is not part of the value: a clone makes its own, and all copies compare
/// equal.
pub struct Resident<T>(Mutex<Option<(CubeDevice, T)>>);

impl<T: Clone> Resident<T> {
    /// The copy on the device of `gpu`, which `make` makes where there is none.
    pub fn on(&self, gpu: &Gpu, make: impl FnOnce() -> T) -> T {
        // A panic in `make` leaves the slot as it was.
        let mut slot = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match &*slot {
            Some((device, copy)) if device == gpu.device() => copy.clone(),
            _ => slot.insert((gpu.device().clone(), make())).1.clone(),
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
