"""A table of scores where only a few photos of a scene are labelled: held-out mIoU and accuracy of the vote, of per-Gaussian
cross-entropy and of `ours`, for random draws of labelled photos.

For each draw, the true label maps of some training photos are linked into a folder that `coseg train` gets as raw labels. Gaussians
are those of RUN, so that only the second stage is trained.

    python3 scripts/measure_few_labels.py --data SCENE --scene RUN --counts 3 6 12 --draws 0 1 2 --out FOLDER
"""

import argparse
import json
import pathlib
import random
import subprocess

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--coseg", default="target/release/coseg", help="the program")
parser.add_argument("--data", required=True, type=pathlib.Path, help="scene folder with a transforms.json and true labels of its frames")
parser.add_argument("--scene", required=True, help="run folder with trained Gaussians")
parser.add_argument("--counts", nargs="+", type=int, default=[3, 6, 12], help="numbers of labelled photos")
parser.add_argument("--draws", nargs="+", type=int, default=[0, 1, 2], help="seeds of the random draws of each number")
parser.add_argument("--out", required=True, type=pathlib.Path, help="new folder for labels and runs")
parser.add_argument("rest", nargs="*", help="further arguments of `coseg train`, after --")
arguments = parser.parse_args()

ROWS = ["vote", "per_gaussian", "ours"]
frames = json.loads((arguments.data / "transforms.json").read_text())["frames"]
labels = sorted(frame["label_path"] for frame in frames if frame["split"] == "train")
out = arguments.out.resolve()
print("| photos | draw | " + " | ".join(ROWS) + " |")
print("|---" * (len(ROWS) + 2) + "|", flush=True)
for count in arguments.counts:
    for draw in arguments.draws:
        folder = out / f"labels_{count}_{draw}"
        folder.mkdir(parents=True)
        for path in random.Random(draw).sample(labels, count):
            (folder / pathlib.Path(path).name).symlink_to((arguments.data / path).resolve())
        run = out / f"run_{count}_{draw}"
        command = [arguments.coseg, "train", "--data", arguments.data, "--scene", arguments.scene, "--out", run]
        sets = [f"data.raw_labels={folder}", f"segmentation.rows={json.dumps(ROWS)}"]
        command += [part for value in sets for part in ("--set", value)] + arguments.rest
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        test = json.loads((run / "metrics.json").read_text())["test"]["labels"]
        scores = [f"{test[row]['miou']:.3f}, {test[row]['accuracy']:.3f}" for row in ROWS]
        print(f"| {count} | {draw} | " + " | ".join(scores) + " |", flush=True)
