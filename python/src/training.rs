//! Training and resuming runs.

use crate::progress::Callback;
use crate::scene::Scene;
use crate::{arguments, raised};
use coseg::backend::device;
use coseg::error::{Error, Result, ensure};
use coseg::files::own;
use coseg::report::Command;
use coseg::runs;
use coseg::runs::RunOptions;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// Trains as `coseg train` does.
#[pyfunction]
#[pyo3(signature = (data=None, *, scene=None, out=None, config=None, set=None, seed=None, resume=None, backend=None, callback=None))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn train(
    py: Python<'_>,
    data: Option<PathBuf>,
    scene: Option<PathBuf>,
    out: Option<PathBuf>,
    config: Option<PathBuf>,
    set: Option<&Bound<'_, PyDict>>,
    seed: Option<u64>,
    resume: Option<PathBuf>,
    backend: Option<&str>,
    callback: Option<Py<PyAny>>,
) -> PyResult<Option<Scene>> {
    let options = RunOptions {
        data,
        scene,
        out,
        resume,
        seed,
        config,
        sets: arguments::sets(set)?,
    };
    let backend = arguments::backend(backend)?;
    py.detach(|| {
        let mut progress = Callback::new(callback);
        let run = own::guarded(&["train"], || in_folder(&options, backend, &mut progress));
        // What stopped the run is the cause of an error that followed.
        if let Some(exception) = progress.raised() {
            return Err(exception);
        }
        let run = run.map_err(raised)?;
        run.map(|path| Scene::read(&path))
            .transpose()
            .map_err(raised)
    })
}

/// The run folder; `None` where `progress` stopped the run.
fn in_folder(
    options: &RunOptions,
    backend: Option<device::BackendName>,
    progress: &mut Callback,
) -> Result<Option<PathBuf>> {
    check(options)?;
    let (run, config) = options.open()?;
    runs::check_folder(&run, &config)?;
    let _lock = run.claim(options.resume.is_some())?;
    let trained = device::choose(backend).and_then(|(name, device)| {
        let threads = rayon::current_num_threads();
        let command = Command {
            line: call(options),
            device: format!("{} backend, {threads} threads", device::described(name)),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        runs::train(&run, &config, command, &device, progress)
    });
    match trained {
        Ok(_) => Ok(Some(run.path().to_owned())),
        Err(Error::Stopped) => Ok(None),
        Err(error) => {
            own::remove_empty(run.path());
            Err(error)
        }
    }
}

/// Refuses arguments that a resumed run does not take.
fn check(options: &RunOptions) -> Result<()> {
    let is_new = options.scene.is_some()
        || options.out.is_some()
        || options.seed.is_some()
        || options.config.is_some();
    ensure!(options.resume.is_none() || !is_new,
        argument "resume"; found "scene, out, seed or config beside it"; expected "data, set, backend and callback alone";
        help "leave the others out: a resumed run keeps its own");
    Ok(())
}

/// The call of Python, for the report.
fn call(options: &RunOptions) -> String {
    let path = |name: &str, path: &Option<PathBuf>| {
        path.as_ref()
            .map(|path| format!("{name}={:?}", path.display().to_string()))
    };
    let sets = options.sets.iter().map(|set| {
        let (key, value) = set.split_once('=').unwrap_or((set, ""));
        format!("{key:?}: {value:?}")
    });
    let sets: Vec<String> = sets.collect();
    let arguments = [
        path("data", &options.data),
        path("scene", &options.scene),
        path("out", &options.out),
        path("config", &options.config),
        path("resume", &options.resume),
        (!sets.is_empty()).then(|| format!("set={{{}}}", sets.join(", "))),
        options.seed.map(|seed| format!("seed={seed}")),
    ];
    let arguments: Vec<String> = arguments.into_iter().flatten().collect();
    format!("coseg.train({})", arguments.join(", "))
}
