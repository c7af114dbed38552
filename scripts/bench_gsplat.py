#!/usr/bin/env python3
"""gsplat on what the benchmark `raster` renders: the same Gaussians, cameras and cases, for a comparison in one sitting.

    cargo bench --features wgpu --bench raster -- RUN --backend wgpu --gaussians 100000 --export subject --json coseg.json
    coseg render --backend wgpu --scene subject/gaussians_100000.ply --cameras subject/cameras_480x360.json --out pictures --format npy
    python3 scripts/bench_gsplat.py subject --against coseg.json --pictures pictures [--json gsplat.json]

Needs an NVIDIA GPU, PyTorch with CUDA, numpy and gsplat 1.5.3 (its CUDA sources are compiled at the first use, some minutes
with nvcc). Prints milliseconds a view, medians of passes over all views; a pass ends with one value copied to the host, as
coseg's does. With --pictures it first says how far gsplat's colours are from coseg's. With --against also coseg's figure of the same case and how many times faster coseg is.

RGB and 64 channels go through gsplat's `rasterization`, 64 channels in one pass and in its default chunks of 32: the faster
counts. RGB + 20 classes goes through the functions that `rasterization` is made of, so that SH of Gaussians that are seen
become colours that are blended together with the classes, padded by gsplat to 32 channels: one pass over the pairs.
"""
import argparse
import json
import re
import statistics
import sys
import time
from pathlib import Path

import gsplat
import numpy as np
import torch
from gsplat import (
    fully_fused_projection, isect_offset_encode, isect_tiles, rasterization, rasterize_to_pixels, spherical_harmonics,
)

TYPES = {"float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "uchar": "u1", "uint8": "u1",
         "ushort": "<u2", "uint16": "<u2", "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4"}
# Name, whether colour comes from SH, channels besides: the cases of benches/raster.rs.
CASES = [("RGB", True, 0), ("RGB + 20 classes", True, 20), ("64 channels", False, 64)]


def read_gaussians(path):
    """Columns of a binary little-endian 3DGS PLY as tensors on the GPU."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    header = data[:end].decode("ascii").splitlines()
    if "format binary_little_endian 1.0" not in header:
        sys.exit(f"{path}: not a binary little-endian PLY")
    count = next(int(line.split()[2]) for line in header if line.startswith("element vertex"))
    columns = [line.split()[1:] for line in header if line.startswith("property")]
    rows = np.frombuffer(data, np.dtype([(name, TYPES[kind]) for kind, name in columns]), count, end)

    def tensor(names):
        values = np.stack([rows[name] for name in names], -1).astype(np.float32)
        return torch.from_numpy(np.ascontiguousarray(values)).cuda()

    rest = sorted((n for _, n in columns if n.startswith("f_rest_")), key=lambda n: int(n[7:]))
    dc = tensor(["f_dc_0", "f_dc_1", "f_dc_2"])[:, None, :]
    # Stored channel by channel: all of red, all of green, all of blue.
    higher = tensor(rest).reshape(count, 3, -1).transpose(1, 2) if rest else dc[:, :0]
    return {
        "means": tensor("xyz"),
        "quats": tensor([f"rot_{i}" for i in range(4)]),
        "scales": tensor([f"scale_{i}" for i in range(3)]).exp(),
        "opacities": tensor(["opacity"])[:, 0].sigmoid(),
        "sh": torch.cat([dc, higher], 1).contiguous(),
    }


def read_cameras(path):
    """World-to-camera matrices (OpenCV axes), intrinsics and the size of the pictures."""
    file = json.loads(path.read_text())
    views = []
    for frame in file["frames"]:
        get = lambda key: frame.get(key, file.get(key))
        pose = np.array(frame["transform_matrix"], np.float64) @ np.diag([1.0, -1.0, -1.0, 1.0])
        k = np.array([[get("fl_x"), 0, get("cx")], [0, get("fl_y"), get("cy")], [0, 0, 1]], np.float32)
        view = torch.from_numpy(np.linalg.inv(pose).astype(np.float32)).cuda()[None]
        center = torch.from_numpy(pose[:3, 3].astype(np.float32)).cuda()
        views.append((view, torch.from_numpy(k).cuda()[None], center, int(get("w")), int(get("h"))))
    return views


def compare(subject, pictures):
    """Both programs' colours of the smallest exported case, which `coseg render` drew into `pictures`: whether they agree."""
    ply, cameras = smallest(subject)
    agree = True
    g, views = read_gaussians(ply), read_cameras(cameras)
    frames = json.loads(cameras.read_text())["frames"]
    for frame, view in zip(frames, views):
        stem = Path(frame["file_path"]).stem
        path = pictures / f"{stem}.rgb.npy"
        if not path.is_file():
            print(f"{path}: no such file, so nothing is compared; write it with coseg render --format npy")
            return False
        ours = np.load(path).astype(np.float64)
        with torch.no_grad():
            theirs = render(g, view, True, None, 32, False).cpu().double().numpy()
        off = np.abs(ours - theirs)
        psnr = -10 * np.log10(max((off ** 2).mean(), 1e-30))
        agree &= bool(psnr > AGREE)
        print(f"{stem}: gsplat's colours are coseg's to {psnr:.1f} dB, {off.max():.2e} at most, "
              f"{(off > 1e-3).mean() * 100:.4f} % of the values off by more than 1e-3")
    return agree


def plys(subject):
    """Exported Gaussians, few first."""
    return sorted(subject.glob("gaussians_*.ply"), key=lambda p: int(re.sub(r"\D", "", p.stem)))


def camera_files(subject):
    """Exported cameras, small pictures first."""
    return sorted(subject.glob("cameras_*.json"), key=lambda p: int(p.stem[8:].split("x")[0]))


def smallest(subject):
    """Gaussians and cameras of the smallest case."""
    found = plys(subject)[:1] + camera_files(subject)[:1]
    if len(found) < 2:
        sys.exit(f"{subject}: no gaussians_N.ply beside cameras_WxH.json; write them with `cargo bench --bench raster -- RUN --export`")
    return found


TILE = 16
WARM_UP = 1  # seconds: a GPU that was idle needs time to reach its clock
AGREE = 60  # dB between the pictures of the two programs; what crosses a cut-off in f32 leaves some 90


def render(g, view, colour, extra, chunk, packed):
    """One view, `[H, W, channels]`."""
    if colour and extra is not None:
        return render_together(g, view, extra)
    matrix, k, _, width, height = view
    values, degree = (g["sh"], int(g["sh"].shape[1] ** 0.5) - 1) if colour else (extra, None)
    image, _, _ = rasterization(g["means"], g["quats"], g["scales"], g["opacities"], values, matrix, k, width, height,
                                sh_degree=degree, packed=packed, channel_chunk=chunk)
    return image[0]


def render_together(g, view, extra):
    """Colour from SH and other channels in one pass, by the steps of `rasterization`."""
    matrix, k, center, width, height = view
    radii, means2d, depths, conics, _ = fully_fused_projection(
        g["means"], None, g["quats"], g["scales"], matrix, k, width, height, opacities=g["opacities"])
    degree = int(g["sh"].shape[1] ** 0.5) - 1
    seen = (radii[0] > 0).all(-1)
    rgb = (spherical_harmonics(degree, g["means"] - center, g["sh"], masks=seen) + 0.5).clamp_min(0.0)
    columns, rows = -(-width // TILE), -(-height // TILE)
    _, ids, flat = isect_tiles(means2d, radii, depths, TILE, columns, rows)
    offsets = isect_offset_encode(ids, 1, columns, rows)
    values = torch.cat([rgb, extra], 1)[None]
    image, _ = rasterize_to_pixels(means2d, conics, values, g["opacities"][None], width, height, TILE, offsets, flat)
    return image[0]


def timed(work, repeats):
    """Milliseconds of the median run, after a second of runs that are not counted."""
    start = time.perf_counter()
    work()
    while time.perf_counter() - start < WARM_UP:
        work()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return 1e3 * statistics.median(seconds)


def measure(g, views, colour, channels, repeats, packed):
    """Milliseconds a view: forward, forward and backward."""
    n = len(g["means"])
    extra = torch.rand(n, channels, device="cuda") if channels else None

    def forward(chunk):
        with torch.no_grad():
            for view in views:
                render(g, view, colour, extra, chunk, packed)[0, 0, 0].item()

    def both(chunk):
        for view in views:
            leaves = {name: value.detach().requires_grad_() for name, value in g.items()}
            values = None if extra is None else extra.detach().requires_grad_()
            render(leaves, view, colour, values, chunk, packed).sum().backward()
            leaves["means"].grad[0, 0].item()

    chunks = [32, 64] if channels > 32 else [32]
    return [min(timed(lambda: work(chunk), repeats) for chunk in chunks) / len(views) for work in (forward, both)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subject", type=Path, help="folder that `--export` of the benchmark wrote")
    parser.add_argument("--against", type=Path, help="figures that `--json` of the benchmark wrote")
    parser.add_argument("--pictures", type=Path, help="folder of what `coseg render` made of the smallest case, as npy")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--packed", action="store_true", help="gsplat's packed mode: less memory, usually slower")
    parser.add_argument("--json", type=Path, help="write the figures to this file too")
    args = parser.parse_args()
    ours, device = {}, torch.cuda.get_device_name()
    if args.against:
        against = json.loads(args.against.read_text())
        print(f"coseg: {against['machine']}")
        for section in against["sections"]:
            ours |= {(section["gaussians"], f["name"]): f["median"] for f in section["figures"]}
    mode = "packed" if args.packed else "not packed"
    print(f"gsplat {gsplat.__version__}, PyTorch {torch.__version__}, {device}, {mode}")
    smallest(args.subject)  # or the message that nothing was exported
    agree = compare(args.subject, args.pictures) if args.pictures else True
    found = []
    for ply in plys(args.subject):
        g = read_gaussians(ply)
        for cameras in camera_files(args.subject):
            views = read_cameras(cameras)
            for name, colour, channels in CASES:
                case = f"{cameras.stem[8:]}, {len(g['means']):,} Gaussians, {name}"
                try:
                    times = measure(g, views, colour, channels, args.repeats, args.packed)
                except torch.cuda.OutOfMemoryError as error:
                    print(f"{case}: left out, {str(error).splitlines()[0]}")
                    continue
                for what, ms in zip(("forward", "forward + backward"), times):
                    coseg = ours.get((len(g["means"]), f"{cameras.stem[8:]}, {name}: {what}"))
                    beside = f"   coseg {coseg:9.3f} ms, x{ms / coseg:.2f}" if coseg else ""
                    print(f"{case:<52} {what:<19} {ms:9.3f} ms{beside}", flush=True)
                    found.append({"case": case, "name": what, "unit": "ms", "median": ms, "coseg": coseg})
    if args.json:
        versions = {"gsplat": gsplat.__version__, "torch": torch.__version__, "device": device, "mode": mode}
        args.json.write_text(json.dumps({**versions, "figures": found}, indent=1) + "\n")
    if not agree:
        sys.exit(f"the pictures of the two programs are not known to agree to {AGREE} dB: the times are not of the same work")


if __name__ == "__main__":
    main()
