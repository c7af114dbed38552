#!/usr/bin/env python3
"""Makes a scene folder whose raw labels are segments of single views, to measure `coseg associate` on.

    scripts/spoil_segments.py ROOM OUT KIND

ROOM has images/, instances_gt/ and transforms.json, as the rooms of the shared test data. OUT gets links to its photos and points, the
segments, and a transforms.json that names the true instances. Ids are drawn anew in each view. KIND:

- true: connected parts of the true instances;
- spoilt: the true instances; in each view a quarter are merged with a neighbour, and a quarter are cut in two;
- classes: connected parts of the simulated class labels in labels_raw_corr, where neighbours of one class are one segment.

Segments of fewer than 60 pixels are unlabelled. Needs numpy, scipy and Pillow.
"""

import json
import os
import sys

import numpy as np
from PIL import Image
from scipy import ndimage

MIN_PIXELS = 60
SEED = {"true": 0, "classes": 0, "spoilt": 1}


def parts(ids):
    """The connected parts of each id above 0, numbered from 1."""
    segments = np.zeros(ids.shape, int)
    for value in np.unique(ids[ids > 0]):
        labelled, count = ndimage.label(ids == value)
        for part in range(1, count + 1):
            mask = labelled == part
            if mask.sum() >= MIN_PIXELS:
                segments[mask] = segments.max() + 1
    return segments


def spoilt(ids, rng):
    """`ids`, some joined with a neighbour and some cut in two."""
    kept = [value for value in np.unique(ids) if value and (ids == value).sum() >= MIN_PIXELS]
    segments = np.where(np.isin(ids, kept), ids, 0)
    for value in kept:
        fate = rng.random()
        mask = segments == value
        if not mask.any():
            continue
        if fate < 0.25:
            ring = ndimage.binary_dilation(mask, iterations=2) & ~mask
            near = np.unique(segments[ring & (segments > 0)])
            if near.size:
                segments[mask] = rng.choice(near)
        elif fate < 0.5:
            rows, columns = np.nonzero(mask)
            angle = rng.random() * np.pi
            side = (columns - columns.mean()) * np.cos(angle) + (rows - rows.mean()) * np.sin(angle) > 0
            segments[rows[side], columns[side]] = segments.max() + 1
    return segments


def renumbered(segments, rng):
    """`segments` with ids from 1 in random order."""
    ids = np.unique(segments[segments > 0])
    table = np.zeros(segments.max() + 1, np.uint16)
    table[ids] = rng.permutation(len(ids)) + 1
    return table[segments]


def main():
    room, out, kind = sys.argv[1:]
    rng = np.random.default_rng(SEED[kind])
    os.makedirs(f"{out}/segments")
    for name in ["images", "instances_gt", "points.ply"]:
        os.symlink(os.path.abspath(f"{room}/{name}"), f"{out}/{name}")
    with open(f"{room}/transforms.json") as file:
        scene = json.load(file)
    folder = "labels_raw_corr" if kind == "classes" else "instances_gt"
    for frame in scene["frames"]:
        name = os.path.splitext(os.path.basename(frame["file_path"]))[0] + ".png"
        ids = np.array(Image.open(f"{room}/{folder}/{name}")).astype(int)
        segments = spoilt(ids, rng) if kind == "spoilt" else parts(ids)
        Image.fromarray(renumbered(segments, rng)).save(f"{out}/segments/{name}")
        for key in ["label_path", "raw_label_path", "depth_path"]:
            frame.pop(key, None)
        frame["instance_path"] = f"instances_gt/{name}"
        frame["raw_label_path"] = f"segments/{name}"
    with open(f"{out}/transforms.json", "w") as file:
        json.dump(scene, file)


if __name__ == "__main__":
    main()
