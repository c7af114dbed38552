"""A small scene folder: a wall of four coloured and labelled quarters, seen by six cameras."""

import json
import struct
import zlib
from pathlib import Path

import numpy as np

WIDTH, HEIGHT, FOCAL = 80, 64, 80.0
COLORS = np.array([[30, 30, 30], [220, 40, 40], [40, 200, 60], [50, 70, 230], [210, 200, 60]], np.uint8)
NAMES = ["red", "green", "blue", "yellow"]


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Writes 8-bit grey or RGB."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    height, width = pixels.shape[:2]
    header = struct.pack(">IIBBBBB", width, height, 8, 2 if pixels.ndim == 3 else 0, 0, 0, 0)
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    path.parent.mkdir(parents=True, exist_ok=True)
    content = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + content)


def pose(view: int) -> np.ndarray:
    """Camera-to-world, looking along -z at the wall z = 0 from an arc."""
    angle = -0.3 + 0.12 * view
    backward = np.array([np.sin(angle), 0.0, np.cos(angle)])
    right = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, [0.0, 1.0, 0.0], backward, 3.0 * backward], axis=1)
    return matrix


def labels(view: int) -> np.ndarray:
    """The quarter that each pixel shows; 0 beyond the wall."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    matrix = pose(view)
    rays = np.stack([x / FOCAL, -y / FOCAL, -np.ones_like(x)], axis=-1) @ matrix[:3, :3].T
    points = matrix[:3, 3] - rays * (matrix[2, 3] / rays[..., 2:])
    quarter = 1 + (points[..., 0] > 0) + 2 * (points[..., 1] > 0)
    inside = np.abs(points[..., :2]).max(axis=-1) < 1
    return np.where(inside, quarter, 0).astype(np.uint8)


def write_cloud(path: Path) -> None:
    """Points on the wall, in the colours of the quarters."""
    side = (np.arange(16) + 0.5) / 8 - 1
    lines = ["ply", "format ascii 1.0", f"element vertex {side.size**2}"]
    lines += [f"property float {axis}" for axis in "xyz"] + [f"property uchar {color}" for color in ["red", "green", "blue"]]
    lines.append("end_header")
    for x in side:
        for y in side:
            red, green, blue = COLORS[1 + (x > 0) + 2 * (y > 0)]
            lines.append(f"{x} {y} 0 {red} {green} {blue}")
    path.write_text("\n".join(lines) + "\n")


def write(folder: Path) -> Path:
    """Photos, labels, cameras, classes and a cloud."""
    frames = []
    for view in range(6):
        ids = labels(view)
        write_png(folder / f"images/v{view}.png", COLORS[ids])
        write_png(folder / f"labels/v{view}.png", ids)
        frames.append(
            {
                "file_path": f"images/v{view}.png",
                "label_path": f"labels/v{view}.png",
                "raw_label_path": f"labels/v{view}.png",
                "split": "test" if view == 2 else "train",
                "transform_matrix": pose(view).tolist(),
            }
        )
    write_cloud(folder / "points.ply")
    lens = {"ply_file_path": "points.ply", "fl_x": FOCAL, "fl_y": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2, "w": WIDTH, "h": HEIGHT}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    classes = [
        {"id": i + 1, "name": name, "color": COLORS[i + 1].tolist()} for i, name in enumerate(NAMES)
    ]
    (folder / "classes.json").write_text(json.dumps({"ignore": 0, "classes": classes}))
    return folder
