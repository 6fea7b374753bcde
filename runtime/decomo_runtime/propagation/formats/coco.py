"""COCO: an annotation for each object and image: a segmentation (polygons or run lengths), keypoints, or a box alone.

Corners and boxes begin at a pixel's border, keypoints are pixels with centres at whole numbers
(`decomo_runtime/formats/coco.py`). Objects are told apart by `track_id`, else by category, else, in a single image, by
`id`. What is written has `score`, its confidence.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import AnnotationError, QueryError
from decomo_runtime.formats.coco import HIDDEN, IN_SIGHT, frames_of
from decomo_runtime.propagation.formats import asked
from decomo_runtime.propagation.formats.asked import ClipFacts
from decomo_runtime.propagation.outlines import outlines
from decomo_runtime.propagation.shapes import Annotation, Kind, Mask, Shape, Thing

FILE = "annotations.json"
_DECIMALS = 2
_KEPT = ("category_id", "track_id", "attributes", "iscrowd")
"""Of an object's first annotation in all that are written."""


def read(path: Path, content: bytes, frame: int | None, clip: ClipFacts) -> Annotation:
    """What is drawn on the images of a file, or, where `frame` is given, on that one: the only image's, if there is
    one.
    """
    top = json.loads(content.decode("utf-8-sig"))
    images = {image["id"]: image for image in top["images"]}
    categories = {each["id"]: each for each in top["categories"]}
    entries = [each for each in top["annotations"] if each["image_id"] in images]
    for image in images.values():
        asked.same_size(path, image.get("width"), image.get("height"), clip)
    frame_of = _frames(path, images, frame, clip)
    entries = [each for each in entries if each["image_id"] in frame_of]
    keys = _keys(path, entries)
    things: dict[Any, Thing] = {}
    shapes: list[Shape] = []
    for entry, key in zip(entries, keys, strict=True):
        category = categories[entry["category_id"]]
        if key not in things:
            kept = {name: entry[name] for name in _KEPT if name in entry}
            names = tuple(map(str, category.get("keypoints", ())))
            things[key] = Thing(
                key, str(category.get("name", category["id"])), names, {"entry": kept, "category": category}
            )
        shapes += _shapes(path, entry, list(things).index(key), frame_of[entry["image_id"]], clip)
    rest = {name: top[name] for name in ("info", "licenses") if name in top} | {"categories": list(categories.values())}
    return Annotation(clip.size, tuple(things.values()), tuple(shapes), rest)


def write(folder: Path, annotation: Annotation, frames: Iterable[tuple[int, list[Shape]]], clip: ClipFacts) -> None:
    """`annotations.json`, an annotation at a time."""
    height, width = annotation.size
    images = [
        {"id": frame + 1, "file_name": clip.image(frame), "width": width, "height": height, "frame_id": frame}
        for frame in range(clip.num_frames)
    ]
    number = 0
    with open(folder / FILE, "w", encoding="utf-8") as file:
        categories = {each["id"]: each for each in annotation.source["categories"]}
        for thing in annotation.things:  # of several files each has its own
            categories.setdefault(thing.source["category"]["id"], thing.source["category"])
        head = json.dumps(annotation.source | {"images": images, "categories": list(categories.values())})
        file.write(f'{head[:-1]}, "annotations": [')
        for frame, shapes in frames:
            for thing in sorted({shape.thing for shape in shapes}):
                number += 1
                mine = [shape for shape in shapes if shape.thing == thing]
                source = annotation.things[thing].source["entry"]
                ids = {"id": number, "image_id": frame + 1, "track_id": thing + 1, "iscrowd": 0}
                line = json.dumps({**ids, **source, **_entry(mine)}, allow_nan=False)
                file.write(("\n" if number == 1 else ",\n") + line)
        file.write("\n]}\n")


def _frames(path: Path, images: dict[Any, Any], frame: int | None, clip: ClipFacts) -> dict[Any, int]:
    if frame is not None and len(images) == 1:
        return {next(iter(images)): frame}
    try:
        numbers = frames_of(path, list(images.values()), clip.files, None) if images else []
    except QueryError as error:
        raise AnnotationError(str(error)) from None
    found = dict(zip(images, numbers, strict=True))
    wanted = {image: number for image, number in found.items() if frame in (None, number)}
    if frame is not None and not wanted:
        raise AnnotationError(f"{path} has no image of frame {frame}; it has those of {sorted(found.values())[:5]}")
    return wanted


def _keys(path: Path, entries: Sequence[dict[str, Any]]) -> list[Any]:
    tracks = [each.get("track_id", _attributes(each).get("track_id")) for each in entries]
    if all(track is not None for track in tracks):
        return [f"{each['category_id']}/{track}" for each, track in zip(entries, tracks, strict=True)]
    alone = [(each["image_id"], each["category_id"]) for each in entries]
    if len(set(alone)) == len(alone):
        return [f"{each['category_id']}" for each in entries]
    if len({image for image, _ in alone}) == 1:
        return [f"{each['category_id']}/id {each['id']}" for each in entries]
    raise AnnotationError(
        f"{path}: an image has several objects of a category and no track_id tells them apart from image to image; "
        "give each annotation a track_id, or a file with one image"
    )


def _attributes(entry: dict[str, Any]) -> dict[str, Any]:
    """What CVAT says of an object beside COCO's own."""
    return entry.get("attributes") or {}


def _shapes(path: Path, entry: dict[str, Any], thing: int, frame: int, clip: ClipFacts) -> list[Shape]:
    drawn = entry.get("segmentation")
    shapes: list[Shape] = []
    if isinstance(drawn, dict):
        shapes.append(asked.masked(path, thing, frame, _decoded(drawn), clip))
    elif drawn:
        polygons = [np.reshape(np.asarray(each, np.float64), (-1, 2)) - 0.5 for each in drawn]
        shapes.append(asked.region(path, thing, frame, polygons, clip))
    keypoints = np.asarray(entry.get("keypoints", ()), np.float64).reshape(-1, 3)
    if keypoints[:, 2].any():
        xy = np.where(keypoints[:, 2:] >= HIDDEN, keypoints[:, :2], np.nan)
        shapes.append(asked.points(path, thing, frame, xy, keypoints[:, 2] == HIDDEN, clip))
    elif not drawn:
        if _attributes(entry).get("rotation"):
            raise AnnotationError(f"{path} has a box that is turned, which is not carried; draw a polygon")
        left, top, width, height = entry["bbox"]
        corners = np.array([[left, top], [left + width, top + height]]) - 0.5
        shapes.append(asked.box(path, thing, frame, corners, clip))
    return shapes


def _entry(shapes: Sequence[Shape]) -> dict[str, Any]:
    entry: dict[str, Any] = {}
    for shape in shapes:
        if shape.kind == Kind.POINTS:
            told = np.isfinite(shape.xy).all(axis=1)
            seen = np.where(told, np.where(shape.occluded, HIDDEN, IN_SIGHT), 0)
            values = np.column_stack([np.where(np.isfinite(shape.xy), shape.xy, 0), seen])
            entry |= {"keypoints": _rounded(values), "num_keypoints": int(told.sum())}
        elif shape.mask is not None and shape.kind == Kind.POLYGON:
            entry["segmentation"] = [_rounded(each + 0.5) for each in shape.polygons or outlines(shape.mask)]
        elif shape.mask is not None:
            entry["segmentation"] = _encoded(shape.mask)
    shape = next((each for each in shapes if each.kind != Kind.POINTS), shapes[0])
    low, high = (corner + 0.5 for corner in asked.bounds(shape))
    area = float(np.prod(high - low)) if shape.mask is None else float(shape.mask.sum())
    score = round(min(each.confidence for each in shapes), 4)
    return entry | {"bbox": _rounded(np.concatenate([low, high - low])), "area": round(area, _DECIMALS), "score": score}


def _encoded(mask: Mask) -> dict[str, Any]:
    """Run lengths, column by column, of nothing first."""
    flat = np.concatenate([[False], mask.ravel(order="F"), [False]])
    ends = np.flatnonzero(flat[1:] != flat[:-1])
    runs = np.diff(np.concatenate([[0], ends, [mask.size]]))
    return {"size": list(mask.shape), "counts": (runs if runs[-1] else runs[:-1]).tolist()}


def _decoded(drawn: dict[str, Any]) -> Mask:
    height, width = (int(side) for side in drawn["size"])
    counts = drawn["counts"]
    runs = np.asarray(_unpacked(counts) if isinstance(counts, str) else counts, np.int64)
    if (runs < 0).any() or runs.sum() != height * width or height * width > asked.MOST**2:
        raise ValueError("run lengths that are not of their size")
    return np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape((height, width), order="F")


def _unpacked(text: str) -> list[int]:
    """COCO's string of run lengths: groups of five bits, the sixth says that more follow; each but the first three is
    less the one two before it.
    """
    runs: list[int] = []
    value = shift = 0
    for letter in text.encode("ascii"):
        bits = letter - 48
        value |= (bits & 0x1F) << shift
        shift += 5
        if not bits & 0x20:
            if bits & 0x10:
                value -= 1 << shift
            runs.append(value + (runs[-2] if len(runs) > 2 else 0))
            value = shift = 0
    return runs


def _rounded(values: npt.NDArray[np.float64]) -> list[float]:
    return [round(value, _DECIMALS) for value in values.ravel().tolist()]
