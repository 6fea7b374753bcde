"""Evidence of motion: how badly the camera's motion explains where each point goes.

Frames are compared in pairs. A point's distances from the homography and from epipolar geometry (`cameras.py`) are
multiplied, each to a power: the more of the border only epipolar geometry explains, the more it is believed. A second,
photometric look says whether a point's surroundings change at all when the camera's motion is undone: where they do not
(sky, plain road), a residual is no more than flow gone astray.

Positions and residuals are in units, pixels of a frame whose longer side is 256; see `to_units`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.data.masks.agreement import Agreement
from decomotion.data.masks.cameras import (
    EPIPOLAR_UNITS,
    HOMOGRAPHY_UNITS,
    MIN_VALID,
    NEIGHBOURS,
    Camera,
    Cameras,
    Floats,
    Mask,
    Model,
    neighbours,
    sampson_distance,
    transfer_distance,
)
from decomotion.data.masks.links import Links
from decomotion.data.sampling import bilinear
from decomotion.frames import AnyFrames
from decomotion.units import unit

EPIPOLAR_SCALE = 4.0
"""The Sampson distance sees one direction, and part of it; so many times larger it compares with a transfer error."""
EPIPOLAR_TRUST = ((0.05, 0.25), (0.15, 0.75))
"""(share of the border that only epipolar geometry explains, its exponent), linear in between, constant beyond."""
RESIDUAL_NOISE = 0.05
"""Added to residuals before their logarithm, in units."""
CHANGE_QUANTILE = 0.7
"""A point's photometric change is this quantile over its pairs: a small shift often leaves a surface looking alike."""
CHANGE_WINDOW = 5
"""Side of the window over which colours are compared, in units."""


@dataclass(frozen=True)
class Evidence:
    """What speaks for motion at each point, axes [frame, point]."""

    residual: Floats
    """Distance from the camera's motion, units per square root of the gap; NaN where no pair shows the point."""
    change: Floats
    """Photometric change once the camera's motion is undone, relative to the frame's median; NaN likewise."""
    heard: Floats
    """Where nothing is known of a point: what it does in other frames, 1 moves, -1 does not; otherwise 0."""


def in_units(frame: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """A frame [H, W, 3] resized to the raster of units: its longer side is 256."""
    height, width = frame.shape[:2]
    scale = 1 / unit(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(frame, size, interpolation=how), np.uint8)


def motion_evidence(
    frames: AnyFrames,
    links: Links,
    cameras: Cameras,
    some: Iterable[int],
    progress: bool = False,
    agreement: Agreement | None = None,
) -> Evidence:
    """Compares `some` frames with their neighbours; of the others nothing is told, which is NaN.

    Args:
        frames: [frame, h, w, 3], of which a few are in memory at a time.
        links: of the clip.
        cameras: the camera's motion.
        some: the frames.
        progress: show a progress bar.
        agreement: is told what each pair calls moving.
    """

    @lru_cache(2 * NEIGHBOURS + 1)
    def blurred(frame: int) -> npt.NDArray[np.uint8]:
        return np.asarray(cv2.GaussianBlur(in_units(frames[frame]), (0, 0), 1), np.uint8)

    residual = np.full(links.points.shape[:2], np.nan, np.float32)
    change = np.full(links.points.shape[:2], np.nan, np.float32)
    for frame in tqdm(list(some), "motion", disable=not progress, leave=False):
        source, border = links.points[frame], cameras.borders[frame]
        pairs: dict[int, _Pair] = {}
        for other in neighbours(frame, len(links)):
            camera, visible = cameras.between(frame, other), links.weight(frame, other) > 0
            if camera is not None and visible.sum() >= MIN_VALID:
                pairs[other] = _Pair.of(camera, source, links.target(frame, other), visible)
        if not pairs:
            continue
        trust = epipolar_trust([pair.parallax_share(border) for pair in pairs.values()])
        gaps = [abs(other - frame) ** 0.5 for other in pairs]
        planars = [pair.planar / gap for pair, gap in zip(pairs.values(), gaps, strict=True)]
        epipolars = [pair.epipolar / gap for pair, gap in zip(pairs.values(), gaps, strict=True)]
        planar, epipolar = _median(planars), _median(epipolars)
        residual[frame] = combined(planar, epipolar, trust)
        if agreement is not None:
            each = (combined(*both, trust) for both in zip(planars, epipolars, strict=True))
            agreement.add(frame, dict(zip(pairs, each, strict=True)), border)
        changes = [
            photometric_change(blurred(frame), blurred(other), source, pair.homography) for other, pair in pairs.items()
        ]
        change[frame] = quantile(changes, CHANGE_QUANTILE)
    return Evidence(residual, change, np.zeros_like(change))


@dataclass(frozen=True)
class _Pair:
    """The camera between two frames, and how far each point is from it: [point], units, NaN where it is hidden."""

    homography: Model
    planar: Floats
    epipolar: Floats

    @staticmethod
    def of(camera: Camera, source: Floats, target: Floats, visible: Mask) -> _Pair:
        """Of points that lie at `source` in one frame and at `target` in the other."""
        planar, fundamental = transfer_distance(camera.homography, source, target), camera.fundamental
        epipolar = planar / EPIPOLAR_SCALE if fundamental is None else sampson_distance(fundamental, source, target)
        return _Pair(camera.homography, np.where(visible, planar, np.nan), np.where(visible, epipolar, np.nan))

    def parallax_share(self, border: Mask) -> float:
        """Share of the visible points along the border that epipolar geometry explains and the homography does not."""
        visible = border & ~np.isnan(self.planar)
        only_epipolar = (self.planar > HOMOGRAPHY_UNITS) & (self.epipolar < EPIPOLAR_UNITS)
        return float((visible & only_epipolar).sum() / max(1, visible.sum()))


def epipolar_trust(parallax_shares: Sequence[float]) -> float:
    """Exponent of the epipolar residual, from `_Pair.parallax_share` of a frame's pairs."""
    shares, exponents = zip(*EPIPOLAR_TRUST, strict=True)
    return float(np.interp(np.median(parallax_shares), shares, exponents))


def combined(planar: Floats, epipolar: Floats, trust: float) -> Floats:
    """Weighted geometric mean of both residuals, `trust` the exponent of the epipolar one."""
    first, second = np.log(planar + RESIDUAL_NOISE), np.log(EPIPOLAR_SCALE * epipolar + RESIDUAL_NOISE)
    return np.exp((1 - trust) * first + trust * second)


def photometric_change(
    image: npt.NDArray[np.uint8], other: npt.NDArray[np.uint8], xy: Floats, homography: Model
) -> Floats:
    """How much the surroundings of `xy` [point, 2] change between two images [h, w, 3] along `homography`.

    Mean absolute difference of colours, relative to its median over the image (at least one grey level), [point];
    NaN where the homography leads out of the image.
    """
    height, width = image.shape[:2]
    undone = cv2.warpPerspective(
        other,
        homography,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    difference = cv2.transform(cv2.absdiff(undone, image).astype(np.float32), np.full((1, 3), 1 / 3, np.float32))
    window = cv2.blur(difference, (CHANGE_WINDOW, CHANGE_WINDOW))
    change = bilinear(window, xy)[..., 0]
    x, y = cv2.perspectiveTransform(xy[None], homography)[0].T
    inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    if not inside.any():
        return np.full(len(xy), np.nan, np.float32)
    return np.where(inside, change / max(1.0, float(np.median(change[inside]))), np.nan).astype(np.float32)


def _median(values: Sequence[Floats]) -> Floats:
    return quantile(values, 0.5)


def quantile(values: Sequence[Floats], quantile: float) -> Floats:
    """Over the first axis, between two values the lower; NaN values are left out, NaN where there are no others."""
    ordered = np.sort(np.stack(values), axis=0)  # NaN last
    count = (~np.isnan(ordered)).sum(axis=0)
    place = np.maximum(np.ceil(quantile * count).astype(np.int64) - 1, 0)
    return np.take_along_axis(ordered, place[None], axis=0)[0].astype(np.float32)
