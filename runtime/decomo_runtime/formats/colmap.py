"""COLMAP's database: an image for each frame, the points in sight as its keypoints, and matches along their tracks.

The first pixel's centre is at (0.5, 0.5). All images are of one camera, whose focal length is COLMAP's usual guess.
Matches are verified by COLMAP itself, so that its mapper can begin; what does not move with the scene drops out there.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import TracksFileError
from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import image_names, in_frame, in_order
from decomo_runtime.formats.keys import from_top_left, shown
from decomo_runtime.tracks import Tracks

FOCAL = 1.2
"""Focal length over the longer side of the frame, where nothing is known: COLMAP's `default_focal_length_factor`."""
LEAST = 15
"""Matches that COLMAP wants of two images (`min_num_inliers`)."""
_TO_MAP = "follow more points of the static scene, such as with --grid 16@0 --on static"


def check(number: int, _: npt.NDArray[np.int64], __: About) -> None:
    """`TracksFileError` where there are too few points."""
    import_module("pycolmap")
    if number < LEAST:
        raise TracksFileError(f"COLMAP wants {LEAST} points in sight in two frames, but there are {number}; {_TO_MAP}")


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Raises `TracksFileError` where the clip's size is not known, or no two frames have matches that COLMAP takes."""
    pycolmap = import_module("pycolmap")
    tracks = in_order(tracks)
    seen = in_frame(tracks, about) & ~tracks.occluded
    names = image_names(about, tracks.frames)
    pairs = [(a, b) for a, b in _pairs(len(names)) if (seen[:, a] & seen[:, b]).sum() >= LEAST]
    if not pairs:
        raise TracksFileError(f"COLMAP wants {LEAST} points in sight in two frames, but no two have them; {_TO_MAP}")
    with _quiet(pycolmap):
        with pycolmap.Database.open(str(path)) as database, pycolmap.DatabaseTransaction(database):
            images = _write_images(pycolmap, database, names, about)
            keypoint = np.cumsum(seen, axis=0) - 1  # of each point, by frame
            for column, image in enumerate(images):
                places = from_top_left(tracks.xy[seen[:, column], column].astype(np.float64))
                database.write_keypoints(image, places.astype(np.float32))
            for a, b in shown(pairs, "pairs of frames"):
                common = seen[:, a] & seen[:, b]
                matches = np.column_stack([keypoint[common, a], keypoint[common, b]])
                database.write_matches(images[a], images[b], matches.astype(np.uint32))
        pycolmap.set_random_seed(0)
        pycolmap.geometric_verification(str(path))
        with pycolmap.Database.open(str(path)) as database:
            verified = database.num_inlier_matches()
    if not verified:
        raise TracksFileError(f"COLMAP finds no two frames whose points move as those of a static scene; {_TO_MAP}")


def _pairs(length: int) -> Iterator[tuple[int, int]]:
    """Columns as far apart as 1, 2, 3, 4, 6, 8, 12, 16, ...: near for many matches, far for parallax."""
    gap, wider = 1, 2
    while gap < length:
        yield from ((column, column + gap) for column in range(length - gap))
        gap, wider = wider, max(3, 2 * gap)


def _write_images(pycolmap: Any, database: Any, names: list[str], about: About) -> list[int]:
    """Their numbers in the database."""
    camera = database.write_camera(_camera(pycolmap, about))
    sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera)
    rig = pycolmap.Rig()
    rig.add_ref_sensor(sensor)
    rig = database.write_rig(rig)
    images = []
    for name in names:
        images.append(database.write_image(pycolmap.Image(name=name, camera_id=camera)))
        frame = pycolmap.Frame()
        frame.rig_id = rig
        frame.add_data_id(pycolmap.data_t(sensor, images[-1]))
        database.write_frame(frame)
    return images


def _camera(pycolmap: Any, about: About) -> Any:
    """COLMAP's usual model of square pixels, and one with two focal lengths where they are not."""
    focal = FOCAL * max(about.width, about.height)
    centre = about.width / 2, about.height / 2
    square = about.pixel_aspect == 1
    params: npt.ArrayLike = (
        [focal, *centre, 0.0] if square else [focal / about.pixel_aspect, focal, *centre, 0.0, 0.0, 0.0, 0.0]
    )
    model = "SIMPLE_RADIAL" if square else "OPENCV"
    return pycolmap.Camera(model=model, width=about.width, height=about.height, params=params)


@contextmanager
def _quiet(pycolmap: Any) -> Iterator[None]:
    """Of COLMAP's log, warnings alone."""
    before, pycolmap.logging.minloglevel = pycolmap.logging.minloglevel, 1
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before
