"""Options of `decomo-render` about a clip that is held still."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from decomo_runtime.options import BORDERS, TRANSFORMS, Function

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from decomo_runtime.stabilisation import Stabilisation
    from decomo_runtime.tracker import Tracker
    from decomotion.clip import Clip

    Image = npt.NDArray[np.uint8]

_PATH = click.Path(path_type=Path)


@dataclass(frozen=True)
class StabiliseOptions:
    """What the command was given."""

    stabilise: str | None
    by: str | None
    smooth: float
    border: str
    transforms: tuple[Path, ...]

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> StabiliseOptions:
        """Of all that a command was given."""
        return cls(**{field.name: given[field.name] for field in fields(cls)})

    def check(self, *inputs: Path | None) -> None:
        """`RenderError` where they say nothing together, `OutputError` where a file cannot be written, or is one of the
        `inputs`, `TracksFileError` where it is of no known format.
        """
        from decomo_runtime.errors import RenderError
        from decomo_runtime.stabilisation import Still, format_of_transforms
        from decomotion.outputs import check_not_input, check_output

        if self.stabilise is None:
            if self.by or self.smooth or self.border != BORDERS[0] or self.transforms:
                raise RenderError(
                    "--by, --smooth, --border and --transforms say how the clip is held still; give --stabilise, or "
                    "leave them out"
                )
            return
        Still.parse(self.stabilise)
        for path in self.transforms:
            format_of_transforms(path)
            check_output("--transforms", path)
            check_not_input("--transforms", path, *inputs)

    def pictures(
        self, tracker: Tracker, clip: Clip, frames: npt.NDArray[np.int64]
    ) -> tuple[Stabilisation, Iterator[Image]]:
        """Of `frames`, and what holds them still."""
        from decomo_runtime.stabilisation import stabilise
        from decomo_runtime.still_pictures import draw_stabilised

        assert self.stabilise is not None
        found = stabilise(tracker, self.stabilise, by=self.by, smooth=self.smooth, frames=frames)
        return draw_stabilised(tracker, clip.frames, found, border=self.border)

    def save(self, done: Stabilisation, tracker: Tracker, clip: Path) -> Iterator[str]:
        """Writes the transforms and yields what there is to say."""
        unknown = done.frames[~done.known].tolist()
        if unknown:
            yield (
                f"too little of the {done.still.what} is in sight in {len(unknown)} "
                f"frame{'s' * (len(unknown) != 1)}, from {unknown[0]} on: taken to move as those around"
            )
        for path in self.transforms:
            done.save(path, tracker.facts, clip)
            yield f"wrote {path}"


def stabilise_options(command: Function) -> Function:
    """Adds those of `StabiliseOptions`."""
    for option in (
        click.option(
            "--transforms",
            metavar="FILE",
            multiple=True,
            type=_PATH,
            help="Each frame's transform: .csv, a matrix; .nk, Nuke's CornerPin2D; else tracks of the corners.",
        ),
        click.option(
            "--border",
            type=click.Choice(BORDERS),
            default=BORDERS[0],
            help="Of what a frame does not show: empty, cut off, or filled from other frames.",
        ),
        click.option(
            "--smooth",
            metavar="SECONDS",
            type=float,
            default=0.0,
            show_default="none stays",
            help="Let motion stay that is slower than so many seconds.",
        ),
        click.option(
            "--by",
            type=click.Choice(TRANSFORMS),
            show_default="homography for the scene, else similarity",
            help="What brings a frame to where it is still.",
        ),
        click.option(
            "--stabilise",
            metavar="scene|object|X,Y,WIDTH,HEIGHT[@T]",
            help="Instead: the clip, the scene, the object or the box held still as in frame T.  [default T: 0]",
        ),
    ):
        command = option(command)
    return command
