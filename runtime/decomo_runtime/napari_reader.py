"""napari opens our tracks, and models, as a layer of tracks: the reader of the manifest `napari.yaml`.

napari finds it by itself where both are installed. Of a model, points all over the clip's middle frame are followed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from decomo_runtime.errors import RuntimeInputError
from decomo_runtime.formats import registry
from decomo_runtime.formats.about import About
from decomo_runtime.formats.napari import layer
from decomo_runtime.queries import grid_queries
from decomo_runtime.tracker import Tracker
from decomo_runtime.tracks import Tracks
from decomotion.windows import FILE_NAME

Layer = tuple[Any, dict[str, Any], str]
POINTS = 500
"""At most, of a model."""


def get_reader(path: str | Sequence[str]) -> Callable[[str | Sequence[str]], list[Layer]] | None:
    """What reads `path`, or several, where they are ours, else None: other readers take such endings too.

    What it reads of a damaged model raises `ModelFileError`.
    """
    paths = [Path(path)] if isinstance(path, str) else [Path(each) for each in path]
    if all(_is_model(each) for each in paths):
        return lambda _: [_layer(each, *_followed(each)) for each in paths]
    try:
        layers = [_layer(each, *registry.read(each)) for each in paths]
    except (RuntimeInputError, OSError):
        return None
    return lambda _: layers


def _is_model(path: Path) -> bool:
    return path.suffix.lower() == ".onnx" or (path / FILE_NAME).is_file()


def _layer(path: Path, tracks: Tracks, about: About) -> Layer:
    vertices, features = layer(tracks, about)
    options = {
        "name": path.stem if about.name == About().name else about.name,
        "features": features,
        "blending": "translucent",
        "metadata": {"names": about.names(len(tracks.xy)), "size": tracks.size or about.size, "fps": about.fps},
    }
    return vertices, options, "tracks"


def _followed(path: Path) -> tuple[Tracks, About]:
    tracker = Tracker(path)
    step = max(1, math.ceil(math.sqrt(tracker.height * tracker.width / POINTS)))
    queries = grid_queries(step, tracker.num_frames // 2, tracker.height, tracker.width)
    return tracker.track(queries), About.of(tracker.facts)
