"""Segmented 3D Gaussian scenes from posed photos and noisy 2D label maps."""

from ._coseg import Camera, Error, Event, Scene, View, __version__, lift, load, train, vote

__all__ = ["Camera", "Error", "Event", "Scene", "View", "__version__", "lift", "load", "train", "vote"]
