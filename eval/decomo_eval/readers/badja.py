"""BADJA (Biggs et al., ACCV 2018): joints of animals in clips of DAVIS, annotated in some of the frames.

    joint_annotations/<name>.json       a list of image_path, segmentation_path, joints [37, 2], (y, x) in pixels, 0 to
                                        the height, and visibility [37]
    DAVIS/JPEGImages/Full-Resolution/<animal>/00000.jpg, ...
    DAVIS/Annotations/Full-Resolution/<animal>/00000.png, ...

Read as PIPs and CoTracker do (`badja_dataset.py`): a video runs from the first to the last frame of the list, which are
annotated; `extra_videos` are left out; of SMAL's joints the 20 that are annotated, in SMAL's order, `JOINTS`. A joint
is asked for in the frame in which it is first visible; theirs asks in the video's first frame also for those that are
hidden there. Joints that are never visible are left out.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from decomo_eval import figures
from decomo_eval.errors import DatasetError
from decomo_eval.readers.files import Videos, by_suffix
from decomo_eval.video import Figures, FrameFolder, Video, made_video
from decomo_runtime.layouts import RASTER_SIZE

LAYOUT = "a folder of joint_annotations/*.json and DAVIS"
JOINTS = {
    **{8: "upper right 1", 9: "upper right 2", 10: "upper right 3"},
    **{12: "upper left 1", 13: "upper left 2", 14: "upper left 3", 15: "neck"},
    **{18: "lower right 1", 19: "lower right 2", 20: "lower right 3"},
    **{22: "lower left 1", 23: "lower left 2", 24: "lower left 3"},
    **{25: "tail 0", 28: "tail 3", 31: "tail 6", 32: "jaw", 33: "nose", 35: "right ear", 36: "left ear"},
}
"""Names of the joints that are annotated, by their numbers in SMAL."""
ALL_JOINTS = 37
"""At least, in a frame's lists."""
_IMAGES, _MASKS = (PurePosixPath("DAVIS", kind, "Full-Resolution") for kind in ("JPEGImages", "Annotations"))

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class _Annotated:
    """What a file of annotations holds."""

    file: Path
    root: Path
    animal: str
    numbers: range
    """Of the frames."""
    joints: Mapping[int, tuple[npt.NDArray[np.float64], BoolArray]]
    """(x, y) [37, 2] in pixels and visible [37], by the frame's number."""

    def frame(self, number: int) -> Path:
        return self.root / _IMAGES / self.animal / f"{number:05d}.jpg"

    def mask(self, number: int) -> Path:
        return self.root / _MASKS / self.animal / f"{number:05d}.png"


def holds(path: Path) -> bool:
    """Whether there are annotations of joints."""
    return bool(by_suffix(path / "joint_annotations", ".json"))


def read(path: Path) -> Mapping[str, Video]:
    """The videos by their animals, as DAVIS names them."""
    found: dict[str, _Annotated] = {}
    for file in by_suffix(path / "joint_annotations", ".json"):
        annotated = _annotations(path, file)
        if annotated is None:
            continue
        if annotated.animal in found:
            raise DatasetError(f"{file} and {found[annotated.animal].file} both annotate {annotated.animal}")
        found[annotated.animal] = annotated
    if not found:
        raise DatasetError(f"{path / 'joint_annotations'} annotates no clip of DAVIS, only extra_videos")
    return Videos(found, _read_video)


def _read_video(name: str, annotated: _Annotated) -> Video:
    frames = FrameFolder([annotated.frame(number) for number in annotated.numbers])
    if missing := [file for file in frames.files if not file.is_file()]:
        raise DatasetError(f"{annotated.file} needs {missing[0]}, which is missing ({len(missing)} of {len(frames)})")
    chosen = list(JOINTS)
    xy = np.zeros((len(chosen), len(frames), 2))
    visible, judged = np.zeros(xy.shape[:2], bool), np.zeros(xy.shape[:2], bool)
    for number, (joints, seen) in annotated.joints.items():
        frame = number - annotated.numbers.start
        xy[:, frame], visible[:, frame], judged[:, frame] = joints[chosen], seen[chosen], True
    ever = visible.any(axis=1)
    points, visible, judged = xy[ever] / frames.size, visible[ever], judged[ever]
    made = made_video(f"video {name} of {annotated.file}", name, frames, points, ~visible, judged=judged)
    return replace(made, figures=_figures(annotated, made))


def _figures(annotated: _Annotated, video: Video) -> Figures:
    visible = ~video.occluded
    counted = visible & (np.arange(video.num_frames) > visible.argmax(axis=1)[:, None])

    def of(tracks: npt.NDArray[np.float64], _: BoolArray) -> dict[str, float]:
        areas = np.zeros(video.num_frames)
        for frame in np.flatnonzero(counted.any(axis=0)):
            areas[frame] = _area(annotated.mask(annotated.numbers[frame]))
        return figures.badja(tracks, video.points * RASTER_SIZE, counted, areas)

    return of


def _area(file: Path) -> int:
    """Pixels of a mask brought to the size at which it is scored; what counts is red, as in CoTracker's reader."""
    try:
        content = file.read_bytes()
    except OSError as error:
        raise DatasetError(f"{file}, the animal's mask, cannot be read ({error.strerror})") from error
    mask = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR) if content else None
    if mask is None:
        raise DatasetError(f"{file} does not decode as a picture; it must be the animal's mask")
    return int(np.count_nonzero(cv2.resize(mask[..., 2], figures.INPUT_SIZE, interpolation=cv2.INTER_NEAREST)))


def _annotations(root: Path, file: Path) -> _Annotated | None:
    """What a file says; None where it is of `extra_videos`."""
    try:
        entries = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{file} cannot be read as JSON ({error})") from error
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise DatasetError(f"{file} must be a list of annotated frames")
    ends = [_path(file, entry, "segmentation_path") for entry in (entries[0], entries[-1])]
    if "extra_videos" in ends[0].parts:
        return None
    animal, (first, last) = ends[0].parent.name, (_number(file, path) for path in ends)
    joints = {}
    for entry in entries:
        path = _path(file, entry, "image_path")
        if path.parent == _IMAGES / animal and path.suffix == ".jpg" and first <= (at := _number(file, path)) <= last:
            joints[at] = _joints(file, entry)
    if not animal or first > last or first not in joints:
        raise DatasetError(f"{file} must annotate frames of DAVIS in order, the first among them")
    return _Annotated(file, root, animal, range(first, last + 1), joints)


def _path(file: Path, entry: Mapping[str, Any], key: str) -> PurePosixPath:
    value = entry.get(key)
    if not isinstance(value, str) or "\0" in value or ".." in PurePosixPath(value).parts:
        raise DatasetError(f"{file} must have a path below its folder as {key} of every frame")
    return PurePosixPath(value)


def _number(file: Path, path: PurePosixPath) -> int:
    if not (path.stem.isascii() and path.stem.isdigit() and len(path.stem) == 5):
        raise DatasetError(f"{file} names {path} where a frame's file is named by its number, 00000.jpg")
    return int(path.stem)


def _joints(file: Path, entry: Mapping[str, Any]) -> tuple[npt.NDArray[np.float64], BoolArray]:
    yx, visible = (_rows(entry.get(key)) for key in ("joints", "visibility"))
    if yx is None or visible is None or yx.shape != (*visible.shape, 2) or visible.ndim != 1:
        raise DatasetError(f"{file} must have joints [{ALL_JOINTS}, 2] and visibility [{ALL_JOINTS}] of every frame")
    seen = visible > 0
    if not np.isfinite(yx[seen]).all():
        raise DatasetError(f"{file} has a visible joint whose position is not finite")
    return np.where(np.isfinite(yx), yx, 0)[:, ::-1], seen


def _rows(value: Any) -> npt.NDArray[np.float64] | None:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) < ALL_JOINTS:
        return None
    try:
        return np.array(value, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        return None
