#!/usr/bin/env python3
"""Makes tests/fixtures/gsplat.safetensors: what gsplat 1.5.3 renders, and its gradients, by its PyTorch functions in f64.

    pip install --no-deps gsplat==1.5.3 safetensors         beside any PyTorch; no GPU needed
    python3 scripts/reference_gsplat.py tests/fixtures/gsplat.safetensors

Projection, spherical harmonics and their gradients are gsplat's PyTorch twins of its CUDA kernels, differentiated
by autograd. Its compositing has a PyTorch twin only on top of CUDA, so that step is written here after the rule of the
kernel: alpha capped at 0.999, skipped below 1/255, and a pixel ends before what would leave 1e-4 or less of it.
"""
import argparse
import importlib.util
import sys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from safetensors.numpy import save_file

WIDTH, HEIGHT = 45, 31
CAP, SKIP, STOP = 0.999, 1.0 / 255.0, 1e-4


def gsplat_functions():
    """The module of PyTorch functions alone: the package itself looks for CUDA when it is imported."""
    package = importlib.util.find_spec("gsplat")
    if package is None:
        sys.exit("no gsplat: pip install --no-deps gsplat==1.5.3")
    path = Path(package.submodule_search_locations[0]) / "cuda" / "_torch_impl.py"
    spec = importlib.util.spec_from_file_location("gsplat_functions", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def subject(rng):
    """Gaussians of every kind before a turned camera, numbers that f32 holds exactly."""
    n = 110
    depth = rng.uniform(0.6, 7.0, n)
    # Some lie beyond the rim, where the Jacobian is clamped; a few lie behind the camera.
    across = rng.uniform(-1.5, 1.5, (n, 2)) * np.array([0.55, 0.4]) * depth[:, None]
    across[30:40] *= 0.2
    points = np.concatenate([across, depth[:, None]], 1)
    points[:6, 2] *= -1.0
    turn = rotation(np.array([0.93, 0.18, -0.27, 0.11]))
    centre = np.array([0.4, -0.3, 0.7])
    scales = rng.uniform(np.log(0.02), np.log(0.5), (n, 3))
    scales[6:16, 0] = np.log(1e-4)  # flat
    scales[16:22, 1:] = np.log(3e-3)  # needles
    logits = rng.uniform(-4.0, 3.0, n)
    logits[22:40] = 9.0  # past the cap
    scales[30:40] += 1.0  # wide and one behind the other, so that pixels end early
    values = {
        "means": points @ turn + centre,
        "log_scales": scales,
        "rotations": rng.normal(size=(n, 4)) * rng.uniform(0.2, 5.0, (n, 1)),
        "opacity_logits": logits,
        "sh": rng.normal(size=(n, 16, 3)) * 0.4,
    }
    values = {name: value.astype(np.float32).astype(np.float64) for name, value in values.items()}
    return values, turn, centre


def rotation(q):
    w, x, y, z = q / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def composite(means2d, conics, opacities, colours, order):
    """Front to back, each Gaussian over all pixels at once: the kernel's rule without its tiles."""
    v, u = torch.meshgrid(torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5, indexing="ij")
    through = torch.ones(HEIGHT, WIDTH, dtype=torch.float64)
    image = torch.zeros(HEIGHT, WIDTH, 3, dtype=torch.float64)
    running = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    for i in order:
        dx, dy = u.double() - means2d[i, 0], v.double() - means2d[i, 1]
        sigma = 0.5 * (conics[i, 0] * dx * dx + conics[i, 2] * dy * dy) + conics[i, 1] * dx * dy
        alpha = torch.clamp_max(opacities[i] * torch.exp(-sigma), CAP)
        takes = running & (sigma >= 0.0) & (alpha >= SKIP)
        ends = takes & (through * (1.0 - alpha) <= STOP)
        running = running & ~ends
        alpha = torch.where(takes & ~ends, alpha, torch.zeros_like(alpha))
        image = image + (alpha * through)[..., None] * colours[i]
        through = through * (1.0 - alpha)
    return image, through, running


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    gsplat = gsplat_functions()
    rng = np.random.default_rng(20)
    values, turn, centre = subject(rng)
    leaves = {name: torch.tensor(value, requires_grad=True) for name, value in values.items()}
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = turn, -turn @ centre
    k = np.array([[38.0, 0, 23.5], [0, 36.5, 14.25], [0, 0, 1]])
    matrix, intrinsics = torch.tensor(view)[None], torch.tensor(k)[None]

    covariances, _ = gsplat._quat_scale_to_covar_preci(
        F.normalize(leaves["rotations"], dim=-1), leaves["log_scales"].exp(), True, False)
    radii, means2d, depths, conics, _ = gsplat._fully_fused_projection(
        leaves["means"], covariances, matrix, intrinsics, WIDTH, HEIGHT)
    directions = leaves["means"] - torch.tensor(centre)
    colours = (gsplat._spherical_harmonics(3, directions, leaves["sh"]) + 0.5).clamp_min(0.0)
    seen = (radii[0] > 0).all(-1)
    order = [i for i in torch.argsort(depths[0], stable=True).tolist() if seen[i]]
    opacities = leaves["opacity_logits"].sigmoid()
    image, through, running = composite(means2d[0], conics[0], opacities, colours, order)

    single = lambda shape: torch.tensor(rng.normal(size=shape).astype(np.float32).astype(np.float64))
    d_image, d_through = single((HEIGHT, WIDTH, 3)), single((HEIGHT, WIDTH))
    ((image * d_image).sum() + (through * d_through).sum()).backward()
    capped = int((opacities.detach()[order] > CAP).sum())
    print(f"{len(order)} of {len(seen)} Gaussians are seen, {capped} of them beyond the cap; "
          f"{int((~running).sum())} of {WIDTH * HEIGHT} pixels end early")
    tensors = dict(values)
    tensors |= {f"d_{name}": leaf.grad.numpy() for name, leaf in leaves.items()}
    tensors |= {"world_to_camera": turn, "center": centre, "intrinsics": np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2]]),
                "image": image.detach().numpy(), "transmittance": through.detach().numpy(),
                "loss_image": d_image.numpy(), "loss_transmittance": d_through.numpy()}
    out.parent.mkdir(parents=True, exist_ok=True)
    # Inputs were rounded to f32 and come back from it exactly.
    given = set(values) | {"loss_image", "loss_transmittance"}
    stored = {name: v.astype(np.float32) if name in given else v for name, v in tensors.items()}
    save_file({name: np.ascontiguousarray(v) for name, v in stored.items()}, out)


if __name__ == "__main__":
    main()
