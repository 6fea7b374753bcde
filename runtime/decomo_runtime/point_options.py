"""Options that say which points a command is asked for, the same for `decomo-track` and `decomo-measure`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import wraps
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from decomo_runtime.options import file_and_frame

if TYPE_CHECKING:
    import numpy as np

    from decomo_runtime.model_file import ModelFacts
    from decomo_runtime.tracker import Tracker

_PATH = click.Path(path_type=Path)
DYNAMIC, STATIC = KINDS = ("dynamic", "static")
SPACED = ("--mask", "--polygon", "--box")
"""Ways of giving points that `--spacing` says how many of: regions."""


@dataclass(frozen=True)
class Asked:
    """What these options were given."""

    points: Sequence[str]
    queries_file: Path | None
    grid: str | None
    mask: str | None
    polygon: str | None
    box: str | None
    points_from: str | None
    spacing: float | None
    on: str | None

    @property
    def given(self) -> dict[str, Any]:
        """The ways in which points were given: option and value."""
        ways = {
            "--point": self.points or None,
            "--queries": self.queries_file,
            "--grid": self.grid,
            "--mask": self.mask,
            "--polygon": self.polygon,
            "--box": self.box,
            "--points-from": self.points_from,
        }
        return {option: value for option, value in ways.items() if value is not None}

    @property
    def is_region(self) -> bool:
        """Whether they are those within a region of a frame."""
        return bool(self.given.keys() & SPACED)

    @property
    def files(self) -> list[Path]:
        """That will be read."""
        texts = [file_and_frame(text)[0] for text in (self.mask, self.points_from) if text]
        return [*texts, *([] if self.queries_file is None else [self.queries_file])]

    def check(self) -> None:
        """`QueryError` unless points are given in one way, and a spacing to a way that has none."""
        from decomo_runtime.errors import QueryError

        if len(self.given) != 1:
            *others, last = WAYS
            raise QueryError(f"give the points in exactly one way: {', '.join(others)} or {last}")
        if self.spacing is not None and not self.is_region:
            raise QueryError(f"--spacing goes with {', '.join(SPACED[:-1])} or {SPACED[-1]}; a --grid has its own")

    def queries(self, tracker: Tracker, clip_path: Path | None) -> tuple[np.ndarray, tuple[str, ...]]:
        """[N, 3] rows of (t, x, y), checked, and their names where they have some.

        `QueryError` or `TracksFileError` where they are none of the clip.
        """
        from decomo_runtime.queries import check_queries

        if self.points_from is not None:
            queries, names = _keypoints(self.points_from, clip_path, tracker.facts)
        else:
            ((option, value),) = self.given.items()
            queries, names = _wanted_queries(option, value, self.spacing, tracker.facts), ()
        queries = check_queries(queries, tracker.facts)
        if self.on is not None:
            wanted = tracker.on_object(queries) == (self.on == DYNAMIC)
            queries, names = queries[wanted], tuple(compress(names, wanted))
        return queries, names


WAYS = ("--point", "--queries", "--grid", "--mask", "--polygon", "--box", "--points-from")


def point_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Adds these options; the command gets them as `asked`."""

    @wraps(command)
    def with_asked(**values: Any) -> Any:
        asked = Asked(**{each.name: values.pop(each.name) for each in fields(Asked)})
        return command(asked=asked, **values)

    options = (
        click.option(
            "--point", "points", metavar="T,X,Y", multiple=True, help="A point seen in frame T; may be repeated."
        ),
        click.option(
            "--queries", "queries_file", metavar="CSV", type=_PATH, help="Points from a file with the header t,x,y."
        ),
        click.option("--grid", metavar="STEP@T", help="A point every STEP pixels of frame T."),
        click.option("--mask", metavar="PNG@T", help="Points where this image is not black, in frame T."),
        click.option("--polygon", metavar="X,Y,X,Y,...@T", help="Points within a polygon of frame T."),
        click.option("--box", metavar="X,Y,W,H@T", help="Points within a box of frame T; X, Y: first column and row."),
        click.option(
            "--points-from",
            metavar="FILE[@T]",
            help="Keypoints of DeepLabCut (.csv, .h5) or COCO (.json), each where it is surest, or in frame T.",
        ),
        click.option(
            "--spacing",
            metavar="PIXELS",
            type=float,
            show_default="8",
            help="Of points in a --mask, --polygon or --box.",
        ),
        click.option(
            "--on", type=click.Choice(KINDS), help="Of the points, follow those on objects, or on the static scene."
        ),
    )
    for option in reversed(options):
        with_asked = option(with_asked)
    return with_asked


def _wanted_queries(option: str, value: Any, spacing: float | None, model: ModelFacts) -> np.ndarray:
    """[N, 3] rows of (t, x, y), given by the value of one option."""
    from decomo_runtime.queries import grid_queries, parse_grid, parse_points, read_queries
    from decomo_runtime.regions import queries_in

    if option == "--queries":
        return read_queries(value)
    if option == "--grid":
        return grid_queries(*parse_grid(value), model.height, model.width)
    if option == "--point":
        return parse_points(value)
    return queries_in(option, value, spacing, model)


def _keypoints(text: str, clip_path: Path | None, model: ModelFacts) -> tuple[np.ndarray, tuple[str, ...]]:
    """[N, 3] rows of (t, x, y) and their names, from `"FILE"` or `"FILE@T"`."""
    from decomo_runtime.errors import QueryError
    from decomo_runtime.formats.frames import clip_files
    from decomo_runtime.keypoints import read_keypoints

    path, frame = file_and_frame(text)
    files = () if clip_path is None else [file.name for file in clip_files(clip_path)]
    keypoints = read_keypoints(path, files)
    if keypoints.size not in (None, (model.height, model.width)):
        height, width = keypoints.size
        raise QueryError(
            f"{path} is of images of {width}x{height} but the clip is {model.width}x{model.height}; give keypoints "
            "that were drawn on this clip"
        )
    return keypoints.queries(frame)
