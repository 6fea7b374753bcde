"""Options that `decomo-track` and `decomo-render` share: how tracks are drawn."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

MARKS = ("ring", "cross", "none")
"""What an occluded point is drawn as."""
IMAGE, CAMERA = TRAILS = ("image", "camera")
"""What a trail is drawn relative to: the image, or the static scene, the camera's motion taken out."""
SEEN, STATIC, DYNAMIC = OWNERS = ("seen", "static", "dynamic")
"""What an edit belongs to: whatever is seen in the painted frame, or the static scene or the objects alone."""
TRANSLATION, SIMILARITY, HOMOGRAPHY, DENSE = TRANSFORMS = ("translation", "similarity", "homography", "dense")
"""By what a frame is brought to where it holds still."""
NONE, CROP, FILL = BORDERS = ("none", "crop", "fill")
"""What becomes of the parts of a still picture that a frame does not show: they stay empty, are cut off, or are filled
from other frames.
"""

Function = TypeVar("Function", bound=Callable[..., Any])


def drawing_options(command: Function) -> Function:
    """Adds `mark` and `trails`, which say how an overlay is drawn."""
    for option in (
        click.option(
            "--trails",
            type=click.Choice(TRAILS),
            default=IMAGE,
            help="Of an overlay: relative to the image, or to the static scene, the camera's motion taken out.",
        ),
        click.option("--mark", type=click.Choice(MARKS), default=MARKS[0], help="Of occluded points in an overlay."),
    ):
        command = option(command)
    return command


def check_drawing(overlay: Path | None, mark: str, trails: str) -> None:
    """`OverlayError` where options say how to draw an overlay that is not asked for."""
    from decomo_runtime.errors import OverlayError

    if overlay is None and (mark, trails) != (MARKS[0], IMAGE):
        raise OverlayError("--mark and --trails say how an --overlay is drawn; give one, or leave them out")
