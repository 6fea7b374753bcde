"""What tools want to know of a clip and its points, beside the tracks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.model_file import ModelFacts


@dataclass(frozen=True)
class About:
    """What a file of tracks may not hold itself; a writer gets all that is known and asks for it by the properties."""

    size: tuple[int, int] | None = None
    """(height, width) of the clip in pixels."""
    fps: float | None = None
    """Frames a second of the clip, in the mean."""
    length: int | None = None
    """Frames of the whole clip."""
    pixel_aspect: float = 1.0
    """Width of the clip's pixels over their height."""
    name: str = "clip"
    """Of the clip."""
    clip: Path | None = None
    """Where its frames or video are."""
    first_frame: int | None = None
    """What the tool calls the clip's first frame; None: what its users call it (`numbers`)."""
    points: tuple[str, ...] = ()
    """A name for each point; none: they are numbered (`names`)."""
    colours: tuple[str, ...] = ()
    """A colour for each point, as #rrggbb; none: the tool chooses."""

    @classmethod
    def of(cls, model: ModelFacts, clip: Path | None = None) -> About:
        """Of tracks that a model answered; `clip` is where the frames are, if that is known."""
        return cls(
            size=(model.height, model.width),
            fps=model.fps,
            length=model.num_frames,
            pixel_aspect=model.pixel_aspect,
            name=model.clip_name,
            clip=clip,
        )

    @property
    def height(self) -> int:
        """Pixels; `TracksFileError` where it is not known. So is `width`."""
        return self._known_size[0]

    @property
    def width(self) -> int:
        """Pixels; `TracksFileError` where it is not known."""
        return self._known_size[1]

    @property
    def rate(self) -> float:
        """Frames a second; `TracksFileError` where it is not known."""
        if self.fps is None:
            raise TracksFileError("the tracks do not say the clip's frame rate; give --fps (fps= in Python), or --clip")
        return self.fps

    def numbers(self, frames: npt.NDArray[np.int64], first: int) -> npt.NDArray[np.int64]:
        """Frame numbers [M] in a tool whose users call the first one `first`, unless something else was asked for."""
        return frames + (first if self.first_frame is None else self.first_frame)

    def names(self, count: int) -> list[str]:
        """A name for each of `count` points: its own, else its number, from 0, as in the csv."""
        if self.points:
            return list(self.points)
        digits = max(2, len(str(count - 1)))
        return [f"point_{number:0{digits}}" for number in range(count)]

    @property
    def _known_size(self) -> tuple[int, int]:
        if self.size is None:
            raise TracksFileError(
                "the tracks do not say the clip's size; give --size WIDTHxHEIGHT (size= in Python), or --clip"
            )
        return self.size
