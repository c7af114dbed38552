#!/usr/bin/env python3
"""Prints the boundary IoU of made-up label maps, for tests/suite/metrics/boundary.rs. Python's standard library alone.

    python3 scripts/reference_boundary_iou.py

Each class is a binary mask, which is treated as the authors' code does (Cheng et al. 2021, mask_to_boundary): a border of zeros
around it, eroded as often as 2 % of the diagonal has pixels by a 3x3 square, and the eroded mask taken off the mask.
"""
import math

CLASSES = [1, 2, 3, 4, 5]
VOID = 0
CELL = 9


class Numbers:
    """A linear congruential generator, the same as in the test."""

    def __init__(self, seed):
        self.state = seed

    def below(self, n):
        self.state = (self.state * 1664525 + 1013904223) % 2**32
        return (self.state >> 16) % n


def maps(width, height, seed):
    """A true map of square cells and a prediction: the same moved by two pixels, with noise."""
    numbers = Numbers(seed)
    columns = width // CELL + 2
    cells = [numbers.below(6) for _ in range(columns * (height // CELL + 2))]
    cell = lambda x, y: cells[y // CELL * columns + x // CELL]
    truth = [[cell(x, y) for x in range(width)] for y in range(height)]
    noisy = lambda x, y: numbers.below(7) if numbers.below(40) == 0 else cell(x + 2, y + 1)
    return truth, [[noisy(x, y) for x in range(width)] for y in range(height)]


def eroded(mask):
    """A pixel stays where all of the 3x3 square around it are set; outside there is nothing."""
    height, width = len(mask), len(mask[0])
    inside = lambda x, y: 0 <= x < width and 0 <= y < height and mask[y][x]
    square = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    return [[all(inside(x + dx, y + dy) for dx, dy in square) for x in range(width)] for y in range(height)]


def boundary(mask):
    height, width = len(mask), len(mask[0])
    inner = mask
    for _ in range(max(1, round(0.02 * math.sqrt(width**2 + height**2)))):
        inner = eroded(inner)
    return [[m and not i for m, i in zip(*rows)] for rows in zip(mask, inner)]


def boundary_iou(views, leave_out):
    """Mean over classes, all views together. `leave_out`: labelled pixels without a prediction do not count."""
    found = []
    for label in CLASSES:
        both = either = present = 0
        for truth, prediction in views:
            counts = [
                [t in CLASSES and not (leave_out and p not in CLASSES) for t, p in zip(*rows)]
                for rows in zip(truth, prediction)
            ]
            mask = lambda ids: [[i == label and c for i, c in zip(*rows)] for rows in zip(ids, counts)]
            true, predicted = boundary(mask(truth)), boundary(mask(prediction))
            pairs = [pair for rows in zip(true, predicted) for pair in zip(*rows)]
            both += sum(t and p for t, p in pairs)
            either += sum(t or p for t, p in pairs)
            present += sum(t for t, _ in pairs)
        if present:
            found.append(both / either)
    return sum(found) / len(found)


def main():
    all_views = [maps(45, 37, 1), maps(100, 75, 2), maps(160, 120, 3)]
    for name, chosen in [("each view", [[view] for view in all_views]), ("all views", [all_views])]:
        for views in chosen:
            scores = [boundary_iou(views, leave_out) for leave_out in (False, True)]
            print(f"{name}: void wrong {scores[0]:.12f}, left out {scores[1]:.12f}")


if __name__ == "__main__":
    main()
