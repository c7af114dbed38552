//! Which burn device a run uses. Order when several are compiled in: wgpu, flex, ndarray; `--backend` overrides.

use crate::error::{Error, Result};
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

/// The device of `name`, or of the best backend compiled in. Without autodiff; add it with `Device::autodiff`.
///
/// # Errors
/// [`Error::Device`] when the backend is not compiled in or has no usable adapter.
pub fn open(name: Option<BackendName>) -> Result<Device> {
    let Some(name) = name.or_else(|| BackendName::compiled().first().copied()) else {
        return Err(Error::Device {
            device: "none".into(),
            reason: "no backend is compiled in".into(),
            mend: "build with --features ndarray".into(),
        });
    };
    match name {
        #[cfg(feature = "wgpu")]
        BackendName::Wgpu => Ok(Device::wgpu(burn::tensor::DeviceKind::DefaultDevice)),
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
