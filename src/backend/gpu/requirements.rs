//! What the kernels require of a device.

use super::UNITS;
use burn_cubecl::cubecl::ir::HardwareProperties;
use burn_cubecl::cubecl::prelude::*;

/// Buffers that `parameters_backward` binds, cubecl's own included. No kernel binds more.
const MIN_BUFFERS: u32 = 14;
/// Bytes of shared memory of a cube in the backward pass over tiles, in its narrowest block of channels.
const MIN_SHARED_BYTES: usize = 32 << 10;

/// The capability that the rasterizer's kernels require and this device does not have.
pub fn missing_capability(client: &Client) -> Option<String> {
    missing(&client.properties().hardware)
}

fn missing(hardware: &HardwareProperties) -> Option<String> {
    if hardware.max_bindings < MIN_BUFFERS {
        return Some(format!(
            "it binds {} buffers to a kernel, and {MIN_BUFFERS} are needed",
            hardware.max_bindings
        ));
    }
    if hardware.max_shared_memory_size < MIN_SHARED_BYTES {
        let bytes = hardware.max_shared_memory_size;
        return Some(format!(
            "{bytes} bytes are shared in a work group, and {MIN_SHARED_BYTES} are needed"
        ));
    }
    let units = hardware.max_units_per_cube;
    (units < UNITS)
        .then(|| format!("a work group has {units} units at most, and {UNITS} are needed"))
}

#[cfg(all(test, feature = "wgpu"))]
mod tests {
    use super::*;
    use crate::backend::device::gpu_of_tests;
    use burn_cubecl::CubeDevice;

    #[test]
    fn a_missing_capability_is_named_with_both_numbers() {
        let Some(_) = gpu_of_tests() else { return };
        let enough = CubeDevice::Wgpu(Default::default())
            .client()
            .properties()
            .hardware
            .clone();
        assert_eq!(missing(&enough), None);
        let few_buffers = HardwareProperties {
            max_bindings: 9,
            ..enough.clone()
        };
        let little_memory = HardwareProperties {
            max_shared_memory_size: 16_384,
            ..enough.clone()
        };
        let few_units = HardwareProperties {
            max_units_per_cube: 128,
            ..enough
        };
        let cases = [
            (few_buffers, ["9 buffers", "14"]),
            (little_memory, ["16384", "32768"]),
            (few_units, ["128", "256"]),
        ];
        for (hardware, parts) in cases {
            let message = missing(&hardware).expect("a missing capability");
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
    }
}
