"""What a reader of annotations is told, and a writer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomo_runtime.errors import AnnotationError
from decomo_runtime.propagation.outlines import MOST, box_around, filled
from decomo_runtime.propagation.shapes import Kind, Shape
from decomo_runtime.regions import box_mask


@dataclass(frozen=True)
class ClipFacts:
    """Of the clip that was drawn on."""

    size: tuple[int, int]
    """(height, width)."""
    num_frames: int
    name: str = "clip"
    files: Sequence[str] = ()
    """Names of its frames' files; none of a video, or where they are not known."""

    def image(self, frame: int) -> str:
        """The file name of a frame: its own, else its number."""
        return self.files[frame] if self.files else f"{frame:05d}.png"

    def frame_of(self, image: str, path: Path) -> int:
        """The frame whose file has the name of `image`; `AnnotationError` where that is not told."""
        name = image.replace("\\", "/").rpartition("/")[2]
        if name not in self.files:
            raise AnnotationError(
                f"{path} is drawn on {name or 'an image without a name'}, and which frame that is is not told; give "
                f"{path.name}@T with the frame's number, counted from 0, or --clip with its folder of such files"
            )
        return list(self.files).index(name)


def region(path: Path, thing: int, frame: int, polygons: Sequence[npt.ArrayLike], clip: ClipFacts) -> Shape:
    """A shape of polygons [P, 2]; `AnnotationError` where nothing of them is in the frame."""
    corners = [_checked(path, each, 3) for each in polygons]
    mask = filled(corners, clip.size)
    if not mask.any():
        raise _outside(path, "a polygon", frame, clip)
    return Shape(thing, frame, Kind.POLYGON, mask=mask, polygons=corners)


def masked(path: Path, thing: int, frame: int, mask: npt.NDArray[np.bool_], clip: ClipFacts) -> Shape:
    """A shape of a mask [H, W]; `AnnotationError` where it is of another size, or empty."""
    if mask.shape != clip.size:
        raise AnnotationError(
            f"{path} is of {mask.shape[1]}x{mask.shape[0]} but the clip is {clip.size[1]}x{clip.size[0]}; give one "
            "that was drawn on this clip"
        )
    if not mask.any():
        raise AnnotationError(f"{path} has an empty mask in frame {frame}; leave it out")
    return Shape(thing, frame, Kind.MASK, mask=mask)


def box(path: Path, thing: int, frame: int, corners: npt.ArrayLike, clip: ClipFacts) -> Shape:
    """A shape of two corners [2, 2]; `AnnotationError` where it holds no pixel of the frame."""
    xy = _checked(path, corners, 2)
    xy = np.stack([xy.min(axis=0), xy.max(axis=0)])
    if not box_mask(xy, clip.size).any():
        raise _outside(path, "a box", frame, clip)
    return Shape(thing, frame, Kind.BOX, xy=xy, occluded=np.zeros(2, bool))


def points(
    path: Path, thing: int, frame: int, xy: npt.ArrayLike, occluded: npt.NDArray[np.bool_], clip: ClipFacts
) -> Shape:
    """A shape of points [P, 2], nan where one is not told; `AnnotationError` where one is outside of the frame."""
    places = np.asarray(xy, np.float64).reshape(-1, 2)
    told = places[np.isfinite(places).all(axis=1)]
    if ((told < -0.5) | (told > np.array(clip.size[::-1]) - 0.5)).any():
        raise _outside(path, "a point", frame, clip)
    return Shape(thing, frame, Kind.POINTS, xy=places, occluded=occluded)


def bounds(shape: Shape) -> npt.NDArray[np.float64]:
    """[2, 2], upper left and lower right corner of a shape, the borders of its pixels."""
    if shape.mask is not None:
        return box_around(shape.mask)
    if shape.kind == Kind.BOX:
        return shape.xy
    return np.stack([np.nanmin(shape.xy, axis=0) - 0.5, np.nanmax(shape.xy, axis=0) + 0.5])


def same_size(path: Path, width: object, height: object, clip: ClipFacts) -> None:
    """`AnnotationError` where a file's image is of another size than the clip's frames; None: it does not say."""
    if width is not None and height is not None and (height, width) != clip.size:
        raise AnnotationError(
            f"{path} is of an image of {width}x{height} but the clip is {clip.size[1]}x{clip.size[0]}; give one that "
            "was drawn on this clip"
        )


def _checked(path: Path, corners: npt.ArrayLike, least: int) -> npt.NDArray[np.float64]:
    xy = np.asarray(corners, np.float64)
    if xy.ndim != 2 or xy.shape[1] != 2 or len(xy) < least or not (np.abs(xy) < MOST).all():
        raise AnnotationError(f"{path} has a shape that is no {least} or more corners (x, y) near the frame; mend it")
    return xy


def _outside(path: Path, what: str, frame: int, clip: ClipFacts) -> AnnotationError:
    return AnnotationError(
        f"{path} has {what} in frame {frame} that lies outside of the frame of {clip.size[1]}x{clip.size[0]}; mend it, "
        "or give one that was drawn on this clip"
    )
