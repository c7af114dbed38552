"""What `coseg train --corrections` adds to the corrections themselves.

Takes a finished run on labels of a network, and true labels of its photos. Of the three commonest confusions, it corrects
the half of the Gaussians with the lower x, as a person would in the viewer. Then it prints the held-out scores of the run, of the
corrected run without more training, and of the run that was trained again. Needs numpy.

    python3 scripts/measure_corrections.py RUN TRUTH OUT --coseg target/release/coseg

TRUTH is a folder of true label maps in the classes of RUN, one for each photo. OUT is a new folder.
"""

import argparse
import hashlib
import json
import shutil
import subprocess
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np

COLUMN_TYPES = {"float": "<f4", "double": "<f8", "ushort": "<u2"}
CONFUSIONS = 3


def read_ply(path):
    """The rows of a scene.ply, by column."""
    data = path.read_bytes()
    start = data.index(b"end_header\n") + len(b"end_header\n")
    lines = data[:start].decode().splitlines()
    rows = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    columns = [line.split()[1:] for line in lines if line.startswith("property")]
    row = np.dtype([(name, COLUMN_TYPES[kind]) for kind, name in columns])
    return np.frombuffer(data, row, rows, start)


def corrections(scene, truth):
    """Operations of an edits.json: half of the Gaussians of each confusion get their true label."""
    found, true = scene["label"].astype(int), truth["label"].astype(int)
    wrong = (true > 0) & (found != true)
    confusions = Counter(zip(found[wrong], true[wrong])).most_common(CONFUSIONS)
    operations = []
    for (label, right), count in confusions:
        rows = wrong & (found == label) & (true == right)
        lower = rows & (scene["x"] < np.median(scene["x"][rows]))
        operations.append({"op": "assign", "gaussians": np.nonzero(lower)[0].tolist(), "object": int(right)})
        print(f"label {label} is {right}: {count} Gaussians, {lower.sum()} corrected")
    return operations


def write_identities(run, operations):
    """Puts the corrections into the scores of a run, whose checksum is that of the file with a checksum of zeros."""
    path = run / "identities.safetensors"
    data = bytearray(path.read_bytes())
    start = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:start])
    ids = sorted(c["id"] for c in json.loads((run / "classes.json").read_text())["classes"])
    first, end = (start + offset for offset in header["scores"]["data_offsets"])
    scores = np.frombuffer(bytes(data[first:end]), "<f4").reshape(header["scores"]["shape"]).copy()
    for operation in operations:
        scores[operation["gaussians"]] = 0
        scores[operation["gaussians"], ids.index(operation["object"])] = 1
    data[first:end] = scores.tobytes()
    first, end = (start + offset for offset in header["sha256"]["data_offsets"])
    data[first:end] = bytes(32)
    data[first:end] = hashlib.sha256(bytes(data)).digest()
    path.write_bytes(data)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--coseg", default="coseg")
    options = parser.parse_args()
    run, out = options.run, options.out
    if out.exists():
        parser.error(f"{out} exists; OUT is a new folder")

    def coseg(*words):
        return subprocess.run([options.coseg, *map(str, words)], check=True, capture_output=True, text=True).stdout

    def scores(of):
        return next(line for line in coseg("eval", of).splitlines() if line.startswith("labels"))

    data = tomllib.loads((run / "config.toml").read_text())["data"]
    true = out / "true"
    settings = [f"data.transforms={data['transforms']}", f"data.raw_labels={options.truth.resolve()}"]
    sets = [word for setting in settings for word in ("--set", setting)]
    coseg("vote", "--data", data["dir"], "--scene", run, "--out", true, *sets)
    operations = corrections(read_ply(run / "scene.ply"), read_ply(true / "scene.ply"))
    edits = out / "edits.json"
    digest = hashlib.sha256((run / "scene.ply").read_bytes()).hexdigest()
    edits.write_text(json.dumps({"version": 1, "scene": digest, "operations": operations}))
    for name in ["edited", "trained"]:
        shutil.copytree(run, out / name)
    write_identities(out / "edited", operations)
    coseg("train", "--resume", out / "trained", "--corrections", edits)
    print("the run:", scores(run))
    print("corrected:", scores(out / "edited"))
    print("trained again:", scores(out / "trained"))


if __name__ == "__main__":
    main()
