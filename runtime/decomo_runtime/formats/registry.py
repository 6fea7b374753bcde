"""All formats of tracks, a line for each; command, Python and documentation go by this table.

A format is a module of this package with

- `write(tracks, path, about)`, which may take for granted that `path` is new;
- where `reads` says so, `read(path) -> (tracks, about)`;
- where the tool has limits, `check(number, frames, about)`, which raises `TracksFileError` where so many points, such
  frames or names pass them, or, as `write` would, `ModuleNotFoundError` where a library is missing.

It is imported when the format is used. Libraries that an extra installs are imported within those functions; the extra
is named where one is missing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from decomo_runtime.errors import TracksFileError
from decomotion.files import new_folder, replacing

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from decomo_runtime.formats.about import About
    from decomo_runtime.tracks import Tracks


@dataclass(frozen=True)
class TracksFormat:
    """One format of tracks."""

    name: str
    """For `--to`."""
    module: str
    """Of this package."""
    endings: tuple[str, ...]
    """That its files may have, in lower case; none of a folder."""
    purpose: str
    """What it is for, in a phrase: for help and documentation."""
    by_ending: bool = True
    """Whether such an ending alone may mean this format; else `--to` has to name it."""
    reads: bool = False
    extra: str | None = None
    """Of `pip install 'decomotion[...]'`, where it needs a library that the runtime does not."""
    folder: bool = False
    """Whether it is a folder of files; `write` gets an empty one."""

    @property
    def kind(self) -> str:
        """Its endings, or that it is a folder, as people read it."""
        return " or ".join(self.endings) or "folder"

    def check(self, number: int, frames: npt.NDArray[np.int64], about: About) -> None:
        """`TracksFileError` where tracks of `number` points in `frames` [M] do not go into this format; `about` may
        lack what the tracks will say. `write` looks too: this is for those who have yet to ask for the tracks.
        """
        check = getattr(self._module, "check", None)
        if check is not None:
            with self._extra_told():
                check(number, frames, about)

    def write(self, tracks: Tracks, path: Path, about: About) -> None:
        """Writes `path`, whole or not at all. `TracksFileError` where the tracks do not go into this format."""
        known = _completed(about, tracks)
        self.check(len(tracks.xy), tracks.frames, known)
        with (new_folder if self.folder else replacing)(path) as temporary, self._extra_told():
            self._module.write(tracks, temporary, known)

    def read(self, path: Path) -> tuple[Tracks, About]:
        """The tracks of a file, and what it says beside. `TracksFileError` where it is none of this format."""
        with self._extra_told():
            return self._module.read(path)

    @property
    def _module(self) -> Any:
        return import_module(f"decomo_runtime.formats.{self.module}")

    @contextmanager
    def _extra_told(self) -> Iterator[None]:
        try:
            yield
        except ModuleNotFoundError as error:
            if self.extra is None:
                raise
            raise TracksFileError(
                f"{self.name} needs {(error.name or '').split('.')[0]}, which is not installed; "
                f"run: pip install 'decomotion[{self.extra}]'"
            ) from error


MICROSECOND = 1e-6
"""To which a csv rounds times."""
FORMATS = (
    TracksFormat("npz", "npz", (".npz",), "arrays for numpy", reads=True),
    TracksFormat("csv", "csv", (".csv",), "a table, a line for each point and frame", reads=True),
    TracksFormat("json", "page", (".json",), "points of decomo-view's page", reads=True),
    TracksFormat("nuke", "nuke", (".nk",), "Nuke, a Tracker4 node"),
    TracksFormat("nuke-corner-pin", "nuke_corner_pin", (".nk",), "Nuke, a CornerPin2D of 4 points", by_ending=False),
    TracksFormat("after-effects", "after_effects", (".txt",), "After Effects, a Point Control for each point"),
    TracksFormat("after-effects-layers", "after_effects_layers", (), "After Effects, a layer each", folder=True),
    TracksFormat("blender", "blender", (".py",), "Blender, a script that builds tracks in a movie clip"),
    TracksFormat("3dequalizer", "equalizer", (".txt",), "3DEqualizer, 2D tracks"),
    TracksFormat("syntheyes", "syntheyes", (".txt",), "SynthEyes, tracker 2-D paths"),
    TracksFormat("pftrack", "pftrack", (".txt",), "PFTrack, 2D tracks"),
    TracksFormat("colmap", "colmap", (".db",), "COLMAP, keypoints and verified matches", extra="colmap"),
    TracksFormat("napari", "napari", (".csv",), "napari, a Tracks layer", by_ending=False),
    TracksFormat(
        "deeplabcut", "deeplabcut", (".csv", ".h5"), "DeepLabCut, predictions", by_ending=False, extra="deeplabcut"
    ),
    TracksFormat("sleap", "sleap", (".slp",), "SLEAP, predictions", extra="sleap"),
    TracksFormat("coco", "coco", (".json",), "COCO, keypoints with visibility", by_ending=False),
    TracksFormat("mot", "mot", (".txt",), "MOT Challenge, the boxes of objects", by_ending=False),
    TracksFormat("rerun", "rerun", (".rrd",), "rerun, a recording", extra="rerun"),
)


def format_of(path: Path, to: str | None = None) -> TracksFormat:
    """The format that `path` is to be written in: the one named `to`, or the one that its ending means.

    `TracksFileError` where there is none, there are several, or the two contradict each other.
    """
    suffix = path.suffix.lower()
    if to is not None:
        named = next((each for each in FORMATS if each.name == to), None)
        if named is None:
            raise TracksFileError(f"{to} is no format of tracks; there are {_names(FORMATS)}")
        if suffix not in (named.endings or ("",)):
            name = "without an ending" if named.folder else "with that ending"
            raise TracksFileError(f"{path}: {named.name} is written as {named.kind}; give a name {name}")
        return named
    able = [each for each in FORMATS if suffix in each.endings]
    meant = [each for each in able if each.by_ending] or able
    if not meant:
        endings = sorted({ending for each in FORMATS for ending in each.endings})
        raise TracksFileError(
            f"{path} does not end as a file of tracks does; give an ending of {', '.join(endings)}, "
            f"or say --to (to= in Python), one of {_names(FORMATS)}"
        )
    if len(meant) > 1:
        raise TracksFileError(
            f"{path} may be several things by its ending; say which with --to (to= in Python): {_names(meant)}"
        )
    return meant[0]


def read(path: Path) -> tuple[Tracks, About]:
    """The tracks of a file of ours, and what it says beside; `TracksFileError` where it is none."""
    readable = [each for each in FORMATS if each.reads]
    for each in readable:
        if path.suffix.lower() in each.endings:
            return each.read(path)
    endings = [ending for each in readable for ending in each.endings]
    raise TracksFileError(f"{path} is not a file of tracks by its ending; give {' or '.join(endings)}")


def _completed(about: About, tracks: Tracks) -> About:
    """With what `tracks` say of the clip where `about` does not; `TracksFileError` where they are of another clip, or
    there is not a name, or a colour, for each point.
    """
    for what, given in (("name", about.points), ("colour", about.colours)):
        if given and len(given) != len(tracks.xy):
            raise TracksFileError(
                f"there must be one {what} for each of the {len(tracks.xy)} points, or none at all, but there are "
                f"{len(given)}"
            )
    if about.size is not None and tracks.size is not None and about.size != tracks.size:
        raise TracksFileError(
            f"the tracks are in frames of {tracks.size[1]}x{tracks.size[0]} but those of the clip are "
            f"{about.width}x{about.height}; give the clip that they are of"
        )
    if about.size is not None:
        x, y = tracks.queries[:, 1], tracks.queries[:, 2]
        outside = (x < -0.5) | (y < -0.5) | (x > about.width - 0.5) | (y > about.height - 0.5)
        if outside.any():
            point = int(outside.argmax())
            raise TracksFileError(
                f"point {point} (counted from 0) was given at ({x[point]:g}, {y[point]:g}), outside of frames of "
                f"{about.width}x{about.height}; give the clip that the tracks are of"
            )
    if about.length is not None and len(tracks.frames) and tracks.frames.max() >= about.length:
        raise TracksFileError(
            f"the tracks reach frame {tracks.frames.max()} but the clip has {about.length} frames, from 0; "
            f"give the clip that they are of"
        )
    return replace(about, size=about.size or tracks.size, fps=about.fps or rate_of(tracks))


def rate_of(tracks: Tracks) -> float | None:
    """Frames a second, by the times of the first and the last column; None where there are no two.

    Of rates that say these times to a microsecond, as a csv has them, it is the plainest: 30, 30000 / 1001, 29.97.
    """
    if tracks.times is None or len(tracks.frames) < 2:
        return None
    frames = int(tracks.frames[-1] - tracks.frames[0])
    seconds = float(tracks.times[-1] - tracks.times[0])
    rate = frames / seconds if seconds else 0.0
    if not 0 < rate < math.inf:  # times of other tools' files may be anything
        return None
    plain = (round(rate), round(rate * 1.001) / 1.001, *(round(rate, digits) for digits in range(1, 7)))
    return next((each for each in plain if each and abs(frames / each - seconds) <= 1.01 * MICROSECOND), rate)


def _names(formats: tuple[TracksFormat, ...] | list[TracksFormat]) -> str:
    return ", ".join(each.name for each in formats)
