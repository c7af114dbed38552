//! Long vectors that are zero but for a few places, used again instead of made anew.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Lends vectors of zeros, all of one length. It has as many as were lent at a time: one a thread.
pub(super) struct Zeros<T> {
    len: usize,
    free: Mutex<Vec<Vec<T>>>,
}

/// A vector of zeros; who changes it makes it zero again before it goes back, on being dropped.
pub(super) struct Lent<'a, T> {
    values: Vec<T>,
    owner: &'a Zeros<T>,
}

impl<T: Copy + Default> Zeros<T> {
    /// None yet, of `len` values each.
    pub fn new(len: usize) -> Self {
        Self {
            len,
            free: Mutex::default(),
        }
    }

    pub fn lend(&self) -> Lent<'_, T> {
        let free = self.free().pop();
        Lent {
            values: free.unwrap_or_else(|| vec![T::default(); self.len]),
            owner: self,
        }
    }
}

impl<T> Zeros<T> {
    fn free(&self) -> MutexGuard<'_, Vec<Vec<T>>> {
        // A list is whole whatever a thread that panicked was about.
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> Deref for Lent<'_, T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.values
    }
}

impl<T> DerefMut for Lent<'_, T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.values
    }
}

impl<T> Drop for Lent<'_, T> {
    fn drop(&mut self) {
        // What a thread left in the middle of its work is not zero.
        if !std::thread::panicking() {
            let values = std::mem::take(&mut self.values);
            self.owner.free().push(values);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Zeros;

    #[test]
    fn what_comes_back_is_lent_again() {
        let zeros = Zeros::<f64>::new(3);
        let place = {
            let [mut one, other] = [zeros.lend(), zeros.lend()];
            one[1] = 2.0;
            assert_eq!(
                (&one[..], &other[..]),
                (&[0.0, 2.0, 0.0][..], &[0.0; 3][..])
            );
            one[1] = 0.0;
            one.as_ptr()
        };
        assert_eq!(zeros.free().len(), 2);
        // The last to come back, the first one of the two, is the next to go.
        let again = zeros.lend();
        assert!(again.as_ptr() == place && again.iter().all(|v| *v == 0.0));
    }
}
