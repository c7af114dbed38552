"""What `coseg train --view` costs.

Trains stage one of the built-in room in turns, without a page and with one. The client fetches the page, the figures every
second, and each scene and photo as a browser does, and draws nothing. Prints the seconds of each run, and the median ratio of
the two runs of a turn. Close other programs first.

    python3 scripts/measure_watch.py --coseg target/release/coseg --turns 5
"""

import argparse
import json
import statistics
import subprocess
import tempfile
import threading
import urllib.error
import urllib.request
from pathlib import Path

# Whatever proxy the environment names.
DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))


class Client(threading.Thread):
    """Fetches what a browser would, until the run has ended."""

    def __init__(self, address):
        super().__init__(daemon=True)
        self.address = address
        self.scenes = 0
        self.ended = threading.Event()

    def fetch(self, what):
        with DIRECT.open(self.address + what, timeout=60) as answer:
            return answer.read()

    def run(self):
        try:
            self.fetch("")
            shown, photo = 0, False
            while not self.ended.wait(1):
                status = json.loads(self.fetch("status"))
                if status["views"] and not photo:
                    photo = bool(self.fetch("photo/0"))
                if status["copy"] > shown:
                    shown = status["copy"]
                    self.fetch("scene.html")
                    self.scenes += 1
                if status["ended"]:
                    return
        except (urllib.error.URLError, ConnectionError):
            # The process has ended.
            return


def seconds(options, out, watched):
    """Seconds of stage one, and how many scenes a client fetched."""
    command = [options.coseg, "train", "--backend", "flex", "--out", out]
    command += ["--set", f"building.iterations={options.steps}", "--set", "segmentation.rows=[]"]
    command += ["--view"] if watched else []
    program = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    client, said = None, ""
    for line in program.stderr:
        said += line
        if line.startswith("watch: "):
            client = Client(line.split()[1])
            client.start()
    if program.wait() != 0:
        raise SystemExit(said)
    if client:
        client.ended.set()
        client.join()
    metrics = json.loads((out / "metrics.json").read_text())
    return metrics["seconds"]["building"], client.scenes if client else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--coseg", default="coseg")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(1, options.turns + 1):
            without, _ = seconds(options, Path(folder) / f"{turn}a", False)
            watched, scenes = seconds(options, Path(folder) / f"{turn}b", True)
            ratios.append(watched / without)
            print(f"turn {turn}: {without:.2f} s without, {watched:.2f} s with ({scenes} scenes), ratio {ratios[-1]:.3f}", flush=True)
    print(f"median ratio {statistics.median(ratios):.3f}")


if __name__ == "__main__":
    main()
