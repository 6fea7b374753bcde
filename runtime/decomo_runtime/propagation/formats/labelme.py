"""labelme and X-AnyLabeling: a JSON file for each image; `points` begin at a pixel's border.

Shapes of one label and one group are one object; those without a group are each their own. What is written has
`score`, its confidence.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from decomo_runtime.errors import AnnotationError
from decomo_runtime.propagation.formats import asked
from decomo_runtime.propagation.formats.asked import ClipFacts
from decomo_runtime.propagation.outlines import box_around, outlines
from decomo_runtime.propagation.shapes import Annotation, Kind, Mask, Shape, Thing
from decomotion.images import plausible, png

KINDS = {"polygon": Kind.POLYGON, "rectangle": Kind.BOX, "point": Kind.POINTS, "mask": Kind.MASK}
_WORDS = {kind: word for word, kind in KINDS.items()}
_DECIMALS = 2


def read(path: Path, content: bytes, frame: int | None, clip: ClipFacts) -> Annotation:
    """What is drawn on one image; its frame is given, or that of `imagePath`."""
    top = json.loads(content.decode("utf-8-sig"))
    asked.same_size(path, top.get("imageWidth"), top.get("imageHeight"), clip)
    frame = clip.frame_of(str(top.get("imagePath") or ""), path) if frame is None else frame
    grouped: dict[str, list[dict[str, Any]]] = {}
    numbers: dict[tuple[str, str], int] = {}
    for entry in top["shapes"]:
        label, word, group = str(entry["label"]), entry.get("shape_type", "polygon"), entry.get("group_id")
        if word not in KINDS:
            raise AnnotationError(f"{path} has a {word}, which is not carried; draw a {', '.join(KINDS)}")
        if group is None:
            numbers[label, word] = number = numbers.get((label, word), 0) + 1
            key = f"{word} {label} #{number}"
        else:
            key = f"{word} {label} {group}" + (f" {len(grouped)}" if word == "point" else "")
        grouped.setdefault(key, []).append(entry)
    things, shapes = [], []
    for key, entries in grouped.items():
        first = entries[0]
        label, word = str(first["label"]), first.get("shape_type", "polygon")
        kept = {name: value for name, value in first.items() if name not in ("points", "mask", "score")}
        several = first.get("group_id") is None and numbers[label, word] > 1
        shapes.append(_shape(path, KINDS[word], entries, len(things), frame, clip))
        things.append(Thing(key, label, (), {"shape": kept, "by_order": several}))
    rest = {name: value for name, value in top.items() if name not in ("shapes", "imagePath", "imageData")}
    return Annotation(clip.size, tuple(things), tuple(shapes), rest)


def write(folder: Path, annotation: Annotation, frames: Iterable[tuple[int, list[Shape]]], clip: ClipFacts) -> None:
    """A file for each frame, named as its image."""
    height, width = annotation.size
    for frame, shapes in frames:
        image = clip.image(frame)
        entries = [entry for shape in shapes for entry in _entries(shape, annotation.things[shape.thing])]
        top = annotation.source | {
            "shapes": entries,
            "imagePath": image,
            "imageData": None,
            "imageHeight": height,
            "imageWidth": width,
        }
        text = json.dumps(top, indent=1, allow_nan=False)
        (folder / f"{Path(image).stem}.json").write_text(text + "\n", encoding="utf-8")


def _shape(path: Path, kind: Kind, entries: list[dict[str, Any]], thing: int, frame: int, clip: ClipFacts) -> Shape:
    corners = [np.asarray(entry["points"], np.float64).reshape(-1, 2) - 0.5 for entry in entries]
    if kind == Kind.POLYGON:
        return asked.region(path, thing, frame, corners, clip)
    if kind == Kind.MASK:
        mask = np.zeros(clip.size, bool)
        for entry, corner in zip(entries, corners, strict=True):
            _lay(path, mask, _decoded(path, entry["mask"]), np.rint(corner[0] + 0.5).astype(int))
        return asked.masked(path, thing, frame, mask, clip)
    if len(entries) > 1:
        raise AnnotationError(
            f"{path} has several {_WORDS[kind]}s {entries[0]['label']!r} of one group; give each a group_id of its own"
        )
    if kind == Kind.BOX:
        return asked.box(path, thing, frame, corners[0][[0, -1 if len(corners[0]) == 2 else 2]], clip)
    return asked.points(path, thing, frame, corners[0], np.zeros(1, bool), clip)


def _entries(shape: Shape, thing: Thing) -> list[dict[str, Any]]:
    score = {"score": round(shape.confidence, 4)}
    kept = thing.source["shape"] | score
    if shape.mask is None:
        return [kept | {"points": _listed(shape.xy)}]
    if shape.kind == Kind.MASK:
        box = np.rint(box_around(shape.mask) + 0.5).astype(int)
        (left, top), (right, bottom) = box.tolist()
        part = shape.mask[top:bottom, left:right].astype(np.uint8) * 255
        text = base64.b64encode(png(part)).decode("ascii")
        return [kept | {"points": [[left, top], [right - 1, bottom - 1]], "mask": text}]
    return [kept | {"points": _listed(each)} for each in shape.polygons or outlines(shape.mask)]


def _decoded(path: Path, text: str) -> Mask:
    content = base64.b64decode(text)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE) if plausible(content) else None
    if image is None:
        raise AnnotationError(f"{path} has a mask that does not decode; draw it again")
    return image > 0


def _lay(path: Path, mask: Mask, part: Mask, place: np.ndarray) -> None:
    (left, top), (height, width) = place.tolist(), part.shape
    if left < 0 or top < 0 or top + height > mask.shape[0] or left + width > mask.shape[1]:
        raise AnnotationError(f"{path} has a mask that lies outside of the frame; draw it again")
    mask[top : top + height, left : left + width] |= part


def _listed(xy: np.ndarray) -> list[list[float]]:
    return [[round(value + 0.5, _DECIMALS) for value in point] for point in xy.tolist()]
