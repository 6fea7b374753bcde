"""rerun's recording: the points frame by frame, those in sight and those hidden, and the way they came.

About points in sight are circles as wide as their expected error. The first pixel's centre is at (0.5, 0.5). With the
clip's frames behind the points, where they are known.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import in_order
from decomo_runtime.formats.keys import from_top_left, shown
from decomo_runtime.overlay import TRAIL, rainbow
from decomo_runtime.tracks import Tracks
from decomotion.clip import Clip, read_clip
from decomotion.files import check_room

FIRST_FRAME = 0
CLIP, IN_SIGHT, HIDDEN, TRAILS = "clip", "clip/in_sight", "clip/hidden", "clip/trails"
ERROR = "clip/error"
"""Entities."""
_RADII = {IN_SIGHT: 2.5, HIDDEN: 1.0}
_WIDTH = 0.5
"""Half of a trail's, in pixels as radii are."""
_CIRCLE = 0.25
"""Half the width of a circle's line, likewise."""
_JPEG = 90


def check(_: int, __: npt.NDArray[np.int64], ___: About) -> None:
    """`ModuleNotFoundError` where rerun is missing: it has no limits."""
    import_module("rerun")


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where there is nothing to write, `ClipError` where the clip cannot be read."""
    rr = import_module("rerun")
    tracks = in_order(tracks)
    clip = None if about.clip is None else read_clip(about.clip)
    xy = from_top_left(tracks.xy.astype(np.float64))
    placed, seen = np.asarray(np.isfinite(xy).all(axis=-1)), ~tracks.occluded
    colours = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in about.colours], np.uint8)
    colours = colours if len(colours) else rainbow(tracks.queries)
    names = np.array(about.names(len(xy)))
    check_room(path, _room(tracks, clip))
    with rr.RecordingStream("decomotion") as recording:
        recording.save(str(path), default_blueprint=_blueprint(about))
        recording.send_recording_name(about.name)
        recording.set_log_time_enabled(False)  # a timeline of when this ran
        for column in shown(range(len(tracks.frames)), "frames"):
            frame = int(tracks.frames[column])
            recording.set_time("frame", sequence=int(about.numbers(tracks.frames[column : column + 1], FIRST_FRAME)[0]))
            if tracks.times is not None:
                recording.set_time("time", duration=float(tracks.times[column]))
            if clip is not None:
                recording.log(CLIP, rr.EncodedImage(contents=_jpeg(clip, frame), media_type="image/jpeg"))
            for entity, rows in ((IN_SIGHT, seen[:, column]), (HIDDEN, placed[:, column] & ~seen[:, column])):
                recording.log(
                    entity,
                    rr.Points2D(
                        xy[rows, column],
                        radii=_RADII[entity],
                        colors=colours[rows],
                        labels=names[rows].tolist(),
                        show_labels=False,
                    ),
                )
            if tracks.error is not None:
                around = tracks.error[seen[:, column], column]
                recording.log(
                    ERROR,
                    rr.Ellipses2D(
                        half_sizes=np.column_stack([around, around]),
                        centers=xy[seen[:, column], column],
                        line_radii=_CIRCLE,
                        colors=colours[seen[:, column]],
                    ),
                )
            steps = seen[:, column] & seen[:, max(0, column - 1)]
            segments = xy[steps][:, [max(0, column - 1), column]]
            recording.log(TRAILS, rr.LineStrips2D(segments, radii=_WIDTH, colors=colours[steps]))
        recording.disconnect()


def _room(tracks: Tracks, clip: Clip | None) -> int:
    """Bytes that the recording may have, from some of the frames."""
    some = (
        []
        if clip is None
        else [len(_jpeg(clip, int(frame))) for frame in tracks.frames[[0, len(tracks.frames) // 2, -1]]]
    )
    return 2**20 + 160 * tracks.occluded.size + (4096 + 2 * max(some, default=0)) * len(tracks.frames)


def _jpeg(clip: Clip, frame: int) -> bytes:
    return cv2.imencode(".jpg", clip.frames[frame][..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG])[1].tobytes()


def _blueprint(about: About) -> Any:
    """One view, in which the steps of the last frames are seen together as trails."""
    rrb = import_module("rerun.blueprint")
    past = rrb.VisibleTimeRanges(
        timeline="frame",
        start=rrb.TimeRangeBoundary.cursor_relative(seq=-TRAIL),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    view = rrb.Spatial2DView(origin=CLIP, name=about.name, overrides={TRAILS: past})
    return rrb.Blueprint(view, rrb.TimePanel(timeline="frame", fps=about.fps), collapse_panels=True)
