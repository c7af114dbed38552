#!/usr/bin/env bash
# On a machine with a GPU: checks that the kernels are right there and measures how fast they are.
#
#     scripts/measure_gpu.sh [OUT]            OUT is `measured` by default
#
# COSEG and SUITE name binaries that were built elsewhere (`cargo build`, and the two of `cargo test --no-run --lib --test suite`,
# each with --release --features wgpu), and RASTER the one of `cargo bench --no-run --bench raster`; without them the script
# builds here. wgpu falls back to a software adapter where the
# GPU's driver has no Vulkan; the script refuses that unless SOFTWARE=1. Where Python has PyTorch with CUDA and gsplat, gsplat
# is timed on the same Gaussians and cameras. Each step leaves a log. A step that fails does not stop the others.
set -uo pipefail
cd "$(dirname "$0")/.."
out=${1:-measured}
mkdir -p "$out"
failed=0

step() {
  local name=$1 start=$SECONDS
  shift
  if "$@" >"$out/$name.log" 2>&1; then
    echo "$name: $((SECONDS - start)) s"
  else
    echo "$name: FAILED after $((SECONDS - start)) s, see $out/$name.log"
    failed=1
  fi
}

if [ -z "${COSEG:-}" ]; then
  step build cargo build --release --features wgpu
  COSEG=target/release/coseg
fi
[ "${SOFTWARE:-0}" = 1 ] && COSEG_REQUIRE_GPU=any || COSEG_REQUIRE_GPU=hardware
export COSEG_REQUIRE_GPU
{ nvidia-smi || vulkaninfo --summary; } >"$out/device.txt" 2>&1

# Kernels against the CPU's in f64, both stages against ndarray. A test that finds no such device fails.
parity() {
  if [ -n "${SUITE:-}" ]; then
    for binary in $SUITE; do "$binary" --nocapture gpu device blocks room noise raster gsplat photo || return 1; done
  else
    cargo test --release --features wgpu --lib --test suite -- --nocapture gpu device blocks room noise raster gsplat photo || return 1
  fi
}
step parity parity

step train "$COSEG" train --backend wgpu --out "$out/run"
step bench "$COSEG" bench --backend wgpu --run "$out/run" --gaussians 10000,100000,1000000 --json "$out/bench.json"
# Cargo runs benchmarks in the folder of the package.
step raster ${RASTER:-cargo bench --features wgpu --bench raster --} "$(realpath "$out")/run" --backend wgpu \
  --gaussians 10000,100000,1000000 --export "$(realpath "$out")/subject" --json "$(realpath "$out")/coseg.json"
if [ "$COSEG_REQUIRE_GPU" = hardware ] && grep -q 'software adapter' "$out/coseg.json"; then
  echo "bench: not measured on a GPU, $(grep -o '"backend": *"[^"]*"' "$out/coseg.json")"
  failed=1
fi
if python3 -c 'import gsplat, torch; assert torch.cuda.is_available()' 2>/dev/null; then
  step pictures "$COSEG" render --backend wgpu --scene "$out/subject/gaussians_10000.ply" \
    --cameras "$out/subject/cameras_480x360.json" --out "$out/pictures" --format npy
  step gsplat python3 scripts/bench_gsplat.py "$out/subject" --pictures "$out/pictures" --against "$out/coseg.json" \
    --json "$out/gsplat.json"
else
  echo "gsplat: left out, Python has no gsplat or no CUDA"
fi
exit $failed
