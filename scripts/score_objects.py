#!/usr/bin/env python3
"""Scores label maps of objects against true instances: RQ and PQ (Kirillov et al. 2019), all views as one image.

    coseg separate --scene RUN --out objects/scene.ply
    coseg render --scene objects/scene.ply --cameras RUN --split test --labels --out pictures
    scripts/score_objects.py SCENE pictures

SCENE has instances_gt/VIEW.png (instance ids, 0 is none) and instances.json ([{"id": 1, "cls": "chair"}, ..]). Walls, floors and
ceilings are left out, and so is what covers no more than 400 pixels in all views together. Needs numpy and Pillow.
"""

import json
import pathlib
import sys
from collections import Counter

import numpy as np
from PIL import Image

STUFF = {"wall", "floor", "ceiling"}
FEWEST_PIXELS = 400


def main(scene: pathlib.Path, pictures: pathlib.Path) -> None:
    classes = {entry["id"]: entry["cls"] for entry in json.loads((scene / "instances.json").read_text())}
    both, true, found = Counter(), Counter(), Counter()
    suffix = ".label.png"
    for path in sorted(pictures.glob("*" + suffix)):
        ids = np.array(Image.open(path)).astype(int).ravel()
        truth = np.array(Image.open(scene / "instances_gt" / f"{path.name[: -len(suffix)]}.png")).astype(int).ravel()
        pairs, counts = np.unique(truth * 65536 + ids, return_counts=True)
        for pair, count in zip(pairs.tolist(), counts.tolist()):
            t, p = divmod(pair, 65536)
            both[t, p] += count
            true[t] += count
            found[p] += count
    stuff = {p for (t, p), count in both.items() if classes.get(t) in STUFF and count > found[p] / 2}
    things = [t for t in true if t and true[t] > FEWEST_PIXELS and classes.get(t) not in STUFF]
    objects = [p for p in found if p and found[p] > FEWEST_PIXELS and p not in stuff]
    iou = {pair: count / (true[pair[0]] + found[pair[1]] - count) for pair, count in both.items()}
    best = [max((iou.get((t, p), 0.0) for p in objects), default=0.0) for t in things]
    matched = [value for value in best if value > 0.5]
    half = (len(things) + len(objects)) / 2
    print(
        f"{len(things)} instances, {len(objects)} objects, {len(matched)} matched, "
        f"RQ {len(matched) / half:.3f}, PQ {sum(matched) / half:.3f}"
    )


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))
