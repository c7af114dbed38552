//! Which burn device a run uses. The order when several are compiled in: wgpu (if there is an adapter), flex, ndarray;
//! `--backend` overrides the order. Only `--backend cuda` selects cuda, which has never been run.

use crate::error::{Error, Result, invalid};
use burn::backend::DispatchDevice;
use burn::tensor::{DType, Device, Element, Int, Tensor, TensorData};
use serde::de::IntoDeserializer;
use serde::{Deserialize, Serialize};
use std::fmt::Display;

/// A compute backend by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BackendName {
    /// burn-cuda.
    Cuda,
    /// burn-wgpu: WGSL, or SPIR-V with the feature `vulkan`.
    Wgpu,
    /// burn-flex, the named successor of ndarray.
    Flex,
    /// burn-ndarray.
    Ndarray,
}

impl BackendName {
    /// The compiled backends that are chosen without `--backend`, best first.
    pub fn compiled() -> &'static [Self] {
        &[
            #[cfg(feature = "wgpu")]
            Self::Wgpu,
            #[cfg(feature = "flex")]
            Self::Flex,
            #[cfg(feature = "ndarray")]
            Self::Ndarray,
        ]
    }
}

impl Display for BackendName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.serialize(f)
    }
}

impl std::str::FromStr for BackendName {
    type Err = Error;
    fn from_str(name: &str) -> Result<Self> {
        Self::deserialize(name.into_deserializer()).map_err(|_: serde::de::value::Error| {
            invalid!(argument "backend"; found "{name}";
                expected "cuda, wgpu, flex or ndarray"; help "choose one of them")
        })
    }
}

/// The device of `name`, or of the best backend compiled in that this machine can run. Without autodiff; add it with
/// `Device::autodiff`.
///
/// # Errors
/// As [`choose`].
pub fn open(name: Option<BackendName>) -> Result<Device> {
    Ok(choose(name)?.1)
}

/// [`open`], and which backend it is.
///
/// Without a name, the next backend is taken, with a warning, where wgpu finds no adapter, only a software adapter, or one that the
/// rasterizer's kernels do not run on ([`missing_capability`]). The devices themselves are lazy: wgpu's adapter is acquired here,
/// so that its absence is an error and not a later panic.
///
/// # Errors
/// [`Error::Device`] when the named backend is not compiled in or has no usable adapter.
pub fn choose(name: Option<BackendName>) -> Result<(BackendName, Device)> {
    if let Some(name) = name {
        return Ok((name, device(name)?));
    }
    let mut compiled = BackendName::compiled().iter().copied().peekable();
    while let Some(name) = compiled.next() {
        let opened = device(name);
        // The last one is taken as it is.
        let Some(next) = compiled.peek() else {
            return Ok((name, opened?));
        };
        let reason = match opened {
            Ok(device) => match unsuited(name, &device) {
                None => return Ok((name, device)),
                Some(reason) => format!("{reason} (--backend {name} takes it)"),
            },
            Err(Error::Device { reason, .. }) => reason,
            Err(other) => other.to_string(),
        };
        tracing::warn!("{name}: {reason}; computing with {next} instead");
    }
    let reason = "no backend is compiled in";
    Err(unusable("none", reason, "build with --features ndarray"))
}

/// An [`Error::Device`].
fn unusable(device: impl Display, reason: impl Into<String>, help: impl Into<String>) -> Error {
    Error::Device {
        device: device.to_string(),
        reason: reason.into(),
        help: help.into(),
    }
}

/// The best CPU backend compiled in, else the best backend.
///
/// # Errors
/// As [`choose`].
pub fn open_cpu() -> Result<Device> {
    let compiled = BackendName::compiled().iter();
    let cpu = compiled.copied().find(|name| *name != BackendName::Wgpu);
    open(cpu)
}

/// `name` and, where it is known, its adapter: "wgpu (NVIDIA H100 PCIe, vulkan)". A software adapter is called one.
pub fn described(name: BackendName) -> String {
    #[cfg(feature = "wgpu")]
    if let (BackendName::Wgpu, Ok(Some(adapter))) = (name, adapter()) {
        let kind = if adapter.software {
            ", a software adapter"
        } else {
            ""
        };
        return format!("{name} ({}{kind})", adapter.name);
    }
    name.to_string()
}

/// The device of wgpu for tests, a software one too, if all kernels of this crate run on it. Without one they print so and pass,
/// unless COSEG_REQUIRE_GPU is set. Its value `hardware` excludes software adapters.
#[cfg(test)]
pub(crate) fn gpu_of_tests() -> Option<Device> {
    let required = std::env::var_os("COSEG_REQUIRE_GPU");
    let hardware = required.as_ref().is_some_and(|how| how == "hardware");
    let name = BackendName::Wgpu;
    let opened = open(Some(name)).map_err(|error| error.to_string());
    let suited = opened.and_then(|device| {
        let reason = if hardware {
            unsuited(name, &device)
        } else {
            missing_capability(&device)
        };
        reason.map_or(Ok(device), Err)
    });
    let suited = suited.inspect_err(|reason| assert!(required.is_none(), "{reason}"));
    suited
        .inspect_err(|reason| eprintln!("SKIPPED: {reason}"))
        .ok()
}

/// The device of `name` for tests, a GPU as [`gpu_of_tests`]; other backends that do not open are reported.
#[cfg(test)]
pub(crate) fn device_of_tests(name: BackendName) -> Option<Device> {
    match name {
        BackendName::Wgpu => gpu_of_tests(),
        _ => open(Some(name))
            .inspect_err(|error| eprintln!("SKIPPED: {error}"))
            .ok(),
    }
}

/// Whether tensors on `device`, with or without autodiff, lie in host memory.
///
/// For custom operations, which choose their kernel by it.
pub fn in_host_memory(device: &Device) -> bool {
    match device.clone().inner().as_dispatch() {
        #[cfg(feature = "flex")]
        DispatchDevice::Flex(_) => true,
        #[cfg(feature = "ndarray")]
        DispatchDevice::NdArray(_) => true,
        #[allow(unreachable_patterns, reason = "unreachable without a GPU backend")]
        _ => false,
    }
}

/// The requirement of the rasterizer's kernels that `device`, if it is a GPU, does not meet. Such a device copies to the host and
/// renders on the CPU.
pub fn missing_capability(device: &Device) -> Option<String> {
    match device.clone().inner().as_dispatch() {
        #[cfg(feature = "cube")]
        DispatchDevice::Cube(device) => super::gpu::missing_capability(&device.client()),
        _ => None,
    }
}

/// Bytes of the largest buffer of `device`, with or without autodiff, where it is a GPU.
pub(crate) fn largest_allocation(device: &Device) -> Option<usize> {
    match device.clone().inner().as_dispatch() {
        #[cfg(feature = "cube")]
        DispatchDevice::Cube(device) => Some(super::gpu::largest_buffer(&device.client())),
        _ => None,
    }
}

/// A tensor of these row-major values on `device`.
pub(crate) fn upload<const D: usize>(
    values: Vec<f32>,
    shape: [usize; D],
    device: &Device,
) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// Row numbers as a tensor on `device`.
pub(crate) fn indices(rows: &[u32], device: &Device) -> Tensor<1, Int> {
    let values: Vec<i64> = rows.iter().map(|&row| i64::from(row)).collect();
    Tensor::from_data(TensorData::new(values, [rows.len()]), device)
}

/// The row-major values of a tensor of f32, on the host; `what` names it.
///
/// # Errors
/// [`Error::Device`] when the device does not return them, also for errors since the last read, such as a lack of memory.
pub(crate) fn read<const D: usize>(what: &str, tensor: Tensor<D>) -> Result<Vec<f32>> {
    read_as(what, tensor)
}

fn read_as<E: Element, const D: usize>(what: &str, tensor: Tensor<D>) -> Result<Vec<E>> {
    let data = tensor.try_into_data().map_err(|e| unreadable(what, &e))?;
    data.into_vec().map_err(|e| unreadable(what, &e))
}

fn unreadable(what: &str, reason: &dyn std::fmt::Debug) -> Error {
    let reason = format!("reading {what} back failed: {reason:?}");
    let help = "check whether the device has memory left, or choose a CPU backend";
    unusable("in use", reason, help)
}

/// [`read`] of a tensor of any float type.
pub(crate) fn read_wide<const D: usize>(what: &str, tensor: Tensor<D>) -> Result<Vec<f64>> {
    if tensor.dtype() == DType::F64 {
        return read_as(what, tensor);
    }
    Ok(read(what, tensor)?.into_iter().map(f64::from).collect())
}

fn device(name: BackendName) -> Result<Device> {
    match name {
        #[cfg(feature = "cuda")]
        BackendName::Cuda => cuda(),
        #[cfg(feature = "wgpu")]
        BackendName::Wgpu => wgpu(),
        #[cfg(feature = "flex")]
        BackendName::Flex => Ok(Device::flex()),
        #[cfg(feature = "ndarray")]
        BackendName::Ndarray => Ok(Device::ndarray()),
        #[allow(
            unreachable_patterns,
            reason = "unreachable only when every backend is compiled in"
        )]
        other => {
            let has: Vec<String> = BackendName::compiled()
                .iter()
                .map(ToString::to_string)
                .collect();
            let reason = format!("not part of this build, which has {}", has.join(", "));
            let help = format!("choose one of these, or build with --features {other}");
            Err(unusable(other, reason, help))
        }
    }
}

/// The first CUDA device.
#[cfg(feature = "cuda")]
fn cuda() -> Result<Device> {
    // The device itself is lazy, and panics where the driver's library is missing.
    let found = ["/dev/nvidiactl", "/dev/dxg"]
        .iter()
        .any(|path| std::path::Path::new(path).exists());
    if found || cfg!(windows) {
        return Ok(Device::cuda(0));
    }
    let help = "install the NVIDIA driver, or choose another backend";
    Err(unusable(
        BackendName::Cuda,
        "no NVIDIA driver is loaded",
        help,
    ))
}

/// The default wgpu device.
#[cfg(feature = "wgpu")]
fn wgpu() -> Result<Device> {
    match adapter() {
        Ok(_) => Ok(Device::wgpu(burn::tensor::DeviceKind::DefaultDevice)),
        Err(reason) => Err(unusable(
            BackendName::Wgpu,
            format!("no usable adapter ({reason})"),
            "install a Vulkan, Metal or DX12 driver (Debian: mesa-vulkan-drivers has a software one), or choose another backend",
        )),
    }
}

/// The adapter that wgpu computes on.
#[cfg(feature = "wgpu")]
#[derive(Clone, Debug)]
struct Adapter {
    /// As its driver names it, with the interface that it is reached by.
    name: String,
    software: bool,
}

/// Acquires the adapter of the default wgpu device, only once. Returns its properties, or why there is none.
#[cfg(feature = "wgpu")]
fn adapter() -> &'static std::result::Result<Option<Adapter>, String> {
    use burn::tensor::wgpu::{WgpuInitError, wgpu::DeviceType};
    static ADAPTER: std::sync::OnceLock<std::result::Result<Option<Adapter>, String>> =
        std::sync::OnceLock::new();
    ADAPTER.get_or_init(|| match Device::wgpu_options().init_with_setup() {
        Ok((_, setup)) => {
            let info = setup.adapter.get_info();
            let software = info.device_type == DeviceType::Cpu;
            Ok(Some(Adapter {
                name: format!("{}, {}", info.name, info.backend),
                software,
            }))
        }
        // Registered already: another part of the program computes on it.
        Err(WgpuInitError::Registration { .. }) => Ok(None),
        Err(WgpuInitError::AdapterUnavailable { message, .. }) => Err(message),
        Err(error) => Err(error.to_string()),
    })
}

/// The reason to choose a backend other than `name` with its `device`, if there is one.
fn unsuited(name: BackendName, device: &Device) -> Option<String> {
    let software = software_adapter(name)
        .map(|adapter| format!("the only adapter is {adapter}, a software one"));
    let lacking = || {
        Some(format!(
            "its adapter lacks what the kernels need: {}",
            missing_capability(device)?
        ))
    };
    software.or_else(lacking)
}

/// Name of the software adapter that `name` would compute on, if it is one.
fn software_adapter(name: BackendName) -> Option<String> {
    match name {
        #[cfg(feature = "wgpu")]
        BackendName::Wgpu => adapter()
            .clone()
            .ok()
            .flatten()
            .filter(|adapter| adapter.software)
            .map(|a| a.name),
        _ => None,
    }
}
