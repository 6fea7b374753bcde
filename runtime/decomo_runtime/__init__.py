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
    from decomo_runtime.card import Card, WindowCard
    from decomo_runtime.dense import Dense
    from decomo_runtime.edits import Edit, draw_edits, read_edit
    from decomo_runtime.errors import (
        AnnotationError,
        FlowError,
        MeasureError,
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
    from decomo_runtime.measure.following import MeasureSettings
    from decomo_runtime.measure.maps import StrainMap, measure_maps, raster_over
    from decomo_runtime.measure.points import PointMotion, measure_points
    from decomo_runtime.measure.region import RegionMotion, measure_region
    from decomo_runtime.measure.smoothing import Smoothing
    from decomo_runtime.measure.units import Scale
    from decomo_runtime.model import Appearance
    from decomo_runtime.model_file import ModelFacts
    from decomo_runtime.origin import Origin
    from decomo_runtime.propagation.carrying import propagate
    from decomo_runtime.propagation.folder import propagate_files
    from decomo_runtime.removal import remove_objects
    from decomo_runtime.stabilisation import Stabilisation, stabilise
    from decomo_runtime.still_pictures import draw_stabilised
    from decomo_runtime.tracker import Tracker
    from decomo_runtime.tracks import Tracks

__all__ = [
    "About",
    "AnnotationError",
    "Appearance",
    "Card",
    "Dense",
    "Edit",
    "FlowError",
    "MeasureError",
    "MeasureSettings",
    "ModelFacts",
    "ModelFileError",
    "Origin",
    "OverlayError",
    "PointMotion",
    "QueryError",
    "RefinementError",
    "RegionMotion",
    "RenderError",
    "RuntimeInputError",
    "Scale",
    "SessionError",
    "Smoothing",
    "Stabilisation",
    "StrainMap",
    "Tracker",
    "Tracks",
    "TracksFileError",
    "ViewError",
    "WindowCard",
    "convert",
    "draw_edits",
    "draw_stabilised",
    "measure_maps",
    "measure_points",
    "measure_region",
    "propagate",
    "propagate_files",
    "raster_over",
    "read_edit",
    "remove_objects",
    "render",
    "stabilise",
    "write_flow",
]

_HOMES = {
    "About": "formats.about",
    "Appearance": "model",
    "Card": "card",
    "Dense": "dense",
    "Edit": "edits",
    "ModelFacts": "model_file",
    "MeasureSettings": "measure.following",
    "Origin": "origin",
    "PointMotion": "measure.points",
    "RegionMotion": "measure.region",
    "Scale": "measure.units",
    "Smoothing": "measure.smoothing",
    "Stabilisation": "stabilisation",
    "StrainMap": "measure.maps",
    "Tracker": "tracker",
    "Tracks": "tracks",
    "WindowCard": "card",
    "convert": "formats.convert",
    "draw_edits": "edits",
    "draw_stabilised": "still_pictures",
    "measure_maps": "measure.maps",
    "measure_points": "measure.points",
    "measure_region": "measure.region",
    "propagate": "propagation.carrying",
    "propagate_files": "propagation.folder",
    "raster_over": "measure.maps",
    "read_edit": "edits",
    "remove_objects": "removal",
    "render": "layers",
    "stabilise": "stabilisation",
    "write_flow": "flow.folder",
}


def __getattr__(name: str) -> object:
    if name in __all__:
        return getattr(import_module(f"decomo_runtime.{_HOMES.get(name, 'errors')}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
