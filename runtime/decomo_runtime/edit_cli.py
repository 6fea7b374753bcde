"""Options of `decomo-render` about edits of one frame that are shown in all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from decomo_runtime.options import OWNERS, Function, file_and_frame

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from decomo_runtime.tracker import Tracker
    from decomotion.clip import Clip

    Image = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class EditOptions:
    """What the command was given."""

    edit: tuple[str, ...]
    on: tuple[str, ...]
    relight: bool
    alone: bool

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> EditOptions:
        """Of all that a command was given."""
        return cls(**{field.name: given[field.name] for field in fields(cls)})

    @property
    def files(self) -> list[Path]:
        """That are read."""
        return [file_and_frame(text)[0] for text in self.edit]

    def check(self) -> None:
        """`RenderError` where they say nothing together."""
        from decomo_runtime.errors import RenderError

        if not self.edit and (self.on or self.relight or self.alone):
            raise RenderError("--on, --relight and --alone say how an --edit is drawn; give one, or leave them out")
        if len(self.on) not in (0, 1, len(self.edit)):
            raise RenderError(
                f"there are {len(self.edit)} of --edit and {len(self.on)} of --on; give one for all, or one for each"
            )

    def pictures(self, tracker: Tracker, clip: Clip, frames: npt.NDArray[np.int64]) -> Iterator[Image]:
        """Of `frames`."""
        from decomo_runtime.edits import draw_edits, read_edit

        on = self.on or OWNERS[:1]
        on = on * len(self.edit) if len(on) == 1 else on
        edits = [read_edit(text, owner) for text, owner in zip(self.edit, on, strict=True)]
        return draw_edits(tracker, clip.frames, edits, frames.tolist(), relight=self.relight, alone=self.alone)


def edit_options(command: Function) -> Function:
    """Adds those of `EditOptions`."""
    for option in (
        click.option("--alone", is_flag=True, help="The edits without the clip, with alpha."),
        click.option("--relight", is_flag=True, help="Edits become brighter and darker as the clip does there."),
        click.option(
            "--on",
            multiple=True,
            type=click.Choice(OWNERS),
            help=f"What an edit belongs to; once for all, or once for each.  [default: {OWNERS[0]}]",
        ),
        click.option(
            "--edit",
            metavar="PICTURE@T",
            multiple=True,
            help="Instead: the clip, with this PNG, painted over frame T, moved through all frames. Several: the last "
            "lies on top.",
        ),
    ):
        command = option(command)
    return command
