"""Tracks that the user brings, from any tracker: further correspondences for the pool."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from decomotion.arrays import read_npz
from decomotion.clip import Clip
from decomotion.errors import SupervisionError
from decomotion.tracker_files import KEYS, asked_points, is_tapnet, unpacked

TYPES = {"tracks": np.float32, "occluded": np.bool_, "queries": np.float64, "confidence": np.float32}
"""Our arrays, and what they become."""
QUERY_TOLERANCE = 0.05
"""Median distance between queries and their tracks that is taken for a misunderstanding, in longer sides."""


@dataclass(frozen=True)
class UserTracks:
    """N points through all T frames."""

    xy: npt.NDArray[np.float32]
    """[N, T, 2], pixels of the clip, finite."""
    confidence: npt.NDArray[np.float32]
    """[N, T], in [0, 1]; 0 where the point is hidden or outside the image."""

    def __len__(self) -> int:
        return len(self.xy)

    def points(self, clip: Clip) -> npt.NDArray[np.float32]:
        """[T, N, 2]: where the points are looked at in each frame; those outside, at the nearest pixel inside."""
        return np.clip(self.xy.swapaxes(0, 1), 0, np.array([clip.width - 1, clip.height - 1], np.float32))

    def confidence_from(self, frame: int) -> npt.NDArray[np.float32]:
        """[N, T]: of the links from one frame to each frame; the lesser of both ends', and 0 where either is hidden."""
        return np.minimum(self.confidence[:, frame, None], self.confidence)

    def digest(self) -> str:
        """Hash of the content."""
        return hashlib.sha256(self.xy.tobytes() + self.confidence.tobytes()).hexdigest()


def read_tracks(path: str | Path, clip: Clip) -> UserTracks:
    """The tracks in a `.npz` file, in our layout or another tracker's (`decomotion/tracker_files.py`).

    Raises `SupervisionError` where the file is none, or does not fit the clip.
    """
    where, frames = f"--tracks {path}", len(clip)
    arrays = _typed(_in_clip(_read(Path(path), where), clip, where), where)
    queries = arrays.get("queries")
    tracks = _point_first(arrays["tracks"], 3, frames, f"{where}: tracks")
    if tracks.shape[2] != 2:
        raise SupervisionError(f"{where}: tracks is {list(tracks.shape)}; it must be [N, T, 2], (x, y) in pixels")
    points = len(tracks)
    if not points:
        raise SupervisionError(f"{where} holds no track; leave it out")
    hidden = _point_first(arrays["occluded"], 2, frames, f"{where}: occluded")
    confidence = np.ones(hidden.shape, np.float32)
    if "confidence" in arrays:
        confidence = _point_first(arrays["confidence"], 2, frames, f"{where}: confidence")
        if not ((confidence >= 0) & (confidence <= 1)).all():
            raise SupervisionError(f"{where}: confidence must lie in [0, 1]")
    for name, array in (("occluded", hidden), ("confidence", confidence)):
        if len(array) != points:
            raise SupervisionError(f"{where}: {name} has {len(array)} points but tracks has {points}")
    finite = np.asarray(np.isfinite(tracks).all(axis=-1))
    if not (finite | hidden).all():
        raise SupervisionError(f"{where}: tracks are not finite numbers where occluded says that they are seen")
    if queries is not None:
        _check_starts(queries, tracks, hidden, max(clip.height, clip.width), where)
    middle = np.array([(clip.width - 1) / 2, (clip.height - 1) / 2])
    xy = np.where(finite[..., None], tracks, middle).astype(np.float32)
    seen = ~hidden & ((xy >= -0.5) & (xy <= np.array([clip.width, clip.height]) - 0.5)).all(axis=-1)
    if not seen.any():
        raise SupervisionError(f"{where}: no point is seen inside the {clip.width}x{clip.height} image of any frame")
    return UserTracks(xy, np.where(seen, confidence, 0).astype(np.float32))


def _read(path: Path, where: str) -> dict[str, npt.NDArray]:
    if not path.is_file():
        raise SupervisionError(f"{where} does not exist; give an .npz file")
    arrays = read_npz(path, SupervisionError, {*TYPES, *KEYS, "width", "height"}, remedy="save it with numpy.savez")
    for name, array in arrays.items():
        if array.dtype.kind not in "biuf":
            raise SupervisionError(f"{where}: {name} holds {array.dtype}; it must hold numbers")
    return arrays


def _in_clip(content: dict[str, npt.NDArray], clip: Clip, where: str) -> dict[str, npt.NDArray]:
    """Our arrays, whatever the file's layout, in pixels of the clip."""
    arrays = _unpacked(content, len(clip), where)
    scale = np.array([clip.width, clip.height]) / _size(content, clip, where)
    begin = 0.0 if is_tapnet(content) else -0.5  # where the image begins in the file's pixels

    def placed(xy: npt.NDArray) -> npt.NDArray:
        with np.errstate(over="ignore"):  # what is not finite is found later
            return (xy.astype(np.float64) - begin) * scale - 0.5

    if arrays["tracks"].shape[-1:] == (2,):
        arrays["tracks"] = placed(arrays["tracks"])
    if "queries" in arrays:
        arrays["queries"] = np.column_stack([arrays["queries"][:, 0], placed(arrays["queries"][:, 1:])])
    return arrays


def _unpacked(content: dict[str, npt.NDArray], frames: int, where: str) -> dict[str, npt.NDArray]:
    """Our arrays in the file's pixels: with as many tracks as frames, points first where that can be told.

    Queries are checked against the frames.
    """
    others = unpacked(where, content, SupervisionError)
    if others is not None:
        arrays = {"tracks": others[0], "occluded": others[1]}
        if is_tapnet(content) or "queries" in content:
            arrays["queries"] = asked_points(where, content, SupervisionError)
    else:
        arrays = {name: array for name, array in content.items() if name in TYPES}
        for name in ("tracks", "occluded"):
            if name not in arrays:
                raise SupervisionError(
                    f"{where} has no array {name!r}; it must have 'tracks' and 'occluded', [N, T, …]"
                )
    queries = arrays.get("queries")
    if queries is not None:
        _check_queries(queries, frames, where)
    return arrays if others is not None else _point_first_of_square(arrays, frames, queries)


def _size(content: dict[str, npt.NDArray], clip: Clip, where: str) -> npt.NDArray:
    """(width, height) of the frames that the file's pixels are of: named in it, or the clip's where nobody resizes."""
    sides = [content[name] for name in ("width", "height") if name in content]
    if len(sides) == 2 and all(side.size == 1 and 1 <= side.item() < np.inf for side in sides):
        return np.array([side.item() for side in sides], np.float64)
    if sides:
        raise SupervisionError(f"{where} must hold both width and height, as positive numbers, or neither")
    if is_tapnet(content):
        raise SupervisionError(
            f"{where} is in TAPNet's layout and does not say of which size the frames were that the tracker saw; "
            "save width and height, 256 and 256 for instance, beside query_points"
        )
    return np.array([clip.width, clip.height], np.float64)


def _typed(arrays: dict[str, npt.NDArray], where: str) -> dict[str, npt.NDArray]:
    if not np.isin(arrays["occluded"], (0, 1)).all():
        raise SupervisionError(f"{where}: occluded must be true or false; compare a score with its threshold first")
    with np.errstate(over="ignore"):  # what float32 does not hold is not finite
        return {name: array.astype(TYPES[name]) for name, array in arrays.items()}


def _point_first(array: npt.NDArray, axes: int, frames: int, what: str) -> npt.NDArray:
    """The array with its points first, [N, T, …], whichever order it came in."""
    if array.ndim != axes or frames not in array.shape[:2]:
        order = "[N, T, 2]" if axes == 3 else "[N, T]"
        raise SupervisionError(f"{what} is {list(array.shape)}; it must be {order} with the clip's T = {frames} frames")
    return array if array.shape[1] == frames else array.swapaxes(0, 1)


def _point_first_of_square(
    arrays: dict[str, npt.NDArray], frames: int, queries: npt.NDArray | None
) -> dict[str, npt.NDArray]:
    """As many tracks as frames: the order in which tracks begin nearer to their queries is that of all arrays."""
    tracks, row = arrays["tracks"], np.arange(frames)
    if queries is None or tracks.shape != (frames, frames, 2) or len(queries) != frames:
        return arrays
    frame = queries[:, 0].astype(int)
    if not _median_miss(tracks[frame, row], queries) < _median_miss(tracks[row, frame], queries):
        return arrays
    return {
        name: array if name == "queries" or array.ndim < 2 else array.swapaxes(0, 1) for name, array in arrays.items()
    }


def _median_miss(starts: npt.NDArray, queries: npt.NDArray) -> float:
    """Pixels between queries and where their tracks are in the same frames, of those that are finite."""
    miss = np.linalg.norm(starts - queries[:, 1:], axis=-1)
    miss = miss[np.isfinite(miss)]
    return float(np.median(miss)) if len(miss) else np.inf


def _check_queries(queries: npt.NDArray, frames: int, where: str) -> None:
    if queries.ndim != 2 or queries.shape[1] != 3:
        raise SupervisionError(f"{where}: queries is {list(queries.shape)}; it must be [N, 3], rows of (t, x, y)")
    frame = queries[:, 0]
    if not ((frame >= 0) & (frame < frames) & (frame == np.round(frame))).all():
        raise SupervisionError(f"{where}: queries begin with a frame, a whole number in 0 … {frames - 1}")
    if not np.isfinite(queries).all():
        raise SupervisionError(f"{where}: queries must be finite numbers")


def _check_starts(queries: npt.NDArray, tracks: npt.NDArray, hidden: npt.NDArray, side: int, where: str) -> None:
    if len(queries) != len(tracks):
        raise SupervisionError(f"{where}: queries has {len(queries)} points but tracks has {len(tracks)}")
    row, frame = np.arange(len(queries)), queries[:, 0].astype(int)
    seen = ~hidden[row, frame]
    miss = _median_miss(tracks[row, frame][seen], queries[seen])
    if seen.any() and miss > QUERY_TOLERANCE * side:
        raise SupervisionError(
            f"{where}: tracks lie {miss:.0f} pixels (median) from their own queries; "
            "both must be (x, y) in pixels of the clip, queries with the frame first: (t, x, y)"
        )
