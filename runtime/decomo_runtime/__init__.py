"""Answers "where is this point in that frame?" from an exported .onnx file: numpy, onnxruntime and OpenCV, no torch.

    from decomo_runtime import Tracker

    tracks = Tracker("goat.onnx").track([(0, 120.0, 84.5)])  # (t, x, y) in pixels of the clip
    tracks.xy, tracks.occluded, tracks.occlusion             # [N, M, 2], [N, M], [N, M]

Importing this package loads nothing else: each name is fetched when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from decomo_runtime.dense import Dense
    from decomo_runtime.errors import (
        AnnotationError,
        FlowError,
        ModelFileError,
        OverlayError,
        QueryError,
        RefinementError,
        RenderError,
        RuntimeInputError,
        SessionError,
        TracksFileError,
        ViewError,
    )
    from decomo_runtime.flow.folder import write_flow
    from decomo_runtime.formats.about import About
    from decomo_runtime.formats.convert import convert
    from decomo_runtime.layers import render
    from decomo_runtime.model import Appearance
    from decomo_runtime.model_file import ModelFacts
    from decomo_runtime.propagation.carrying import propagate
    from decomo_runtime.propagation.folder import propagate_files
    from decomo_runtime.removal import remove_objects
    from decomo_runtime.tracker import Tracker
    from decomo_runtime.tracks import Tracks

__all__ = [
    "About",
    "AnnotationError",
    "Appearance",
    "Dense",
    "FlowError",
    "ModelFacts",
    "ModelFileError",
    "OverlayError",
    "QueryError",
    "RefinementError",
    "RenderError",
    "RuntimeInputError",
    "SessionError",
    "Tracker",
    "Tracks",
    "TracksFileError",
    "ViewError",
    "convert",
    "propagate",
    "propagate_files",
    "remove_objects",
    "render",
    "write_flow",
]

_HOMES = {
    "About": "formats.about",
    "Appearance": "model",
    "Dense": "dense",
    "ModelFacts": "model_file",
    "Tracker": "tracker",
    "Tracks": "tracks",
    "convert": "formats.convert",
    "propagate": "propagation.carrying",
    "propagate_files": "propagation.folder",
    "remove_objects": "removal",
    "render": "layers",
    "write_flow": "flow.folder",
}


def __getattr__(name: str) -> object:
    if name in __all__:
        return getattr(import_module(f"decomo_runtime.{_HOMES.get(name, 'errors')}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
