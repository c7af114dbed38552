#!/usr/bin/env python3
"""The table of docs/measured-gaussians.md on hard cases, from the rows that the tests print:

    cargo test --release --features wgpu,flex --test suite raster::precision -- --nocapture --test-threads=1 | scripts/hard_cases_table.py

A case may have several scenes, and the CPU has two backends: each figure is the largest of all.
"""

import sys

ERRORS = ["picture", "transmittance", "means", "log-scales", "rotations", "opacities", "colours", "screen"]


def rows(lines):
    """Case, backend, pixels in doubt, ten errors, and two bounds, of each line that has them."""
    for line in lines:
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        if len(cells) == 15:
            yield cells[0], cells[1], int(cells[2]), [float(cell) for cell in cells[3:]]


def main():
    table = {}
    for case, backend, doubtful, numbers in rows(sys.stdin):
        *errors, sh, features, screen, absolute, picture, gradient = numbers
        numbers = [doubtful, *errors, max(sh, features), max(screen, absolute), picture, gradient]
        key = case, "GPU" if backend == "wgpu" else "CPU"
        table[key] = [max(pair) for pair in zip(table.get(key, numbers), numbers)]
    print("| case | | in doubt | " + " | ".join(ERRORS) + " | bounds |")
    print("|---" * (len(ERRORS) + 4) + "|")
    for (case, backend), [doubtful, *errors, picture, gradient] in sorted(table.items()):
        cells = " | ".join(f"{error:.0e}".replace("e-0", "e-").replace("0e+00", "0") for error in errors)
        bounds = f"{picture:.1e}, {gradient:.1e}".replace(".0e", "e").replace("e-0", "e-")
        print(f"| {case} | {backend} | {doubtful} | {cells} | {bounds} |")


if __name__ == "__main__":
    main()
