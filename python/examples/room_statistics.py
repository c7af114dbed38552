"""Trains the built-in room, or loads the run that is named, and prints what a held-out view shows of each class."""

import sys

import coseg


def report(event: coseg.Event) -> None:
    if event.kind == "evaluated" and event.psnr is not None:
        print(f"{event.stage} {event.step}/{event.total}: PSNR {event.psnr:.2f} dB, {event.gaussians} Gaussians")


run = coseg.load(sys.argv[1]) if len(sys.argv) > 1 else coseg.train(callback=report)
name = next(name for name, camera in run.cameras.items() if camera.split == "test")
view = run.render(name)
assert run.labels is not None and view.labels is not None, "the scene has no labels"
print(f"{run.source}: {len(run)} Gaussians, frame {name}")
for id, title in run.classes.items():
    gaussians, pixels = run.labels == id, view.labels == id
    if pixels.any():
        red, green, blue = view.rgb[pixels].mean(axis=0)
        share = 100 * pixels.mean()
        print(f"{title:>12}: {gaussians.sum()} Gaussians, {share:.1f} % of the pixels, colour {red:.2f} {green:.2f} {blue:.2f}")
