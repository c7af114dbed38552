#!/usr/bin/env python3
"""Prints the panoptic quality of made-up segments by panopticapi, for tests/suite/metrics/instance_metrics.rs.

    git clone https://github.com/cocodataset/panopticapi
    PYTHONPATH=panopticapi python3 scripts/reference_panoptic.py      # needs numpy and Pillow

Run with panopticapi at 7bb4655.
"""
import contextlib
import io
import pathlib
import tempfile

import numpy as np
from panopticapi.evaluation import pq_compute_single_core
from PIL import Image

from reference_boundary_iou import Numbers

CELL = 9
SEGMENTS = 12
CLASSES = 3


def maps(width, height, seed):
    """A true map of cells, 0 is none, and a prediction: the same moved by two pixels, where some cells have become one with another."""
    numbers = Numbers(seed)
    columns = width // CELL + 2
    cells = [numbers.below(SEGMENTS + 1) for _ in range(columns * (height // CELL + 2))]
    joined = [numbers.below(SEGMENTS + 1) if numbers.below(4) == 0 else i for i in range(SEGMENTS + 1)]
    cell = lambda x, y: cells[y // CELL * columns + x // CELL]
    noisy = lambda x, y: numbers.below(SEGMENTS + 1) if numbers.below(40) == 0 else joined[cell(x + 2, y + 1)]
    truth = [[cell(x, y) for x in range(width)] for y in range(height)]
    return np.array(truth), np.array([[noisy(x, y) for x in range(width)] for y in range(height)])


def annotation(folder, name, ids):
    """Writes a map as panopticapi reads it, and lists its segments. The class of segment i is i % 3."""
    colours = np.zeros((*ids.shape, 3), dtype=np.uint8)
    colours[..., 0] = ids
    Image.fromarray(colours).save(folder / name)
    segment = lambda i: {"id": int(i), "category_id": int(i) % CLASSES, "iscrowd": 0, "area": int((ids == i).sum())}
    return {"image_id": name, "file_name": name, "segments_info": [segment(i) for i in np.unique(ids) if i > 0]}


def quality(views):
    categories = {i: {"id": i, "isthing": 1} for i in range(CLASSES)}
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        folders = [pathlib.Path(folder, name) for name in ("truth", "prediction")]
        [folder.mkdir() for folder in folders]
        pairs = [[annotation(f, f"{i}.png", ids) for f, ids in zip(folders, view)] for i, view in enumerate(views)]
        statistics = pq_compute_single_core(0, pairs, *map(str, folders), categories)
    mean, _ = statistics.pq_average(categories, isthing=None)
    return ", ".join(f"{mean[name]:.12f}" for name in ("pq", "sq", "rq"))


if __name__ == "__main__":
    views = [maps(45, 37, 1), maps(100, 75, 2), maps(160, 120, 3)]
    for name, chosen in [*((f"view {i}", [view]) for i, view in enumerate(views)), ("all views", views)]:
        print(f"{name}: PQ, SQ, RQ {quality(chosen)}")
