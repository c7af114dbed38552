"""Speed against error of the whole job: `coseg train` with one setting changed at a time.

    python3 scripts/measure_whole_job.py COSEG OUT [OPTION..]      for instance: target/release/coseg measured --backend flex

The options go to each `coseg train`; without `--data` it trains the built-in room. Prints a table: processor seconds of the
whole command, Gaussians, held-out PSNR, and mIoU of the row of labels that is named. A bold score is on the Pareto front: no other
line has as high a score in as little time. OUT/whole_job.svg is the plot, which needs matplotlib. Finished runs are not repeated.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

# Name, options, row of labels.
LINES = [
    ("defaults", [], "ours"),
    ("600 steps of stage one", ["building.iterations=600"], "ours"),
    ("1,200 steps of stage one", ["building.iterations=1200"], "ours"),
    ("100 steps of stage two", ["segmentation.iterations=100"], "ours"),
    ("2,000 steps of stage two", ["segmentation.iterations=2000"], "ours"),
    ("a quarter of the pixels in each step", ["segmentation.pixel_share=0.25"], "ours"),
    ("at most 15,000 Gaussians", ["building.max_gaussians=15000"], "ours"),
    ("Gaussians without limit", ["building.max_gaussians=unlimited"], "ours"),
    ("without image features", [], "no_image_features"),
    ("the vote alone", [], "vote"),
    ("the vote alone, 1,200 steps of stage one", ["building.iterations=1200"], "vote"),
    ("the pooled vote alone", [], "pooled_vote"),
]


def train(coseg, out, options, settings, row):
    """Trains into `out` unless it is there; its measurements."""
    measured = out / "measured.json"
    if not measured.exists():
        command = [coseg, "train", "--out", out / "run", *options, "--set", f'segmentation.rows=["{row}"]']
        for setting in settings:
            command += ["--set", setting]
        started, before = time.monotonic(), os.times()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        after = os.times()
        cpu = after.children_user + after.children_system - before.children_user - before.children_system
        metrics = json.loads((out / "run" / "metrics.json").read_text())
        found = {
            "cpu": cpu,
            "wall": time.monotonic() - started,
            "gaussians": metrics["gaussians"],
            "psnr": metrics["test"]["psnr"],
            "miou": metrics["test"]["labels"][row]["miou"],
        }
        measured.write_text(json.dumps(found))
    return json.loads(measured.read_text())


def front(lines, score):
    """Names of the lines that no other line beats in both time and `score`."""
    beaten = lambda a: any(b["cpu"] <= a["cpu"] and b[score] >= a[score] and b != a for b in lines.values())
    return {name for name, line in lines.items() if not beaten(line)}


def plot(lines, path):
    import matplotlib

    matplotlib.use("svg")
    # Text stays text, and the same figures give the same file.
    matplotlib.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "coseg"})
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(12, 5.5))
    for axis, (score, title) in zip(axes, [("psnr", "PSNR, dB"), ("miou", "mIoU")]):
        best = front(lines, score)
        ordered = sorted((lines[name]["cpu"], lines[name][score]) for name in best)
        axis.step(*zip(*ordered), where="post", color="tab:orange", label="Pareto front")
        for number, (name, line) in enumerate(lines.items(), 1):
            axis.plot(line["cpu"], line[score], "o", color="tab:orange" if name in best else "tab:blue")
            axis.annotate(str(number), (line["cpu"], line[score]), xytext=(4, 4), textcoords="offset points")
        axis.set(xlabel="processor seconds of the whole job", ylabel=title)
        axis.grid(alpha=0.3)
        axis.legend(loc="lower right")
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    coseg, out, options = sys.argv[1], Path(sys.argv[2]), sys.argv[3:]
    lines = {}
    for number, (name, settings, row) in enumerate(LINES, 1):
        folder = out / str(number)
        folder.mkdir(parents=True, exist_ok=True)
        lines[name] = train(coseg, folder, options, settings, row)
        print(name, lines[name], file=sys.stderr, flush=True)
    psnr, miou = front(lines, "psnr"), front(lines, "miou")
    print("| | one change | processor time | Gaussians | PSNR | mIoU |\n|---|---|---|---|---|---|")
    for number, (name, line) in enumerate(lines.items(), 1):
        bold = lambda best, text: f"**{text}**" if name in best else text
        print(f"| {number} | {name} | {line['cpu']:.0f} s | {line['gaussians']:,} |"
              f" {bold(psnr, format(line['psnr'], '.2f') + ' dB')} | {bold(miou, format(line['miou'], '.3f'))} |")
    plot(lines, out / "whole_job.svg")


main()
