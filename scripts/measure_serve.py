"""How soon `coseg view --serve` shows a large scene in headless Chromium, and how much memory that takes.

Makes a scene of Gaussians of SH degree 0, serves it, opens the page and waits for it. Prints the seconds from the start of `coseg`
to the address, and from there to the first picture, to that of all Gaussians, and until the wand works; the memory of the server
and of the browser. Chromium draws on the CPU here, in a small window. Linux, no packages.

    python3 scripts/measure_serve.py --coseg target/release/coseg [--gaussians 1000000]
"""

import argparse
import json
import os
import random
import re
import struct
import subprocess
import tempfile
import time
from pathlib import Path

COLUMNS = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
SIZE = "640,360"
PICTURE = "(() => { const start = performance.now(); page.draw(); page.canvas.toDataURL(); return performance.now() - start; })()"


def write_scene(path, count):
    """Flat Gaussians on a hundred balls, each of one colour with some noise."""
    draw = random.Random(0).gauss
    balls = [([3 * draw(0, 1) for _ in range(3)], [draw(0, 1) for _ in range(3)]) for _ in range(100)]
    rows = bytearray()
    for i in range(count):
        middle, color = balls[i % len(balls)]
        x, y, z = normal = unit([draw(0, 1) for _ in range(3)])
        position = [m + n for m, n in zip(middle, normal)]
        color = [c + draw(0, 0.1) for c in color]
        turn = unit([1 + z, -y, x, 0]) if z > -0.999 else [0, 1, 0, 0]  # z to the normal
        rows += struct.pack("<14f", *position, *color, 2.0, -4.5, -4.5, -7.0, *turn)
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property float {name}" for name in COLUMNS] + ["end_header", ""]
    path.write_bytes("\n".join(lines).encode() + rows)


def unit(v):
    length = sum(x * x for x in v) ** 0.5
    return [x / length for x in v]


class Browser:
    """Chromium with one page, over pipes of its DevTools protocol."""

    def __init__(self, chromium, profile):
        (into, self.commands), (self.answers, out) = os.pipe(), os.pipe()

        def pipes():
            os.dup2(into, 30), os.dup2(out, 31)
            os.dup2(30, 3), os.dup2(31, 4)

        flags = ["--headless", "--no-sandbox", "--enable-unsafe-swiftshader", "--remote-debugging-pipe", f"--window-size={SIZE}"]
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        command = [chromium, *flags, f"--user-data-dir={profile}"]
        self.process = subprocess.Popen(command, preexec_fn=pipes, close_fds=False, start_new_session=True, **silent)
        self.sent, self.buffer, self.session = 0, b"", None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def call(self, method, **params):
        self.sent += 1
        message = {"id": self.sent, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.commands, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self.buffer:
                self.buffer += os.read(self.answers, 1 << 20)
            text, self.buffer = self.buffer.split(b"\0", 1)
            answer = json.loads(text)
            if answer.get("id") == self.sent:
                return answer["result"]

    def value(self, expression):
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def until(self, expression, seconds=float("inf")):
        """Whether the expression becomes true within this time."""
        start = time.monotonic()
        while not self.value(expression):
            if time.monotonic() - start > seconds:
                return False
            time.sleep(0.05)
        return True

    def memory(self):
        """Bytes of all processes of this browser; what they share counts once."""
        ps = ["ps", "-s", str(self.process.pid), "-o", "pid="]
        processes = subprocess.run(ps, capture_output=True, text=True).stdout.split()
        texts = [Path(f"/proc/{process}/smaps_rollup").read_text() for process in processes]
        return sum(int(re.search(r"Pss:\s+(\d+)", text)[1]) << 10 for text in texts)


def resident(process):
    text = Path(f"/proc/{process}/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+)", text)[1]) << 10


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--coseg", default="coseg")
    parser.add_argument("--chromium", default="chromium")
    parser.add_argument("--gaussians", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=300, help="the longest time that all may take")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        scene = Path(folder) / "scene.ply"
        write_scene(scene, options.gaussians)
        browser = Browser(options.chromium, f"{folder}/profile")
        clock = time.monotonic()
        command = [options.coseg, "view", "--scene", scene, "--serve"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            address = re.search(r"http://\S+", server.stdout.readline())[0]
            print(f"address after {time.monotonic() - clock:.1f} s")
            clock = time.monotonic()
            browser.call("Page.navigate", url=address)
            browser.until("window.page?.panel && /^[1-9].* of /.test(document.getElementById('lead')?.textContent)")
            # Reading the picture waits until it is drawn.
            drawn = "page.draw(), page.canvas.toDataURL(), document.getElementById('lead').textContent"
            lead = browser.value(drawn)
            print(f"first picture after {time.monotonic() - clock:.1f} s: {lead}")
            for what, sign in [("all drawn", "page.scene.received === page.scene.blocks"), ("wand", "document.body.dataset.ready === 'yes'")]:
                came = browser.until(sign, clock + options.seconds - time.monotonic())
                browser.value(drawn)
                print(f"{what}{'' if came else ' NOT'} after {time.monotonic() - clock:.1f} s")
            print(f"a picture takes {browser.value(PICTURE):.0f} ms")
            print(f"server {resident(server.pid) / 1e6:.0f} MB at most, browser {browser.memory() / 1e6:.0f} MB")
        finally:
            server.kill()
            browser.process.kill()
            browser.process.wait()


if __name__ == "__main__":
    main()
