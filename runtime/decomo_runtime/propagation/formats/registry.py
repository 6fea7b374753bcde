"""All formats of annotations, a line for each.

A format is a module of this package with

- `read(path, content, frame, clip) -> Annotation`: what is drawn on `frame`, or, with None, on those that the file
  tells; `AnnotationError` where it does not;
- `write(folder, annotation, frames, clip)`: the shapes of all frames, (frame, shapes) one after another, into a folder
  that is new.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from decomo_runtime.errors import AnnotationError
from decomo_runtime.propagation.formats.asked import ClipFacts
from decomo_runtime.propagation.shapes import Annotation, Shape, Thing

MOST_BYTES = 2**28
"""Of a file that is read."""


@dataclass(frozen=True)
class AnnotationFormat:
    """One format."""

    name: str
    module: str
    """Of this package."""
    ending: str
    purpose: str
    """For help and documentation."""

    def write(
        self, folder: Path, annotation: Annotation, frames: Iterable[tuple[int, list[Shape]]], clip: ClipFacts
    ) -> None:
        """Writes all frames into a new folder."""
        self._module.write(folder, annotation, frames, clip)

    def read(self, path: Path, content: bytes, frame: int | None, clip: ClipFacts) -> Annotation:
        """What is drawn; `AnnotationError` where it is not told."""
        try:
            return self._module.read(path, content, frame, clip)
        except AnnotationError:
            raise
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise AnnotationError(
                f"{path} is not as {self.name} has it ({type(error).__name__}: {error}); give another"
            ) from error

    @property
    def _module(self) -> Any:
        return import_module(f"decomo_runtime.propagation.formats.{self.module}")


PNG = AnnotationFormat("png", "png", ".png", "masks: a pixel's value is its object's number")
COCO = AnnotationFormat("coco", "coco", ".json", "COCO: polygons, masks, boxes, keypoints")
LABELME = AnnotationFormat("labelme", "labelme", ".json", "labelme, X-AnyLabeling: polygons, masks, boxes, points")
CVAT = AnnotationFormat("cvat", "cvat", ".xml", "CVAT for video 1.1: polygons, masks, boxes, points")
LABEL_STUDIO = AnnotationFormat("label-studio", "label_studio", ".json", "Label Studio: polygons, boxes, points")
FORMATS = (PNG, COCO, LABELME, CVAT, LABEL_STUDIO)


def read(sources: Sequence[tuple[Path, int | None]], clip: ClipFacts) -> tuple[Annotation, AnnotationFormat]:
    """All that is drawn in some files, each with the frame that is wanted of it, if any, and their format.

    `AnnotationError` where they are of different formats, or one cannot be read.
    """
    found = [(path, frame, *_content(path)) for path, frame in sources]
    formats = {form.name: form for _, _, _, form in found}
    if len(formats) > 1:
        raise AnnotationError(f"the annotations are of several formats ({', '.join(formats)}); give them in one")
    (form,) = formats.values()
    return _merged([(path, form.read(path, content, frame, clip)) for path, frame, content, _ in found]), form


def _content(path: Path) -> tuple[bytes, AnnotationFormat]:
    try:
        if path.stat().st_size > MOST_BYTES:
            raise AnnotationError(f"{path} is larger than {MOST_BYTES >> 20} MiB; give a part of it")
        content = path.read_bytes()
    except OSError as error:
        raise AnnotationError(f"{path} cannot be read ({error.strerror}); give a file of annotations") from error
    suffix = path.suffix.lower()
    if suffix == ".json":
        return content, _json_format(path, content)
    for each in (PNG, CVAT):
        if suffix == each.ending:
            return content, each
    endings = ", ".join(sorted({each.ending for each in FORMATS}))
    raise AnnotationError(f"{path} is no file of annotations by its ending; give one of {endings}")


def _json_format(path: Path, content: bytes) -> AnnotationFormat:
    try:
        top = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise AnnotationError(f"{path} is not JSON ({error}); give another") from error
    if isinstance(top, dict) and "shapes" in top:
        return LABELME
    if isinstance(top, dict) and {"images", "annotations"} <= top.keys():
        return COCO
    tasks = top if isinstance(top, list) else [top]
    if tasks and all(isinstance(task, dict) and "data" in task for task in tasks):
        return LABEL_STUDIO
    raise AnnotationError(f"{path} is neither COCO's nor labelme's nor Label Studio's JSON; give one of these")


def _merged(read: Sequence[tuple[Path, Annotation]]) -> Annotation:
    """One annotation; objects of one id are one."""
    things: dict[int | str, int] = {}
    known: list[Thing] = []
    shapes: dict[tuple[int, int, str], Shape] = {}
    for path, annotation in read:
        numbers = []
        for thing in annotation.things:
            before = known[things[thing.id]] if thing.id in things else None
            if before is not None and (before.source.get("by_order") or thing.source.get("by_order")):
                raise AnnotationError(
                    f"{path} has several shapes {thing.name!r} that nothing tells apart from frame to frame; give each "
                    "a group_id"
                )
            if thing.id not in things:
                things[thing.id] = len(known)
                known.append(thing)
            numbers.append(things[thing.id])
        for shape in annotation.shapes:
            key = numbers[shape.thing], shape.frame, shape.kind
            if key in shapes:
                raise AnnotationError(
                    f"{path} has {known[key[0]].name!r} a second time in frame {shape.frame}; give it once"
                )
            shapes[key] = replace(shape, thing=numbers[shape.thing])
    first = read[0][1]
    _check_kinds(list(shapes.values()), known)
    return Annotation(first.size, tuple(known), tuple(shapes.values()), first.source)


def _check_kinds(shapes: Sequence[Shape], things: Sequence[Thing]) -> None:
    for number, thing in enumerate(things):
        kinds = {shape.kind for shape in shapes if shape.thing == number and shape.kind.is_region}
        if len(kinds) > 1:
            raise AnnotationError(f"{thing.name!r} is a mask in one frame and a polygon in another; give it as one")
