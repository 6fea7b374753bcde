"""Windows: parts of a clip that are fitted one by one, and the file that says where each lies. No torch.

A long clip is cut into windows that share some frames with the next; where it cuts to another shot they share none.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.errors import InputError
from decomotion.files import replacing
from decomotion.quality import Quality, parse
from decomotion.times import steady_times

FILE_NAME = "windows.json"
"""In the folder of a clip's runs, and of its models: `docs/formats-model.md`."""
FORMAT_VERSION = 1
OVERLAP, OVERLAP_SHARE = 12, 4
"""Frames that two windows of a shot share, but at most one in so many of a window's."""
SHORTEST = 8
"""Frames that a window must be allowed to have."""


@dataclass(frozen=True)
class Window:
    """Some frames of a clip, which are fitted as a clip of their own, numbered from 0."""

    name: str
    """Of the run's folder, and of the model's file without its suffix: `window-000`, …"""
    begin: int
    """First frame in the clip."""
    end: int
    """The frame after its last."""

    def __len__(self) -> int:
        return self.end - self.begin


@dataclass(frozen=True)
class Windows:
    """A clip and its windows, in order; `windows.json`."""

    clip: str
    """Its name."""
    num_frames: int
    height: int
    """Of its frames, pixels; so is `width`."""
    width: int
    fps: float
    """Frames a second, in the mean."""
    windows: tuple[Window, ...]
    seconds: tuple[float, ...] | None = None
    """Of each frame, from 0; None where `fps` says them."""
    pixel_aspect: float = 1.0
    """Width of a pixel over its height."""
    quality: tuple[Quality | None, ...] | None = None
    """How good the fit of each window is, of models; None where the file does not say."""

    @property
    def times(self) -> npt.NDArray[np.float64]:
        """[T], seconds of each frame."""
        return steady_times(self.num_frames, self.fps) if self.seconds is None else np.array(self.seconds)

    def shared(self, number: int) -> range:
        """The frames that window `number` shares with the next; empty at a cut."""
        return range(self.windows[number + 1].begin, self.windows[number].end)

    def home(self, frames: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
        """The window in which each of `frames` lies farther from either end."""
        ends = [len(self.shared(number)) for number in range(len(self.windows) - 1)]
        last = [window.end - shared / 2 for window, shared in zip(self.windows, ends, strict=False)]
        return np.searchsorted(np.array(last), np.asarray(frames) + 0.5)

    def save(self, file: Path, **more: Any) -> None:
        """Writes the file, whole or not at all, with what else it is to say."""
        content = {"format_version": FORMAT_VERSION, **asdict(self), **more}
        with replacing(file) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    @staticmethod
    def load(file: Path, error: type[InputError]) -> Windows:
        """Reads a file that `save` wrote. Raises `error` where it is damaged, newer or contradicts itself."""
        try:
            content = json.loads(file.read_bytes())
            version = content["format_version"]
            if isinstance(version, int) and version > FORMAT_VERSION:
                raise error(
                    f"{file} has format version {version} but this decomotion reads {FORMAT_VERSION}; upgrade it"
                )
            windows = tuple(
                Window(str(each["name"]), int(each["begin"]), int(each["end"])) for each in content["windows"]
            )
            seconds = content["seconds"]
            read = Windows(
                str(content["clip"]),
                int(content["num_frames"]),
                int(content["height"]),
                int(content["width"]),
                float(content["fps"]),
                windows,
                None if seconds is None else tuple(map(float, seconds)),
                float(content["pixel_aspect"]),
                _qualities(content.get("quality")),
            )
        except error:
            raise
        except OSError as cause:
            raise error(f"{file} cannot be read ({cause.strerror}); check its permissions") from cause
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as cause:
            raise error(f"{file} does not tell where the clip's windows are, or is damaged; write it again") from cause
        read._check(file, error)
        return read

    def _check(self, file: Path, error: type[InputError]) -> None:
        bounds = [(window.begin, window.end) for window in self.windows]
        connected = all(one[0] < two[0] <= one[1] < two[1] for one, two in pairwise(bounds))
        whole = bounds and bounds[0][0] == 0 and bounds[-1][1] == self.num_frames and bounds[0][1] > 0
        names = [window.name for window in self.windows]
        plain = len(set(names)) == len(names) and all(re.fullmatch(r"window-[0-9]+", name, re.ASCII) for name in names)
        steps = None if self.seconds is None else np.diff(np.array([*self.seconds]))
        steady = steps is None or (len(steps) == self.num_frames - 1 and self.times[0] == 0 and bool((steps > 0).all()))
        positive = all(0 < each < math.inf for each in (self.height, self.width, self.fps, self.pixel_aspect))
        told = self.quality is None or len(self.quality) == len(bounds)
        if not (connected and whole and plain and steady and positive and told):
            raise error(f"{file} contradicts itself: its windows do not cover the clip; write it again")


def _qualities(content: Any) -> tuple[Quality | None, ...] | None:
    """Raises `ValueError` or `TypeError` where it is none."""
    return None if content is None else tuple(each and parse(json.dumps(each)) for each in content)


def split(num_frames: int, cuts: Sequence[int], longest: int) -> tuple[Window, ...]:
    """Windows of about `longest` frames at most: none leads across a cut, those of a shot overlap by `OVERLAP` frames.

    A shot that has no more frames is one window; a longer one has windows of nearly equal length.
    """
    overlap = min(OVERLAP, longest // OVERLAP_SHARE)
    bounds: list[tuple[int, int]] = []
    for begin, end in pairwise([0, *cuts, num_frames]):
        frames = end - begin
        count = 1 if frames <= longest else math.ceil((frames - overlap) / (longest - overlap))
        starts = [begin + round(number * (frames - overlap) / count) for number in range(count)]
        bounds += [(start, following + overlap) for start, following in pairwise(starts)]
        bounds.append((starts[-1], end))
    return tuple(Window(f"window-{number:03d}", *each) for number, each in enumerate(bounds))


def whole_of(folder: Path) -> tuple[Path, int]:
    """The folder of the runs of all windows, of which that in `folder` is one, and their number; else itself and 1."""
    with suppress(InputError):
        layout = Windows.load(folder.parent / FILE_NAME, InputError)
        if folder.name in [window.name for window in layout.windows]:
            return folder.parent, len(layout.windows)
    return folder, 1
