//! Scenes: Gaussians with labels, as files have them.

use crate::arrays::view;
use crate::camera::{Camera, CameraArgument};
use crate::objects::{Objects, moves, turns};
use crate::raised;
use crate::renderer::{LastRenderer, Look};
use crate::view::View;
use coseg::data::{Classes, NamedCamera, read_cameras};
use coseg::error::{Result, ensure, invalid};
use coseg::features::FeatureColors;
use coseg::files::own;
use coseg::objects::{Edited, Editing, Edits, Identities};
use coseg::runs::{self, Cameras, FEATURE_COLORS, ObjectEdits, ObjectScene, SideFiles};
use coseg::splat::ply::PlyScene;
use ndarray::{ArrayView2, ArrayView3, arr1, aview1, aview2};
use numpy::{PyArray1, PyArray2, PyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Gaussians with labels.
#[pyclass(frozen, module = "coseg")]
pub struct Scene {
    /// The file that it was read from, or the scene was made from.
    source: PathBuf,
    /// Whether it is what the file holds.
    is_file: bool,
    /// The Gaussians, their origin and labels.
    ply: PlyScene,
    classes: Classes,
    pub identities: Option<Identities>,
    feature_colors: Option<FeatureColors>,
    pub features: Option<Features>,
    /// Read when they are needed, unless they came with the scene.
    cameras: OnceLock<Vec<NamedCamera>>,
    renderer: LastRenderer,
}

/// Lifted image features.
pub struct Features {
    /// Of each scale, `[N, dimensions]`.
    pub scales: Vec<Vec<f32>>,
    pub dimensions: usize,
}

impl Scene {
    /// The scene that `--scene` of the command line would mean by `given`, with what lies beside it.
    pub fn read(given: &Path) -> Result<Self> {
        let path = runs::scene_path(given)?;
        let ply = runs::read_scene(&path)?;
        let classes = runs::classes_beside(&path, None)?;
        let count = ply.gaussians.len();
        let identities = runs::identities_beside(&path, count, classes.len())?;
        let colors = path.with_file_name(FEATURE_COLORS);
        let colors = colors
            .is_file()
            .then(|| FeatureColors::read(&colors, count));
        Ok(Self {
            is_file: true,
            identities,
            feature_colors: colors.transpose()?,
            ..Self::made(path, ply, classes)
        })
    }

    /// A scene made from that in the file `source`.
    fn made(source: PathBuf, ply: PlyScene, classes: Classes) -> Self {
        Self {
            source,
            is_file: false,
            ply,
            classes,
            identities: None,
            feature_colors: None,
            features: None,
            cameras: OnceLock::new(),
            renderer: LastRenderer::default(),
        }
    }

    /// The Gaussians `ply` of the scene `given`, with the classes and cameras of `photos`.
    pub fn of_photos(given: &Path, ply: PlyScene, photos: coseg::data::Scene) -> Result<Self> {
        Ok(Self {
            cameras: photos.cameras().into(),
            ..Self::made(runs::scene_path(given)?, ply, photos.classes)
        })
    }

    /// The cameras beside the file.
    fn frames(&self) -> Result<&[NamedCamera]> {
        if let Some(frames) = self.cameras.get() {
            return Ok(frames);
        }
        let path = runs::cameras_path(None, &self.source)?;
        let frames = read_cameras(&path, None)?;
        Ok(self.cameras.get_or_init(|| frames))
    }

    /// The scene after `edits` or, if there are none, after `objects`.
    fn edited(&self, objects: &ObjectEdits, edits: Option<&Path>) -> Result<Self> {
        ensure!(edits.is_some() || !objects.is_empty(),
            argument "edit"; found "no operation"; expected "edits, or some of keep, remove, turn and move";
            help "say what to change");
        ensure!(edits.is_none() || objects.is_empty(),
            argument "edits"; found "keep, remove, turn or move beside it"; expected "edits alone";
            help "edit twice");
        let mut ply = self.ply.clone();
        let classes = self.classes.clone();
        let labels = match ply.labels.take() {
            Some(labels) => labels,
            // Edits may be the first labels of a scene.
            None if edits.is_some() => vec![classes.ignore; ply.gaussians.len()],
            None => return Err(runs::without_labels(&self.source)),
        };
        let editing = Editing::new(ply.gaussians.clone(), labels.clone(), classes.clone());
        let scene = ObjectScene::with_labels(self.source.clone(), ply, labels, classes);
        let Edited {
            gaussians,
            labels,
            classes,
        } = match edits {
            Some(file) => {
                ensure!(self.is_file, argument "--edits"; found "a scene that is in no file";
                    expected "the scene whose page the edits were saved from"; help "apply edits to the scene that was loaded");
                scene.edited(editing, &Edits::read(file)?)?
            }
            None => objects.apply(&scene, editing)?.0,
        };
        let ply = PlyScene {
            gaussians,
            origin: self.ply.origin,
            labels: Some(labels),
        };
        Ok(Self {
            cameras: self.cameras.clone(),
            ..Self::made(self.source.clone(), ply, classes)
        })
    }

    fn written(&self, path: &Path, force: bool) -> Result<PathBuf> {
        let inputs = (self.source.as_path(), None);
        let out = runs::scene_output(path, force, inputs, &self.classes)?;
        let PlyScene {
            gaussians,
            origin,
            labels,
        } = &self.ply;
        // Those of a vote are of the photos, not of the file.
        let made = self.cameras.get().filter(|_| !self.is_file);
        let has_names = labels.is_some() || !self.classes.is_empty();
        let beside = SideFiles {
            scenes: &[&out],
            classes: has_names.then_some(&self.classes),
            cameras: made.map_or(Cameras::Beside(&self.source), |made| Cameras::Used(made)),
        };
        beside.check(Some(force))?;
        runs::write_scene(&out, (gaussians, *origin), labels.as_deref(), &beside)?;
        Ok(out)
    }
}

/// `[N, width]` view of `values`, row-major, that `this` owns.
fn table<'py>(
    this: &Bound<'py, Scene>,
    values: &[f32],
    width: usize,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let shape = (this.get().ply.gaussians.len(), width);
    let values = aview1(values).into_shape_with_order(shape);
    let values: ArrayView2<'_, f32> = values.map_err(|e| PyValueError::new_err(e.to_string()))?;
    // SAFETY: `this` is frozen and owns the values.
    Ok(unsafe { view(this, values) })
}

/// `[N, width]` view of values that `this` owns.
fn rows<'py, const W: usize>(
    this: &Bound<'py, Scene>,
    values: &[[f32; W]],
) -> Bound<'py, PyArray2<f32>> {
    // SAFETY: `this` is frozen and owns the values.
    unsafe { view(this, aview2(values)) }
}

#[pymethods]
impl Scene {
    #[getter]
    fn source(&self) -> &Path {
        &self.source
    }

    #[getter]
    fn origin<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_owned_array(py, arr1(&self.ply.origin.to_array()))
    }

    #[getter]
    fn means<'py>(this: &Bound<'py, Self>) -> Bound<'py, PyArray2<f32>> {
        rows(this, &this.get().ply.gaussians.means)
    }

    #[getter]
    fn log_scales<'py>(this: &Bound<'py, Self>) -> Bound<'py, PyArray2<f32>> {
        rows(this, &this.get().ply.gaussians.log_scales)
    }

    #[getter]
    fn rotations<'py>(this: &Bound<'py, Self>) -> Bound<'py, PyArray2<f32>> {
        rows(this, &this.get().ply.gaussians.rotations)
    }

    #[getter]
    fn opacity_logits<'py>(this: &Bound<'py, Self>) -> Bound<'py, PyArray1<f32>> {
        // SAFETY: `this` is frozen and owns the values.
        unsafe { view(this, aview1(&this.get().ply.gaussians.opacity_logits)) }
    }

    #[getter]
    fn sh<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let gaussians = &this.get().ply.gaussians;
        let shape = (gaussians.len(), gaussians.sh_len(), 3);
        let values = aview1(&gaussians.sh).into_shape_with_order(shape);
        let values: ArrayView3<'_, f32> =
            values.map_err(|e| PyValueError::new_err(e.to_string()))?;
        // SAFETY: `this` is frozen and owns the values.
        Ok(unsafe { view(this, values) })
    }

    #[getter]
    fn labels<'py>(this: &Bound<'py, Self>) -> Option<Bound<'py, PyArray1<u16>>> {
        let labels = this.get().ply.labels.as_ref();
        // SAFETY: `this` is frozen and owns the values.
        labels.map(|labels| unsafe { view(this, aview1(labels)) })
    }

    #[getter]
    fn identities<'py>(this: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        let identities = this.get().identities.as_ref();
        let view = identities.map(|found| table(this, &found.scores, found.classes));
        view.transpose()
    }

    #[getter]
    fn features<'py>(this: &Bound<'py, Self>) -> PyResult<Option<Vec<Bound<'py, PyArray2<f32>>>>> {
        let features = this.get().features.as_ref();
        let scales = features.map(|features| {
            let scales = features.scales.iter();
            scales.map(|values| table(this, values, features.dimensions))
        });
        scales.map(Iterator::collect).transpose()
    }

    #[getter]
    fn feature_colors<'py>(this: &Bound<'py, Self>) -> Option<Bound<'py, PyArray2<f32>>> {
        let colors = this.get().feature_colors.as_ref();
        colors.map(|colors| rows(this, &colors.rgb))
    }

    #[getter]
    fn classes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let classes = PyDict::new(py);
        for class in &self.classes.entries {
            classes.set_item(class.id, &class.name)?;
        }
        Ok(classes)
    }

    #[getter]
    fn unlabelled(&self) -> u16 {
        self.classes.ignore
    }

    #[getter]
    fn cameras<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let cameras = PyDict::new(py);
        for frame in py.detach(|| self.frames()).map_err(raised)? {
            let camera = Camera::of_frame(frame.camera.clone(), frame.split.to_string());
            cameras.set_item(&frame.name, Bound::new(py, camera)?)?;
        }
        Ok(cameras)
    }

    #[pyo3(signature = (camera, *, size=None, depth=false, background=None, alpha_max=None, backend=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn render(
        &self,
        py: Python<'_>,
        camera: CameraArgument<'_>,
        size: Option<(usize, usize)>,
        depth: bool,
        background: Option<[f32; 3]>,
        alpha_max: Option<f64>,
        backend: Option<&str>,
    ) -> PyResult<View> {
        let backend = crate::arguments::backend(backend)?;
        let mut camera = match camera {
            CameraArgument::Camera(camera) => camera.get().camera.clone(),
            CameraArgument::Frame(name) => {
                let frames = py.detach(|| self.frames()).map_err(raised)?;
                let named = runs::named_frame(frames, &name).map_err(raised)?;
                named.camera.clone()
            }
        };
        if let Some((width, height)) = size {
            camera = camera.with_size(width, height);
        }
        let look = Look {
            backend,
            alpha_max,
            background,
            unlabelled: self.classes.ignore,
        };
        let render = || {
            self.renderer
                .render(&self.source, &self.ply, &camera, depth, look)
        };
        py.detach(render).map_err(raised)
    }

    #[pyo3(signature = (*, keep=None, remove=None, turn=None, r#move=None, edits=None))]
    fn edit(
        &self,
        py: Python<'_>,
        keep: Option<Objects>,
        remove: Option<Objects>,
        turn: Option<&Bound<'_, PyDict>>,
        r#move: Option<&Bound<'_, PyDict>>,
        edits: Option<PathBuf>,
    ) -> PyResult<Self> {
        let keep = keep.map(Objects::words);
        if keep.as_ref().is_some_and(Vec::is_empty) {
            return Err(raised(invalid!(argument "--keep"; found "no object";
                expected "one or more"; help "leave it out to keep all")));
        }
        let objects = ObjectEdits {
            keep: keep.unwrap_or_default(),
            remove: remove.map(Objects::words).unwrap_or_default(),
            turns: turn.map(turns).transpose()?.unwrap_or_default(),
            moves: r#move.map(moves).transpose()?.unwrap_or_default(),
        };
        py.detach(|| self.edited(&objects, edits.as_deref()))
            .map_err(raised)
    }

    #[pyo3(signature = (path, *, force=false))]
    fn save(&self, py: Python<'_>, path: PathBuf, force: bool) -> PyResult<PathBuf> {
        py.detach(|| own::guarded(&["edit"], || self.written(&path, force)))
            .map_err(raised)
    }

    fn __len__(&self) -> usize {
        self.ply.gaussians.len()
    }

    fn __repr__(&self) -> String {
        let made = if self.is_file { "" } else { "made from " };
        format!(
            "<coseg.Scene of {} Gaussians, {made}{}>",
            self.ply.gaussians.len(),
            self.source.display()
        )
    }
}

/// Loads what `--scene` of the command line accepts.
#[pyfunction]
pub fn load(py: Python<'_>, path: PathBuf) -> PyResult<Scene> {
    py.detach(|| Scene::read(&path)).map_err(raised)
}
