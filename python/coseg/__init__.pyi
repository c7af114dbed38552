"""Segmented 3D Gaussian scenes from posed photos and noisy 2D label maps.

Lengths are in world units, images have their first row at the top. Warnings go to the logger ``coseg`` of ``logging``. Work does
not hold the interpreter lock.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal, Optional, Union, final, overload

import numpy as np
from numpy.typing import NDArray

_Path = Union[str, os.PathLike[str]]
_Object = Union[int, str]
_Objects = Union[_Object, Sequence[_Object]]
_Value = Union[str, int, float, bool, _Path, Sequence[Union[str, int, float]]]
_Backend = Literal["wgpu", "flex", "ndarray", "cuda"]

__all__ = ["Camera", "Error", "Event", "Scene", "View", "__version__", "lift", "load", "train", "vote"]

__version__: str

class Error(Exception):
    """What went wrong, in the words of the command line: what was found, what was expected, and how to correct it."""

@final
class Camera:
    """A pinhole camera in world units."""

    def __new__(
        cls,
        pose: Union[NDArray[np.float64], Sequence[Sequence[float]]],
        focal: tuple[float, float],
        size: tuple[int, int],
        principal: Optional[tuple[float, float]] = None,
    ) -> Camera:
        """``pose`` is a 4x4 camera-to-world matrix, x right, y up, looking along -z, as in ``transforms.json``; ``focal`` and
        ``principal`` are pairs x, y in pixels, ``size`` is width and height. The principal point is the middle unless given."""
    @property
    def pose(self) -> list[list[float]]: ...
    @property
    def focal(self) -> tuple[float, float]: ...
    @property
    def principal(self) -> tuple[float, float]: ...
    @property
    def size(self) -> tuple[int, int]: ...
    @property
    def split(self) -> Optional[Literal["train", "test"]]:
        """What the frame of a run is for; None for other cameras."""

@final
class View:
    """A rendered view. Arrays are read-only views of its memory."""

    @property
    def rgb(self) -> NDArray[np.float32]:
        """``[H, W, 3]`` sRGB, background included, not clamped."""
    @property
    def alpha(self) -> NDArray[np.float32]:
        """``[H, W]``, how much of the background is covered."""
    @property
    def labels(self) -> Optional[NDArray[np.uint16]]:
        """``[H, W]`` label ids, 0 where too little is covered; None for a scene without labels."""
    @property
    def depth(self) -> Optional[NDArray[np.float32]]:
        """``[H, W]``, mean depth along the viewing direction, 0 where too little is covered; None unless asked for."""

@final
class Scene:
    """N Gaussians with labels. Arrays are read-only views of its memory, without a copy; they keep it alive.

    Values are as the 3DGS PLY stores them, before activation."""

    @property
    def source(self) -> Path:
        """The file that it was read from, or that the scene was made from."""
    @property
    def origin(self) -> NDArray[np.float64]:
        """``[3]``; ``means + origin`` are world positions."""
    @property
    def means(self) -> NDArray[np.float32]:
        """``[N, 3]``, relative to the origin."""
    @property
    def log_scales(self) -> NDArray[np.float32]:
        """``[N, 3]``, natural logarithms of the standard deviations."""
    @property
    def rotations(self) -> NDArray[np.float32]:
        """``[N, 4]``, quaternions w, x, y, z, not normalised."""
    @property
    def opacity_logits(self) -> NDArray[np.float32]:
        """``[N]``."""
    @property
    def sh(self) -> NDArray[np.float32]:
        """``[N, (degree + 1)**2, 3]``, spherical harmonics in the order and sign of 3DGS."""
    @property
    def labels(self) -> Optional[NDArray[np.uint16]]:
        """``[N]`` label ids; None for a scene without labels."""
    @property
    def identities(self) -> Optional[NDArray[np.float32]]:
        """``[N, C]``, a score for each Gaussian and class, the classes in the order of ``classes``: logits of a trained variant,
        weights of a vote. None where none are beside the file."""
    @property
    def feature_colors(self) -> Optional[NDArray[np.float32]]:
        """``[N, 3]``, the first three principal components of the lifted image features, 0 to 1. A run keeps these; ``lift``
        gives the features themselves. None where none are beside the file."""
    @property
    def features(self) -> Optional[list[NDArray[np.float32]]]:
        """Image features of each scale, ``[N, D]``, of a scene that ``lift`` made; else None. Rows are zero for Gaussians that
        hardly any pixel shows."""
    @property
    def classes(self) -> dict[int, str]:
        """Names of the labels by id."""
    @property
    def unlabelled(self) -> int:
        """The label id of Gaussians that have no class."""
    @property
    def cameras(self) -> dict[str, Camera]:
        """The cameras beside the file, or of the scene folder of a vote, by the names of their frames."""
    def __len__(self) -> int: ...
    def render(
        self,
        camera: Union[str, Camera],
        *,
        size: Optional[tuple[int, int]] = None,
        depth: bool = False,
        background: Optional[tuple[float, float, float]] = None,
        alpha_max: Optional[float] = None,
        backend: Optional[_Backend] = None,
    ) -> View:
        """Renders as ``coseg render`` does from a camera, or from the frame of this name in ``cameras``."""
    def edit(
        self,
        *,
        keep: Optional[_Objects] = None,
        remove: Optional[_Objects] = None,
        turn: Optional[Mapping[_Object, tuple[Union[Literal["x", "y", "z"], Sequence[float]], float]]] = None,
        move: Optional[Mapping[_Object, Sequence[float]]] = None,
        edits: Optional[_Path] = None,
    ) -> Scene:
        """A new scene, edited as by ``coseg edit``: objects, by id or name, that are kept, removed, turned about an axis by
        degrees, and moved; or the edits that the viewer saved, which may be the first labels of a scene. It has neither identities nor feature colours."""
    def save(self, path: _Path, *, force: bool = False) -> Path:
        """Writes a PLY with labels, or scene.ply into a folder, with the class table and cameras beside it; returns its path.
        Writes over nothing that ``edit`` did not write, unless forced."""

@final
class Event:
    """An event of a run."""

    @property
    def kind(self) -> Literal["started", "step", "viewed", "reviewed", "evaluated", "scored", "finished"]: ...
    @property
    def stage(self) -> str: ...
    @property
    def step(self) -> int:
        """Iterations or views done."""
    @property
    def total(self) -> int:
        """Iterations or views of the stage."""
    @property
    def loss(self) -> Optional[float]:
        """Training loss of a step; of evaluations the mean since the last one."""
    @property
    def gaussians(self) -> Optional[int]: ...
    @property
    def psnr(self) -> Optional[float]:
        """dB: of held-out views where kind is ``evaluated``, of held-back training views where it is ``reviewed``."""
    @property
    def ssim(self) -> Optional[float]: ...
    @property
    def miou(self) -> Optional[float]:
        """Mean IoU of held-out labels, 0 to 1."""
    @property
    def variant(self) -> Optional[str]:
        """The row of the label table that was scored."""

def load(path: _Path) -> Scene:
    """Loads a run folder, a model folder of graphdeco's 3DGS, a PLY, ``.spz``, ``.sog`` or ``.splat`` file."""

def vote(
    scene: _Path,
    data: _Path,
    *,
    pooled: bool = False,
    config: Optional[_Path] = None,
    set: Optional[Mapping[str, _Value]] = None,
    backend: Optional[_Backend] = None,
) -> Scene:
    """Labels the Gaussians of ``scene`` by a vote of the raw labels in the scene folder ``data``, as ``coseg vote`` does. Writes
    nothing."""

def lift(
    scene: _Path,
    data: _Path,
    *,
    config: Optional[_Path] = None,
    set: Optional[Mapping[str, _Value]] = None,
    backend: Optional[_Backend] = None,
) -> Scene:
    """The Gaussians of ``scene`` with ``features``: image features of the training photos in the scene folder ``data``, by the settings
    ``features`` and ``unprojection`` (Eq. 5). Those of a run: ``config="RUN/config.toml"``. Writes nothing."""

@overload
def train(
    data: Optional[_Path] = None,
    *,
    scene: Optional[_Path] = None,
    out: Optional[_Path] = None,
    config: Optional[_Path] = None,
    set: Optional[Mapping[str, _Value]] = None,
    seed: Optional[int] = None,
    resume: Optional[_Path] = None,
    backend: Optional[_Backend] = None,
    callback: Optional[Callable[[Event], None]] = None,
) -> Scene:
    """Trains into a run folder as ``coseg train`` does, on the built-in room unless ``data`` or ``config`` names a scene folder.

    The run stops after the step or view, with a checkpoint, where ``callback`` returns False, where it raises, and after Ctrl-C.
    Exceptions pass on; the result of a run that was stopped is None. ``train(resume=out)`` continues."""

@overload
def train(
    data: Optional[_Path] = None,
    *,
    scene: Optional[_Path] = None,
    out: Optional[_Path] = None,
    config: Optional[_Path] = None,
    set: Optional[Mapping[str, _Value]] = None,
    seed: Optional[int] = None,
    resume: Optional[_Path] = None,
    backend: Optional[_Backend] = None,
    callback: Callable[[Event], Optional[bool]],
) -> Optional[Scene]: ...
