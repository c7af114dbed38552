//! What a camera sees of a scene.

use crate::arrays::view;
use coseg::objects::Frame;
use ndarray::{ArrayView2, ArrayView3, aview1};
use numpy::{PyArray2, PyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A rendered view.
#[pyclass(frozen, module = "coseg")]
pub struct View {
    pub frame: Frame,
    pub depth: Option<Vec<f32>>,
}

impl View {
    fn shape(&self) -> (usize, usize) {
        (self.frame.height, self.frame.width)
    }
}

/// Rows of pixels of a view that `this` owns.
fn pixels<'py, T: numpy::Element>(
    this: &Bound<'py, View>,
    values: &[T],
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let values = aview1(values).into_shape_with_order(this.get().shape());
    let values: ArrayView2<'_, T> = values.map_err(|e| PyValueError::new_err(e.to_string()))?;
    // SAFETY: `this` is frozen and owns the values.
    Ok(unsafe { view(this, values) })
}

#[pymethods]
impl View {
    #[getter]
    fn rgb<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let (height, width) = this.get().shape();
        let values = aview1(&this.get().frame.rgb).into_shape_with_order((height, width, 3));
        let values: ArrayView3<'_, f32> =
            values.map_err(|e| PyValueError::new_err(e.to_string()))?;
        // SAFETY: `this` is frozen and owns the values.
        Ok(unsafe { view(this, values) })
    }

    #[getter]
    fn alpha<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        pixels(this, &this.get().frame.alpha)
    }

    #[getter]
    fn labels<'py>(this: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyArray2<u16>>>> {
        let labels = this.get().frame.labels.as_ref();
        labels.map(|map| pixels(this, &map.ids)).transpose()
    }

    #[getter]
    fn depth<'py>(this: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        let depth = this.get().depth.as_ref();
        depth.map(|depth| pixels(this, depth)).transpose()
    }

    fn __repr__(&self) -> String {
        let (height, width) = self.shape();
        format!("<coseg.View {width}x{height}>")
    }
}
