"""What several commands of the runtime ask for in the same way: words, a file with a frame, a clip, how to draw."""

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


def file_and_frame(text: str) -> tuple[Path, int | None]:
    """File and frame of `"FILE@T"`, or of `"FILE"`, which has none."""
    name, _, frame = text.rpartition("@")
    return (Path(name), int(frame)) if name and frame.isdecimal() else (Path(text), None)


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


def check_clip_asked(clip: Path | None, overlay: Path | None, refine: bool, points_from: str | None) -> None:
    """`OverlayError` where a clip is needed and not given, or given and of no use."""
    from decomo_runtime.errors import OverlayError

    needed = overlay is not None or refine
    if needed if clip is None else not (needed or points_from):
        raise OverlayError(
            "--clip goes with --overlay, --refine or --points-from: the frames to draw on, to find points in, or that "
            "keypoints name"
        )


def check_drawing(overlay: Path | None, mark: str, trails: str) -> None:
    """`OverlayError` where options say how to draw an overlay that is not asked for."""
    from decomo_runtime.errors import OverlayError

    if overlay is None and (mark, trails) != (MARKS[0], IMAGE):
        raise OverlayError("--mark and --trails say how an --overlay is drawn; give one, or leave them out")
