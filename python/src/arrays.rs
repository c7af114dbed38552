//! NumPy views of memory that a Python object of this crate owns.

use ndarray::{ArrayView, Dimension};
use numpy::{Element, PyArray, PyArrayMethods};
use pyo3::prelude::*;

/// Read-only NumPy view of `values`, without a copy. It keeps `owner` alive.
///
/// # Safety
/// `owner` owns the memory of `values`, and neither moves, changes nor frees it as long as it lives. Frozen classes whose vectors
/// are never handed out do so.
pub unsafe fn view<'py, T: Element, D: Dimension>(
    owner: &Bound<'py, PyAny>,
    values: ArrayView<'_, T, D>,
) -> Bound<'py, PyArray<T, D>> {
    // SAFETY: as the caller promises.
    let array = unsafe { PyArray::borrow_from_array(&values, owner.clone()) };
    array.readwrite().make_nonwriteable();
    array
}
