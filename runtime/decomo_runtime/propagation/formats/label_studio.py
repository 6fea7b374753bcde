"""Label Studio: tasks in JSON; places are percent of the image.

Of images, a task each: `polygonlabels`, `rectanglelabels` and `keypointlabels`; their frame is given, or told by the
file names of the clip, before which an upload has eight digits of its own. Of a video: `videorectangle`, whose frames
count from 1. The last annotation of a task counts that was not cancelled; what it says without a place is left alone.
What is written are predictions with a `score`, which Label Studio takes as a start; images are where the first one is.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np

from decomo_runtime.errors import AnnotationError
from decomo_runtime.propagation.formats import asked
from decomo_runtime.propagation.formats.asked import ClipFacts
from decomo_runtime.propagation.outlines import outlines
from decomo_runtime.propagation.shapes import Annotation, Kind, Shape, Thing

FILE = "tasks.json"
VIDEO = "videorectangle"
KINDS = {"polygonlabels": Kind.POLYGON, "rectanglelabels": Kind.BOX, "keypointlabels": Kind.POINTS, VIDEO: Kind.BOX}
PLACELESS = frozenset(
    {"choices", "datetime", "labels", "number", "pairwise", "ranker", "rating", "relation", "taxonomy", "textarea"}
    | {"timelinelabels"}
)
"""Results that say something of an image, or of what is drawn on it, but not where."""
_WORDS = {Kind.POLYGON: "polygonlabels", Kind.BOX: "rectanglelabels", Kind.POINTS: "keypointlabels"}
_FIRST = 1
"""What Label Studio calls the first frame of a video."""
_DECIMALS = 4
_SCORE = "score"


def read(path: Path, content: bytes, frame: int | None, clip: ClipFacts) -> Annotation:
    """What is drawn in the tasks, each of an image or one of a video."""
    top = json.loads(content.decode("utf-8-sig"))
    tasks = top if isinstance(top, list) else [top]
    things: list[Thing] = []
    shapes: list[Shape] = []
    for task in tasks:
        done = [each for each in task.get("annotations") or () if not each.get("was_cancelled")]
        drawn = done or task.get("predictions") or [{"result": []}]
        results = [each for each in drawn[-1]["result"] if each["type"] not in PLACELESS]
        numbers: dict[str, int] = {}
        for entry in results:
            word = entry["type"]
            if word not in KINDS:
                raise AnnotationError(
                    f"{path} has {word}, which are not carried; give {', '.join(KINDS)}, or masks exported as PNG"
                )
            if entry.get("image_rotation"):
                raise AnnotationError(f"{path} is drawn on a turned image, which is not carried; draw it upright")
            asked.same_size(path, entry.get("original_width"), entry.get("original_height"), clip)
            label = _label(entry)
            numbers[label] = numbers.get(label, 0) + 1
            kept = {name: value for name, value in entry.items() if name not in ("value", _SCORE)}
            source = {"result": kept, "labels": _labels(entry)}
            if word == VIDEO:
                things.append(Thing(str(entry["id"]), label, (), source))
                shapes += _of_video(path, entry, len(things) - 1, frame, clip)
                continue
            at = frame if frame is not None and len(tasks) == 1 else _frame(task, path, clip)
            key, known = f"{word} {label} #{numbers[label]}", [thing.id for thing in things]
            if key not in known:
                things.append(Thing(key, label, (), source))
                known.append(key)
            elif sum(_label(other) == label for other in results) > 1:
                raise AnnotationError(
                    f"{path} has several {label!r} that nothing tells apart from image to image; give one image"
                )
            if frame in (None, at):
                shapes.append(_shape(path, entry, known.index(key), at, clip))
    return Annotation(clip.size, tuple(things), tuple(shapes), tasks[0] if tasks else {})


def write(folder: Path, annotation: Annotation, frames: Iterable[tuple[int, list[Shape]]], clip: ClipFacts) -> None:
    """`tasks.json`: a task for each frame, or one of the video."""
    videos = any(thing.source["result"]["type"] == VIDEO for thing in annotation.things)
    tasks = _video_task(annotation, frames, clip) if videos else _image_tasks(annotation, frames, clip)
    (folder / FILE).write_text(json.dumps(tasks, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _image_tasks(
    annotation: Annotation, frames: Iterable[tuple[int, list[Shape]]], clip: ClipFacts
) -> list[dict[str, Any]]:
    name, image = next(iter(annotation.source["data"].items()))
    before, first, behind = _parts(str(image))
    tasks = []
    for frame, shapes in frames:
        file = clip.image(frame)
        image = f"{before}{file if unquote(first) == first else quote(file)}{behind}"
        results = [entry for shape in shapes for entry in _entries(shape, annotation, frame)]
        score = min((shape.confidence for shape in shapes), default=0.0)
        tasks.append({"data": {name: image}, "predictions": [{"result": results, _SCORE: round(score, _DECIMALS)}]})
    return tasks


def _video_task(
    annotation: Annotation, frames: Iterable[tuple[int, list[Shape]]], clip: ClipFacts
) -> list[dict[str, Any]]:
    sequences: list[list[dict[str, Any]]] = [[] for _ in annotation.things]
    least = 1.0
    for frame, shapes in frames:
        there = {shape.thing: shape for shape in shapes}
        for number, sequence in enumerate(sequences):
            if number in there:
                shape = there[number]
                least = min(least, shape.confidence)
                sequence.append({"frame": frame + _FIRST, "enabled": True, **_percent_box(shape.xy, annotation.size)})
            elif sequence:
                sequence[-1]["enabled"] = False  # not shown from the next frame on
    results = [
        thing.source["result"]
        | {"value": {"framesCount": clip.num_frames, "sequence": sequence, "labels": thing.source["labels"]}}
        for thing, sequence in zip(annotation.things, sequences, strict=True)
    ]
    return [{"data": annotation.source["data"], "predictions": [{"result": results, _SCORE: round(least, _DECIMALS)}]}]


def _of_video(path: Path, entry: dict[str, Any], thing: int, frame: int | None, clip: ClipFacts) -> list[Shape]:
    shapes = []
    for each in entry["value"]["sequence"]:
        at = int(each["frame"]) - _FIRST
        if frame in (None, at):
            shapes.append(asked.box(path, thing, at, _corners(each, clip.size), clip))
    return shapes


def _shape(path: Path, entry: dict[str, Any], thing: int, frame: int, clip: ClipFacts) -> Shape:
    value, kind = entry["value"], KINDS[entry["type"]]
    if kind == Kind.BOX:
        return asked.box(path, thing, frame, _corners(value, clip.size), clip)
    if kind == Kind.POLYGON:
        return asked.region(path, thing, frame, [_pixels(value["points"], clip.size)], clip)
    return asked.points(path, thing, frame, _pixels([[value["x"], value["y"]]], clip.size), np.zeros(1, bool), clip)


def _entries(shape: Shape, annotation: Annotation, frame: int) -> list[dict[str, Any]]:
    thing, size = annotation.things[shape.thing], annotation.size
    word = _WORDS[shape.kind]
    kept = thing.source["result"] | {_SCORE: round(shape.confidence, _DECIMALS)}
    if shape.kind == Kind.BOX:
        values = [_percent_box(shape.xy, size)]
    elif shape.kind == Kind.POINTS:
        (x, y), width = _percent(shape.xy, size)[0], thing.source.get("width", 0.5)
        values = [{"x": x, "y": y, "width": width}]
    else:
        polygons = list(shape.polygons) or outlines(shape.mask) if shape.mask is not None else []
        values = [{"points": _percent(each, size), "closed": True} for each in polygons]
    return [
        kept | {"id": f"{shape.thing}-{frame}-{number}", "value": value | {word: thing.source["labels"]}}
        for number, value in enumerate(values)
    ]


def _frame(task: dict[str, Any], path: Path, clip: ClipFacts) -> int:
    """Of a task's image, by its name."""
    name = unquote(_parts(str(next(iter(task["data"].values()), "")))[1])
    own = re.sub(r"^[0-9a-f]{8}-", "", name)
    return clip.frame_of(own if own in clip.files and name not in clip.files else name, path)


def _parts(image: str) -> tuple[str, str, str]:
    """An address in three: what is before the file's name, the name, and what is behind it.

    Of files on the server's own disk, the address is `/data/local-files/?d=FOLDER/NAME`.
    """
    local = re.search(r"[?&]d=", image)
    begin, ends = (0, "?#") if local is None else (local.end(), "&#")
    end = begin + len(re.split(f"[{ends}]", image[begin:])[0])
    name = re.split(r"/|\\|%2F|%5C", image[begin:end], flags=re.IGNORECASE)[-1]
    return image[: end - len(name)], name, image[end:]


def _labels(entry: dict[str, Any]) -> list[str]:
    value = entry["value"]
    return [str(each) for each in value.get("labels", value.get(entry["type"], []))]


def _label(entry: dict[str, Any]) -> str:
    return ", ".join(_labels(entry)) or "object"


def _corners(value: dict[str, Any], size: tuple[int, int]) -> np.ndarray:
    if value.get("rotation"):
        raise ValueError("a box is turned, which is not carried")
    left, top = float(value["x"]), float(value["y"])
    return _pixels([[left, top], [left + float(value["width"]), top + float(value["height"])]], size)


def _pixels(percent: Any, size: tuple[int, int]) -> np.ndarray:
    return np.asarray(percent, np.float64) / 100 * size[::-1] - 0.5


def _percent(xy: np.ndarray, size: tuple[int, int]) -> list[list[float]]:
    return [[round(value, _DECIMALS) for value in point] for point in ((xy + 0.5) / size[::-1] * 100).tolist()]


def _percent_box(xy: np.ndarray, size: tuple[int, int]) -> dict[str, Any]:
    (left, top), (right, bottom) = _percent(xy, size)
    return {
        "x": left,
        "y": top,
        "width": round(right - left, _DECIMALS),
        "height": round(bottom - top, _DECIMALS),
        "rotation": 0,
    }
