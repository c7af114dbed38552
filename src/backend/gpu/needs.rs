//! Requirements of the kernels.

use super::UNITS;
use burn_cubecl::cubecl::ir::HardwareProperties;
use burn_cubecl::cubecl::prelude::*;

/// Buffers of the kernel that binds most, `parameters_backward`, cubecl's own included.
const BUFFERS: u32 = 14;
/// Bytes that the units of a cube share: the backward pass over tiles, in its narrowest block of channels.
const SHARED: usize = 32 << 10;

/// The requirement of the rasterizer's kernels that this device does not meet.
pub fn shortfall(client: &Client) -> Option<String> {
    lacks(&client.properties().hardware)
}

fn lacks(has: &HardwareProperties) -> Option<String> {
    if has.max_bindings < BUFFERS {
        return Some(format!(
            "it binds {} buffers to a kernel, and {BUFFERS} are needed",
            has.max_bindings
        ));
    }
    if has.max_shared_memory_size < SHARED {
        let bytes = has.max_shared_memory_size;
        return Some(format!(
            "{bytes} bytes are shared in a work group, and {SHARED} are needed"
        ));
    }
    let units = has.max_units_per_cube;
    (units < UNITS)
        .then(|| format!("a work group has {units} units at most, and {UNITS} are needed"))
}

#[cfg(all(test, feature = "wgpu"))]
mod tests {
    use super::*;
    use crate::backend::device::gpu_of_tests;
    use burn_cubecl::CubeDevice;

    #[test]
    fn what_is_short_is_named_with_both_numbers() {
        let Some(_) = gpu_of_tests() else { return };
        let enough = CubeDevice::Wgpu(Default::default())
            .client()
            .properties()
            .hardware
            .clone();
        assert_eq!(lacks(&enough), None);
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
            let said = lacks(&hardware).expect("something is short");
            assert!(parts.iter().all(|part| said.contains(part)), "{said}");
        }
    }
}
