"""COCO keypoints: an annotation for each image, with (x, y, visibility) of each point.

Visibility is 2 where a point is in sight, 1 where it is hidden and its place is told all the same, 0 where it has none.
An annotation's `score`, as results have it, is the mean of its points' likelihoods.
Pixel centres are at whole numbers. What a frame's number is, COCO does not say: here it is `frame_id`, from 0, as in
data sets of videos.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import QueryError
from decomo_runtime.formats.about import About
from decomo_runtime.formats.frames import image_names, in_frame, in_order, likelihood
from decomo_runtime.formats.keypoints import Keypoints
from decomo_runtime.formats.keys import shown
from decomo_runtime.formats.objects import objects_of
from decomo_runtime.tracks import Tracks

HIDDEN, IN_SIGHT = 1, 2
_DECIMALS = 4
MOST_PLACES = 10**7
"""Of points in images that are read of a file."""


def write(tracks: Tracks, path: Path, about: About) -> None:
    """Points are keypoints of one object, or of several (`objects.py`); one that is out of the frame has no place.

    Boxes are those of the placed points' pixels; where an object has none, there is no annotation. Raises
    `TracksFileError` where the clip's size is not known.
    """
    tracks = in_order(tracks)
    names = image_names(about, tracks.frames)
    images = [
        {"id": number, "file_name": name, "width": about.width, "height": about.height, "frame_id": frame}
        for number, (name, frame) in enumerate(zip(names, tracks.frames.tolist(), strict=True), 1)
    ]
    visibility = np.where(in_frame(tracks, about), np.where(tracks.occluded, HIDDEN, IN_SIGHT), 0)
    objects = objects_of(about, len(tracks.xy))
    category = {"id": 1, "name": about.name, "supercategory": "", "keypoints": objects.parts, "skeleton": []}
    score = objects.mean(likelihood(tracks, about))
    xy, seen = objects.arranged(tracks.xy.astype(np.float64), np.nan), objects.arranged(visibility, 0)
    with open(path, "w", encoding="utf-8") as file:  # an annotation at a time: all are many
        file.write(f'{{"images": {json.dumps(images)}, "categories": {json.dumps([category])}, "annotations": [')
        for number, (column, row) in enumerate(shown(np.argwhere(seen.any(axis=1).T).tolist(), "annotations"), 1):
            numbers = {"id": number, "image_id": images[column]["id"], "category_id": 1, "track_id": row + 1}
            annotation = numbers | _annotation(xy[row, :, column], seen[row, :, column])
            annotation["score"] = round(float(score[row, column]), _DECIMALS)
            file.write(("\n" if number == 1 else ",\n") + json.dumps(annotation, allow_nan=False))
        file.write("\n]}\n")


def _annotation(xy: npt.NDArray[np.float64], visibility: npt.NDArray[np.int64]) -> dict[str, Any]:
    placed = visibility > 0
    left, top = xy[placed].min(axis=0)
    width, height = xy[placed].max(axis=0) - (left, top) + 1
    keypoints = np.column_stack([np.where(placed[:, None], xy, 0), visibility])
    return {
        "keypoints": [round(value, _DECIMALS) for value in keypoints.ravel().tolist()],
        "num_keypoints": int(placed.sum()),
        "bbox": [round(float(value), _DECIMALS) for value in (left, top, width, height)],
        "area": round(float(width * height), _DECIMALS),
        "iscrowd": 0,
    }


def read_keypoints(path: Path, files: Sequence[str] = (), first: int | None = None) -> Keypoints:
    """The keypoints of a .json; a hidden one has the score 0.

    The frame of an image is its `frame_id`; else the place of its name among `files`, the names of the clip's frames;
    else the number at the end of its name, less `first`. A name is that of the keypoint, behind its category and track
    where there are several objects. `QueryError` where the file has no keypoints, or does not tell frames or objects
    apart.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
        images = {image["id"]: image for image in content["images"]}
        annotations = [
            each
            for each in content["annotations"]
            if any(each.get("keypoints", ())) and each["image_id"] in images and not each.get("iscrowd")
        ]
        labels = {each["id"]: _labels(each) for each in content["categories"]}
        drawn_on = [images[each["image_id"]] for each in annotations]
        frames = frames_of(path, drawn_on, files, first)
        return replace(_keypoints(path, annotations, labels, frames), size=_size(path, drawn_on))
    except QueryError:
        raise
    except OSError as error:
        raise QueryError(f"{path} cannot be read ({error.strerror}); give a .json of COCO keypoints") from error
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise QueryError(
            f"{path} does not hold COCO keypoints ({type(error).__name__}: {error}); give another"
        ) from error


def _size(path: Path, images: Sequence[dict[str, Any]]) -> tuple[int, int] | None:
    """(height, width) of the images where they say it; `QueryError` where they are of several sizes."""
    sizes = {(int(each["height"]), int(each["width"])) for each in images if each.get("height") and each.get("width")}
    if len(sizes) > 1:
        named = " and ".join(f"{width}x{height}" for height, width in sorted(sizes)[:2])
        raise QueryError(f"{path} has images of {named}, which are not of one clip; give those of one")
    return next(iter(sizes), None)


def _labels(category: dict[str, Any]) -> tuple[str, list[str]]:
    """Of a category: its name, and those of its keypoints."""
    return str(category.get("name", category["id"])), [str(name) for name in category.get("keypoints", ())]


def frames_of(path: Path, images: Sequence[dict[str, Any]], files: Sequence[str], first: int | None) -> list[int]:
    """Of each image its frame, as `read_keypoints` says; `QueryError` where that is not told."""
    if all("frame_id" in image for image in images):
        return [int(image["frame_id"]) for image in images]
    names = [Path(image["file_name"]).name for image in images]
    place = {name: number for number, name in enumerate(files)}
    if files and place.keys() >= set(names):
        return [place[name] for name in names]
    found = [re.search(r"(\d+)\D*$", Path(name).stem) for name in names]
    numbers = [int(number[1]) for number in found if number is not None]
    if len(numbers) < len(names) or (first is None and min(numbers) > 0):
        raise QueryError(
            f"{path}: the images ({names[0]!r}, ...) do not tell which frames of the clip they are; give --clip, its "
            "folder of such files (in Python files=, their names, or first=, the number of its first frame in them)"
        )
    return [number - (first or 0) for number in numbers]


def _keypoints(
    path: Path,
    annotations: Sequence[dict[str, Any]],
    labels: dict[Any, tuple[str, list[str]]],
    frames: Sequence[int],
) -> Keypoints:
    if not annotations:
        raise QueryError(f"{path} holds no keypoints; give a .json of COCO keypoints")
    objects = _objects(path, annotations, labels, frames)
    several = len(set(objects)) > 1
    columns = {frame: column for column, frame in enumerate(sorted(set(frames)))}
    rows: list[tuple[int, int, float, float, float]] = []
    names: dict[str, int] = {}
    for annotation, frame, owner in zip(annotations, frames, objects, strict=True):
        values = np.array(annotation["keypoints"], np.float64).reshape(-1, 3)
        given = labels[annotation["category_id"]][1]
        for number, (x, y, seen) in enumerate(values):
            name = given[number] if number < len(given) else f"point_{number:02}"
            row = names.setdefault(f"{owner}.{name}" if several else name, len(names))
            if seen >= HIDDEN:
                rows.append((row, columns[frame], x, y, float(seen == IN_SIGHT)))
    if len(names) * len(columns) > MOST_PLACES:
        raise QueryError(f"{path} has {len(names)} points in {len(columns)} images, which is too much; give a part")
    xy, score = np.full((len(names), len(columns), 2), np.nan), np.zeros((len(names), len(columns)))
    for row, column, x, y, seen in rows:
        xy[row, column], score[row, column] = (x, y), seen
    return Keypoints(tuple(names), np.array(list(columns), np.int64), xy, score)


def _objects(
    path: Path,
    annotations: Sequence[dict[str, Any]],
    labels: dict[Any, tuple[str, list[str]]],
    frames: Sequence[int],
) -> list[str]:
    """The object that each annotation is of, by its category and its track, or number, where one image has them all."""
    tracks = [each.get("track_id", (each.get("attributes") or {}).get("track_id")) for each in annotations]
    told = list(zip([each["category_id"] for each in annotations], tracks, frames, strict=True))
    if len(set(told)) == len(told):
        numbers = tracks
    elif len(set(frames)) == 1:
        numbers = list(range(1, len(annotations) + 1))
    else:
        raise QueryError(
            f"{path}: an image has several objects and no track_id tells them apart; give each annotation a "
            "track_id, or a file with one image"
        )
    return [
        labels[each["category_id"]][0] + ("" if number is None else str(number))
        for each, number in zip(annotations, numbers, strict=True)
    ]
