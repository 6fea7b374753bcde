"""Evidence of motion: how badly the camera's motion explains where each point goes.

Frames are compared in pairs. The camera between two frames is modelled twice:

- by a homography, which is right for far or planar scenes, and where the camera only turns;
- by epipolar geometry, which is right for any static scene, but blind to motion along the epipolar lines. It is fitted
  to what the homography explains together with a band along the image's border: an object that takes up much of the
  frame must not be mistaken for parallax, and what parallax the scene has shows along the border too.

The two residuals are multiplied, each to a power: the more of the border only epipolar geometry explains, the more it
is believed. A second, photometric look says whether a point's surroundings change at all when the camera's motion is
undone: where they do not (sky, plain road), a residual is no more than flow gone astray.

Positions and residuals are in units, pixels of a frame whose longer side is 256; see `to_units`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.data.pool import Positions
from decomotion.data.sampling import bilinear
from decomotion.frames import AnyFrames
from decomotion.units import to_units, unit

Floats = npt.NDArray[np.float32]
Model = npt.NDArray[np.float64]
"""3x3."""

NEIGHBOURS = 8
"""Frames are compared with all up to this far away."""
MIN_VALID = 64
"""A pair with fewer visible correspondences says nothing."""
SAMPLE = 1500
"""Models are fitted to at most this many correspondences."""
BORDER = 0.1
"""Width of the band along the border, as a share of the frame's longer side."""
INTERIOR_WEIGHT = 0.3
"""Correspondences outside that band are drawn with this weight: the scene reaches the border, objects rarely do."""
HOMOGRAPHY_UNITS = 1.5
"""Inliers of the homography lie this near, in units."""
SINGULAR = 1e-9
"""Determinant below which a homography has no inverse to speak of."""
EPIPOLAR_UNITS = 0.5
"""Noise scale of MAGSAC for the fundamental matrix, in units; also where a point counts as explained by it."""
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


def in_units(frame: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """A frame [H, W, 3] resized to the raster of units: its longer side is 256."""
    height, width = frame.shape[:2]
    scale = 1 / unit(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(frame, size, interpolation=how), np.uint8)


def motion_evidence(
    frames: AnyFrames,
    points: Floats,
    targets: Positions,
    confidence: npt.NDArray[np.uint8],
    sides: tuple[int, int],
    random: np.random.Generator,
    progress: bool = False,
) -> Evidence:
    """Compares every frame with its neighbours up to `NEIGHBOURS` away.

    Args:
        frames: [frame, h, w, 3], of which a few are in memory at a time.
        points: [frame, point, 2], in units.
        targets: [frame, frame, point, 2] in pixels of the clip, as in the pool.
        confidence: [frame, frame, point], as in the pool; 0 says nothing.
        sides: height and width of the clip.
        random: draws the points that geometry is fitted to.
        progress: show a progress bar.
    """
    count, (height, width) = len(points), in_units(frames[0]).shape[:2]

    @lru_cache(2 * NEIGHBOURS + 1)
    def blurred(frame: int) -> npt.NDArray[np.uint8]:
        return np.asarray(cv2.GaussianBlur(in_units(frames[frame]), (0, 0), 1), np.uint8)

    cameras: dict[tuple[int, int], _Camera | None] = {}
    residual = np.full(points.shape[:2], np.nan, np.float32)
    change = np.full(points.shape[:2], np.nan, np.float32)
    for frame in tqdm(range(count), "motion", disable=not progress, leave=False):
        source, border = points[frame], near_border(points[frame], height, width)
        pairs: dict[int, _Pair] = {}
        for other in neighbours(frame, count):
            target, visible = to_units(targets[frame, other], *sides), confidence[frame, other]
            camera = None if frame < other else inverse(cameras.pop((other, frame)))
            if camera is None:
                camera = _Camera.fit(source, target, visible, border, random)
            if frame < other:
                cameras[frame, other] = camera  # for the way back
            if camera is not None and (visible > 0).sum() >= MIN_VALID:
                pairs[other] = _Pair.of(camera, source, target, visible > 0)
        if not pairs:
            continue
        trust = epipolar_trust([pair.parallax_share(border) for pair in pairs.values()])
        gaps = [abs(other - frame) ** 0.5 for other in pairs]
        planar = _median([pair.planar / gap for pair, gap in zip(pairs.values(), gaps, strict=True)])
        epipolar = _median([pair.epipolar / gap for pair, gap in zip(pairs.values(), gaps, strict=True)])
        residual[frame] = combined(planar, epipolar, trust)
        changes = [
            photometric_change(blurred(frame), blurred(other), source, pair.homography) for other, pair in pairs.items()
        ]
        change[frame] = quantile(changes, CHANGE_QUANTILE)
    return Evidence(residual, change)


def neighbours(frame: int, frames: int) -> list[int]:
    """The other frames, of so many, that `frame` is compared with."""
    first, last = max(0, frame - NEIGHBOURS), min(frames - 1, frame + NEIGHBOURS)
    return [other for other in range(first, last + 1) if other != frame]


@dataclass(frozen=True)
class _Camera:
    """Its motion from one frame to another; without epipolar geometry the homography decides alone."""

    homography: Model
    fundamental: Model | None

    @staticmethod
    def fit(
        source: Floats,
        target: Floats,
        confidence: npt.NDArray[np.uint8],
        border: npt.NDArray[np.bool_],
        random: np.random.Generator,
    ) -> _Camera | None:
        """None where too few points are visible, or no homography is found."""
        visible = confidence > 0
        if visible.sum() < MIN_VALID:
            return None
        drawn = draw(np.where(border, 1.0, INTERIOR_WEIGHT) * (confidence / 255.0), random)
        homography = fit_homography(source[drawn], target[drawn])
        if homography is None:
            return None
        planar = transfer_distance(homography, source, target)
        drawn = draw((visible & (border | (planar < HOMOGRAPHY_UNITS))).astype(float), random)
        return _Camera(homography, fit_fundamental(source[drawn], target[drawn]))


def inverse(camera: _Camera | None) -> _Camera | None:
    """The camera's motion the other way; None where there is none."""
    if camera is None:
        return None
    back = np.linalg.inv(camera.homography).astype(np.float64)
    return _Camera(back, None if camera.fundamental is None else camera.fundamental.T)


@dataclass(frozen=True)
class _Pair:
    """The camera between two frames, and how far each point is from it: [point], units, NaN where it is hidden."""

    homography: Model
    planar: Floats
    epipolar: Floats

    @staticmethod
    def of(camera: _Camera, source: Floats, target: Floats, visible: npt.NDArray[np.bool_]) -> _Pair:
        """Of points that lie at `source` in one frame and at `target` in the other."""
        planar, fundamental = transfer_distance(camera.homography, source, target), camera.fundamental
        epipolar = planar / EPIPOLAR_SCALE if fundamental is None else sampson_distance(fundamental, source, target)
        return _Pair(camera.homography, np.where(visible, planar, np.nan), np.where(visible, epipolar, np.nan))

    def parallax_share(self, border: npt.NDArray[np.bool_]) -> float:
        """Share of the visible points along the border that epipolar geometry explains and the homography does not."""
        visible = border & ~np.isnan(self.planar)
        only_epipolar = (self.planar > HOMOGRAPHY_UNITS) & (self.epipolar < EPIPOLAR_UNITS)
        return float((visible & only_epipolar).sum() / max(1, visible.sum()))


def near_border(xy: Floats, height: int, width: int) -> npt.NDArray[np.bool_]:
    """Which of `xy` [point, 2] lie in the band along the border of an image of `height` x `width`."""
    band = BORDER * max(height, width)
    x, y = xy.T
    return (x < band) | (x > width - 1 - band) | (y < band) | (y > height - 1 - band)


def draw(weight: npt.NDArray[np.float64], random: np.random.Generator) -> npt.NDArray[np.int64]:
    """At most `SAMPLE` indices, without repetition, with probability proportional to `weight` [point].

    By exponential clocks whose rates are the weights: the first to ring are drawn (Efraimidis and Spirakis 2006).
    """
    possible = np.flatnonzero(weight > 0)
    if len(possible) <= SAMPLE:
        return possible
    rings = random.standard_exponential(len(possible)) / weight[possible]
    return possible[np.argpartition(rings, SAMPLE)[:SAMPLE]]


def fit_homography(source: Floats, target: Floats) -> Model | None:
    """Robust homography of points [point, 2]; None where there is none."""
    matrix, _ = cv2.findHomography(source, target, cv2.RANSAC, HOMOGRAPHY_UNITS)
    return None if matrix is None or abs(np.linalg.det(matrix)) < SINGULAR else matrix.astype(np.float64)


def fit_fundamental(source: Floats, target: Floats) -> Model | None:
    """Robust fundamental matrix (MAGSAC++, Barath et al. 2020) of points [point, 2]; None where there is none."""
    try:
        matrix, _ = cv2.findFundamentalMat(
            source.astype(np.float64), target.astype(np.float64), cv2.USAC_MAGSAC, EPIPOLAR_UNITS, 0.999, 500
        )
    except cv2.error:  # OpenCV's USAC fails so where no sample gives a model, as when nothing moves at all
        return None
    return matrix.astype(np.float64) if matrix is not None and matrix.shape == (3, 3) else None


def transfer_distance(homography: Model, source: Floats, target: Floats) -> Floats:
    """Distance of `target` to where the homography leads from `source`, [point]."""
    x, y = (cv2.perspectiveTransform(source[None], homography)[0] - target).T
    return np.sqrt(x * x + y * y)


def sampson_distance(fundamental: Model, source: Floats, target: Floats) -> Floats:
    """First-order distance of correspondences to epipolar geometry, [point] (Hartley and Zisserman 2004, 11.4.3)."""
    first, second = cv2.convertPointsToHomogeneous(source)[:, 0], cv2.convertPointsToHomogeneous(target)[:, 0]
    line, line_back = first @ fundamental.T, second @ fundamental
    gradient = (line[:, :2] ** 2).sum(-1) + (line_back[:, :2] ** 2).sum(-1)
    return (np.abs((second * line).sum(-1)) / np.sqrt(gradient + 1e-12)).astype(np.float32)


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
