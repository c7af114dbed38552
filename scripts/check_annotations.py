#!/usr/bin/env python3
"""Checks the annotations of `coseg render` by pycocotools, and by YOLO's own convention.

    pip install numpy pillow pycocotools pyyaml
    coseg render --scene RUN --out FOLDER --labels --annotations coco,yolo,index
    scripts/check_annotations.py FOLDER

Each annotation of instances.json must have exactly the pixels of its label in STEM.label.png, 0 being unlabelled. The outlines
for YOLO, filled by the even-odd rule at pixel centres, must cover exactly the pixels of their class. Exits with 1 where not.
"""

import contextlib
import pathlib
import sys
from collections import Counter

import numpy as np
import yaml
from PIL import Image
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO

problems, counts = [], Counter()


def expect(right, problem: str) -> bool:
    if not right:
        problems.append(problem)
    return bool(right)


def expect_each(stems, maps: dict, where: str) -> None:
    found, expected = Counter(stems), Counter(maps.keys())
    wrong = (found - expected) + (expected - found)
    expect(not wrong, f"{where}: not one image for each STEM.label.png: {sorted(wrong)}")


def stem_of(name: str, maps: dict) -> str:
    """The frame of a photo: the name of a frame has all folders of its photo, joined by `_`."""
    stem = name.rsplit(".", 1)[0].replace("/", "_")
    return stem if stem in maps else next((frame for frame in maps if frame.endswith("_" + stem)), stem)


def read_maps(folder: pathlib.Path) -> dict:
    maps = {path.name[:-10]: np.array(Image.open(path)).astype(int) for path in sorted(folder.glob("*.label.png"))}
    expect(maps, f"{folder}: no STEM.label.png")
    for path in folder.glob("*.index.png"):
        expect(np.array_equal(np.array(Image.open(path)), maps.get(path.name[:-10])), f"{path.name}: not the ids of the map")
    return maps


def check_coco(path: pathlib.Path, maps: dict) -> tuple:
    """Names by category ids, and category ids by labels."""
    with contextlib.redirect_stdout(None):
        coco = COCO(str(path))
    for part, entries in coco.dataset.items():
        twice = [i for i, count in Counter(entry["id"] for entry in entries).items() if count > 1]
        expect(not twice, f"{part}: ids that are there twice: {twice}")
    stems = {image["id"]: stem_of(image["file_name"], maps) for image in coco.dataset["images"]}
    expect_each(stems.values(), maps, "instances.json")
    covers, categories = {stem: np.zeros(ids.shape, int) for stem, ids in maps.items()}, {}
    for entry in coco.dataset["annotations"]:
        category = entry["category_id"]
        if expect(category in coco.cats, f"annotation {entry['id']}: no category {category}"):
            known = categories.setdefault(entry["label"], category)
            expect(known == category, f"annotation {entry['id']}: category {category}; that of its label is {known}")
        check_annotation(coco, entry, stems, maps, covers)
    for stem, cover in covers.items():
        wrong = np.sum(cover != (maps[stem] != 0))
        expect(not wrong, f"{stem}: {wrong} pixels are not in exactly one annotation, or unlabelled and in one")
    counts["images"] += len(stems)
    return {i: category["name"] for i, category in coco.cats.items()}, categories


def check_annotation(coco: COCO, entry: dict, stems: dict, maps: dict, covers: dict) -> None:
    name, stem = f"annotation {entry['id']}", stems.get(entry["image_id"])
    if not expect(stem in maps, f"{name}: no image {entry['image_id']} with a map"):
        return
    size, runs = entry["segmentation"]["size"], entry["segmentation"]["counts"]
    same = list(maps[stem].shape) == size == [coco.imgs[entry["image_id"]][side] for side in ("height", "width")]
    # pycocotools does not look whether runs fill the image.
    if not expect(same and sum(runs) == maps[stem].size and min(runs) >= 0, f"{name}: runs that do not fill {stem}"):
        return
    pixels, packed = coco.annToMask(entry) == 1, coco.annToRLE(entry)
    wrong = np.sum(pixels != (maps[stem] == entry["label"]))
    expect(not wrong, f"{name}: {wrong} pixels of {stem} differ from those of label {entry['label']}")
    for key, true in (("area", int(coco_mask.area(packed))), ("bbox", coco_mask.toBbox(packed).tolist())):
        expect(entry[key] == true, f"{name}: {key} {entry[key]}; its runs have {true}")
    covers[stem] += pixels
    counts["annotations"] += 1


def check_yolo(folder: pathlib.Path, maps: dict, names: dict, categories: dict) -> None:
    data = yaml.safe_load((folder / "data.yaml").read_text())
    order = sorted(names)
    expected = {number: names[category] for number, category in enumerate(order)}
    expect(data["names"] == expected, f"data.yaml: names {data['names']}; expected {expected}, as in instances.json")
    expect(data.get("nc", len(order)) == len(order), f"data.yaml: nc {data.get('nc')}, but {len(order)} names")
    numbers = {label: order.index(category) for label, category in categories.items()}
    # A set: the list of one split stands for both where only that one was rendered.
    listed = [line for file in {data["train"], data["val"]} for line in (folder / file).read_text().splitlines()]
    expect_each((pathlib.Path(line).stem for line in listed), maps, "data.yaml")
    for image in (folder / line for line in listed):
        labels = folder / "labels" / f"{image.stem}.txt"
        is_there = image.parent == folder / "images" and image.is_file() and labels.is_file()
        if expect(is_there and image.stem in maps, f"images/{image.name}: no such image, or no labels or map of it"):
            check_outlines(labels, maps[image.stem], numbers, len(order))


def check_outlines(labels: pathlib.Path, ids: np.ndarray, numbers: dict, classes: int) -> None:
    drawn, found, true = (np.full(ids.shape, value) for value in (0, -1, -1))
    for n, line in enumerate(labels.read_text().splitlines(), 1):
        kind, values = int(line.split()[0]), np.array(line.split()[1:], float)
        expect(0 <= kind < classes, f"{labels.name}:{n}: class {kind} of {classes}")
        is_form = len(values) >= 6 and len(values) % 2 == 0 and np.all((values >= 0) & (values <= 1))
        if expect(is_form, f"{labels.name}:{n}: {len(values)} coordinates; expected 6 or more, an even number, each 0 to 1"):
            inside = filled(values.reshape(-1, 2) * ids.shape[::-1], ids.shape)
            drawn += inside
            found[inside] = kind
            counts["outlines"] += 1
    for label, number in numbers.items():
        true[ids == label] = number
    wrong = np.sum((found != true) | (drawn > 1))
    expect(not wrong, f"{labels.name}: {wrong} pixels are not of their class, or in several outlines")
    counts["pixels"] += np.sum(found >= 0)


def filled(corners: np.ndarray, shape: tuple) -> np.ndarray:
    """Pixels whose centres are inside the closed outline by the even-odd rule."""
    crossings = np.zeros((shape[0], shape[1] + 1), int)
    # Upper ends first: both sides of a cut then cross a row at the same place.
    for (y, x), (end_y, end_x) in map(sorted, zip(corners[:, ::-1].tolist(), np.roll(corners, -1, axis=0)[:, ::-1].tolist())):
        rows = np.arange(np.ceil(y - 0.5), np.ceil(end_y - 0.5), dtype=int)
        columns = x + (rows + 0.5 - y) * (end_x - x) / ((end_y - y) or 1.0)
        crossings[rows, np.ceil(columns - 0.5).astype(int)] += 1
    return np.cumsum(crossings, axis=1)[:, :-1] % 2 == 1


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    where = pathlib.Path(sys.argv[1])
    try:
        label_maps = read_maps(where)
        check_yolo(where, label_maps, *check_coco(where / "instances.json", label_maps))
    except (OSError, KeyError, TypeError, ValueError, IndexError, yaml.YAMLError) as error:
        problems.append(f"{where}: cannot be read further: {error!r}")
    print("\n".join(problems) or f"{where}: {', '.join(f'{n} {what}' for what, n in counts.items())}; nothing is wrong")
    sys.exit(bool(problems))
