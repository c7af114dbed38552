//! Which burn device a run uses. Order when several are compiled in: wgpu (where there is an adapter), flex, ndarray;
//! `--backend` overrides.

use crate::error::{Error, Result};
use burn::backend::DispatchDevice;
use burn::tensor::Device;

/// A compute backend by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BackendName {
    /// burn-wgpu (WGSL).
    Wgpu,
    /// burn-flex, the named successor of ndarray.
    Flex,
    /// burn-ndarray.
    Ndarray,
}

impl BackendName {
    /// The backends compiled into this build, best first.
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

impl std::fmt::Display for BackendName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Wgpu => "wgpu",
            Self::Flex => "flex",
            Self::Ndarray => "ndarray",
        })
    }
}

impl std::str::FromStr for BackendName {
    type Err = Error;
    fn from_str(name: &str) -> Result<Self> {
        match name {
            "wgpu" => Ok(Self::Wgpu),
            "flex" => Ok(Self::Flex),
            "ndarray" => Ok(Self::Ndarray),
            _ => Err(Error::config("backend", name, "wgpu, flex or ndarray", "choose one of them")),
        }
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
/// Without a name, a wgpu backend that finds no adapter gives way to the next one, with one warning. The devices
/// themselves are lazy: wgpu's adapter is asked for here, so that its absence is an error and not a later panic.
///
/// # Errors
/// [`Error::Device`] when the backend asked for is not compiled in or has no usable adapter.
pub fn choose(name: Option<BackendName>) -> Result<(BackendName, Device)> {
    if let Some(name) = name {
        return Ok((name, device(name)?));
    }
    let compiled = BackendName::compiled();
    for (i, &name) in compiled.iter().enumerate() {
        match (device(name), compiled.get(i + 1)) {
            (Ok(device), _) => return Ok((name, device)),
            (Err(error), None) => return Err(error),
            (Err(error), Some(next)) => {
                let reason = match error {
                    Error::Device { reason, .. } => reason,
                    other => other.to_string(),
                };
                tracing::warn!("{name}: {reason}; computing with {next} instead");
            }
        }
    }
    Err(Error::Device {
        device: "none".into(),
        reason: "no backend is compiled in".into(),
        mend: "build with --features ndarray".into(),
    })
}

/// Whether tensors on `device`, with or without autodiff, lie in host memory.
///
/// Fused operations lend such tensors to kernels for the CPU; elsewhere their plain form keeps the data on the device.
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

fn device(name: BackendName) -> Result<Device> {
    match name {
        #[cfg(feature = "wgpu")]
        BackendName::Wgpu => wgpu(),
        #[cfg(feature = "flex")]
        BackendName::Flex => Ok(Device::flex()),
        #[cfg(feature = "ndarray")]
        BackendName::Ndarray => Ok(Device::ndarray()),
        #[allow(unreachable_patterns, reason = "unreachable only when every backend is compiled in")]
        other => Err(Error::Device {
            device: other.to_string(),
            reason: "not part of this build".into(),
            mend: format!("build with --features {other}"),
        }),
    }
}

/// The default wgpu device, its adapter acquired once a process.
#[cfg(feature = "wgpu")]
fn wgpu() -> Result<Device> {
    use burn::tensor::DeviceKind::DefaultDevice;
    use burn::tensor::wgpu::WgpuInitError;
    static ADAPTER: std::sync::OnceLock<Result<(), String>> = std::sync::OnceLock::new();
    let adapter = ADAPTER.get_or_init(|| match Device::wgpu_options().init() {
        // Registered already: somebody computes on it.
        Ok(_) | Err(WgpuInitError::Registration { .. }) => Ok(()),
        Err(WgpuInitError::AdapterUnavailable { message, .. }) => Err(message),
        Err(error) => Err(error.to_string()),
    });
    match adapter {
        Ok(()) => Ok(Device::wgpu(DefaultDevice)),
        Err(reason) => Err(Error::Device {
            device: BackendName::Wgpu.to_string(),
            reason: format!("no usable adapter ({reason})"),
            mend: "install a Vulkan, Metal or DX12 driver (Debian: mesa-vulkan-drivers has a software one), or choose \
                   another backend"
                .into(),
        }),
    }
}
