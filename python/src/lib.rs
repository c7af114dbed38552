//! Python bindings of coseg: runs as NumPy views, rendering, votes, edits and training. `coseg/__init__.pyi` describes them.

mod arguments;
mod arrays;
mod camera;
mod objects;
mod photos;
mod progress;
mod renderer;
mod scene;
mod training;
mod view;
mod warnings;

use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;

create_exception!(
    coseg,
    Error,
    PyException,
    "What went wrong, in the words of the command line: what was found, what was expected, and how to correct it."
);

/// The error as a Python exception with the text of the command line.
fn raised(error: coseg::Error) -> PyErr {
    Error::new_err(error.to_string())
}

#[pymodule]
mod _coseg {
    #[pymodule_export]
    use super::Error;
    #[pymodule_export]
    use super::camera::Camera;
    #[pymodule_export]
    use super::photos::{lift, vote};
    #[pymodule_export]
    use super::progress::Event;
    #[pymodule_export]
    use super::scene::{Scene, load};
    #[pymodule_export]
    use super::training::train;
    #[pymodule_export]
    use super::view::View;
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        super::warnings::forward();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
