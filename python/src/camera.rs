//! Cameras.

use crate::raised;
use coseg::error::invalid;
use coseg::splat::camera;
use glam::DMat4;
use pyo3::prelude::*;

/// A pinhole camera in world units.
#[pyclass(frozen, eq, module = "coseg")]
#[derive(Clone, PartialEq)]
pub struct Camera {
    pub camera: camera::Camera,
    split: Option<String>,
}

impl Camera {
    /// A camera of a run.
    pub fn of_frame(camera: camera::Camera, split: String) -> Self {
        Self {
            camera,
            split: Some(split),
        }
    }
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (pose, focal, size, principal=None))]
    fn new(
        pose: [[f64; 4]; 4],
        focal: (f64, f64),
        size: (usize, usize),
        principal: Option<(f64, f64)>,
    ) -> PyResult<Self> {
        let mut camera = camera::Camera::centred(focal.into(), size.into());
        if let Some((cx, cy)) = principal {
            (camera.cx, camera.cy) = (cx, cy);
        }
        let matrix = DMat4::from_cols_array_2d(&pose).transpose();
        let posed = camera.with_opengl_pose(&matrix).ok_or_else(|| {
            invalid!(argument "camera.pose"; found "{pose:?}";
                expected "a camera-to-world matrix whose upper left 3x3 part is a rotation"; help "pass a usable camera")
        });
        let camera = posed.map_err(raised)?;
        camera.check().map_err(raised)?;
        Ok(Self {
            camera,
            split: None,
        })
    }

    /// Camera-to-world matrix, x right, y up, looking along -z.
    #[getter]
    fn pose(&self) -> [[f64; 4]; 4] {
        self.camera.to_opengl().transpose().to_cols_array_2d()
    }

    #[getter]
    fn focal(&self) -> (f64, f64) {
        (self.camera.fx, self.camera.fy)
    }

    #[getter]
    fn principal(&self) -> (f64, f64) {
        (self.camera.cx, self.camera.cy)
    }

    #[getter]
    fn size(&self) -> (usize, usize) {
        (self.camera.width, self.camera.height)
    }

    #[getter]
    fn split(&self) -> Option<&str> {
        self.split.as_deref()
    }

    fn __repr__(&self) -> String {
        let camera::Camera {
            center,
            width,
            height,
            ..
        } = &self.camera;
        format!(
            "<coseg.Camera {width}x{height} at {}, {}, {}>",
            center.x, center.y, center.z
        )
    }
}

/// A camera, or the name of a frame beside the scene.
#[derive(FromPyObject)]
pub enum CameraArgument<'py> {
    Frame(String),
    Camera(Bound<'py, Camera>),
}
