"""CVAT for video 1.1: an XML file with a track for each object. Corners begin at a pixel's border.

What CVAT has interpolated between keyframes is not read: the model does that. Every frame that is written is a
keyframe; where an object has no place, or one of its points has none, it is `outside`. A polygon has one part, the
largest. CVAT has no room for a confidence.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from decomo_runtime.errors import AnnotationError
from decomo_runtime.propagation.formats import asked
from decomo_runtime.propagation.formats.asked import ClipFacts
from decomo_runtime.propagation.outlines import box_around, outlines
from decomo_runtime.propagation.shapes import Annotation, Kind, Mask, Shape, Thing

FILE = "annotations.xml"
KINDS = {"polygon": Kind.POLYGON, "box": Kind.BOX, "points": Kind.POINTS, "mask": Kind.MASK}
_WORDS = {kind: word for word, kind in KINDS.items()}


def read(path: Path, content: bytes, frame: int | None, clip: ClipFacts) -> Annotation:
    """The keyframes of all tracks, or of those that are in `frame`."""
    if re.search(rb"<!(DOCTYPE|ENTITY)", content):
        raise AnnotationError(f"{path} declares entities, which CVAT does not; give CVAT's own file")
    try:
        top = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise AnnotationError(f"{path} is not XML ({error}); give CVAT's annotations.xml") from error
    if top.tag != "annotations" or top.find("image") is not None:
        raise AnnotationError(f"{path} is not of CVAT for video; export the task as 'CVAT for video 1.1'")
    size = top.find(".//original_size")
    if size is not None:
        width, height = (int(size.findtext(side, "0")) for side in ("width", "height"))
        asked.same_size(path, width, height, clip)
    things, shapes = [], []
    for number, track in enumerate(top.iter("track")):
        kept = dict(track.attrib)
        thing = Thing(kept.get("id", str(number)), kept.get("label", ""), (), {"track": kept})
        mine: list[Shape] = []
        for entry in track:
            keyed = entry.get("keyframe", "1") == "1" and entry.get("outside", "0") == "0"
            at = int(entry.get("frame", "0"))
            if keyed and frame in (None, at):
                mine.append(_shape(path, entry, len(things), at, clip))
        if mine:
            things.append(thing)
            shapes += mine
    return Annotation(clip.size, tuple(things), tuple(shapes), top.find("meta"))


def write(folder: Path, annotation: Annotation, frames: Iterable[tuple[int, list[Shape]]], _: ClipFacts) -> None:
    """`annotations.xml`."""
    top = Element("annotations")
    ElementTree.SubElement(top, "version").text = "1.1"
    if annotation.source is not None:
        top.append(annotation.source)
    tracks = [ElementTree.SubElement(top, "track", thing.source["track"]) for thing in annotation.things]
    for frame, shapes in frames:
        there = {shape.thing: shape for shape in shapes if np.isfinite(shape.xy).all()}
        for number, track in enumerate(tracks):
            if number in there:
                track.append(_entry(there[number], frame))
            elif len(track) and track[-1].get("outside") == "0":
                gone = Element(track[-1].tag, track[-1].attrib | {"frame": str(frame), "outside": "1"})
                track.append(gone)
    ElementTree.indent(top)
    ElementTree.ElementTree(top).write(folder / FILE, encoding="utf-8", xml_declaration=True)


def _shape(path: Path, entry: Element, thing: int, frame: int, clip: ClipFacts) -> Shape:
    if entry.tag not in KINDS:
        raise AnnotationError(f"{path} has a {entry.tag}, which is not carried; draw a {', '.join(KINDS)}")
    kind = KINDS[entry.tag]
    if kind == Kind.MASK:
        return asked.masked(path, thing, frame, _decoded(path, entry, clip), clip)
    if kind == Kind.BOX:
        if float(entry.get("rotation", 0)):
            raise AnnotationError(f"{path} has a box that is turned, which is not carried; draw a polygon")
        corners = [[float(entry.attrib[x]), float(entry.attrib[y])] for x, y in (("xtl", "ytl"), ("xbr", "ybr"))]
        return asked.box(path, thing, frame, np.array(corners) - 0.5, clip)
    xy = np.array([[float(each) for each in pair.split(",")] for pair in entry.attrib["points"].split(";")]) - 0.5
    if kind == Kind.POLYGON:
        return asked.region(path, thing, frame, [xy], clip)
    hidden = np.full(len(xy), entry.get("occluded") == "1")
    return asked.points(path, thing, frame, xy, hidden, clip)


def _entry(shape: Shape, frame: int) -> Element:
    hidden = bool(shape.occluded.all()) if shape.kind == Kind.POINTS else False
    about = {"frame": str(frame), "keyframe": "1", "outside": "0", "occluded": str(int(hidden)), "z_order": "0"}
    if shape.kind == Kind.BOX:
        corners = (shape.xy + 0.5).ravel()
        about |= {name: f"{value:.2f}" for name, value in zip(("xtl", "ytl", "xbr", "ybr"), corners, strict=True)}
    elif shape.mask is not None and shape.kind == Kind.MASK:
        about |= _encoded(shape.mask)
    else:
        xy = shape.xy if shape.mask is None else (list(shape.polygons) or outlines(shape.mask))[0]
        about["points"] = ";".join(f"{x + 0.5:.2f},{y + 0.5:.2f}" for x, y in xy)
    return Element(_WORDS[shape.kind], about)


def _encoded(mask: Mask) -> dict[str, str]:
    """Run lengths, row by row within the box around it, of nothing first."""
    (left, top), (right, bottom) = np.rint(box_around(mask) + 0.5).astype(int).tolist()
    flat = mask[top:bottom, left:right].ravel()
    ends = np.flatnonzero(np.concatenate([[flat[0]], flat[1:] != flat[:-1]]))
    runs = np.diff(np.concatenate([[0], ends, [flat.size]]))
    place = {"left": left, "top": top, "width": right - left, "height": bottom - top}
    return {"rle": ", ".join(map(str, runs.tolist()))} | {name: str(value) for name, value in place.items()}


def _decoded(path: Path, entry: Element, clip: ClipFacts) -> Mask:
    left, top, width, height = (int(float(entry.attrib[name])) for name in ("left", "top", "width", "height"))
    runs = np.array([int(each) for each in entry.attrib["rle"].split(",")], np.int64)
    rows, columns = clip.size
    if left < 0 or top < 0 or left + width > columns or top + height > rows:
        raise AnnotationError(f"{path} has a mask that lies outside of the frame; mend it")
    if (runs < 0).any() or runs.sum() != width * height:
        raise ValueError("run lengths that are not of their size")
    mask = np.zeros(clip.size, bool)
    within = np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(height, width)
    mask[top : top + height, left : left + width] = within
    return mask
