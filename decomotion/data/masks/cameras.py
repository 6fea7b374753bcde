"""The camera's motion between two frames, fitted to their links.

It is modelled twice:

- by a homography, which is right for far or planar scenes, and where the camera only turns;
- by epipolar geometry, which is right for any static scene, but blind to motion along the epipolar lines. It is fitted
  to what the homography explains together with a band along the image's border: an object that takes up much of the
  frame must not be mistaken for parallax, and what parallax the scene has shows along the border too.

Positions and distances are in units, pixels of a frame whose longer side is 256; see `to_units`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.data.masks.links import Links

Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
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


@dataclass(frozen=True)
class Camera:
    """Its motion from one frame to another; without epipolar geometry the homography decides alone."""

    homography: Model
    fundamental: Model | None

    @staticmethod
    def fit(source: Floats, target: Floats, weight: Floats, border: Mask, random: np.random.Generator) -> Camera | None:
        """To links from `source` to `target` [point, 2], of which those of some `weight` [point] are seen.

        None where they are too few, or no homography is found.
        """
        seen = weight > 0
        if seen.sum() < MIN_VALID:
            return None
        drawn = draw(by_border(weight, border), random)
        homography = fit_homography(source[drawn], target[drawn])
        if homography is None:
            return None
        planar = transfer_distance(homography, source, target)
        drawn = draw((seen & (border | (planar < HOMOGRAPHY_UNITS))).astype(float), random)
        return Camera(homography, fit_fundamental(source[drawn], target[drawn]))

    def inverse(self) -> Camera:
        """The camera's motion the other way."""
        back = np.linalg.inv(self.homography).astype(np.float64)
        return Camera(back, None if self.fundamental is None else self.fundamental.T)

    def explains(self, source: Floats, target: Floats) -> Mask:
        """Which links its homography explains, [point]."""
        return transfer_distance(self.homography, source, target) < HOMOGRAPHY_UNITS


class Cameras:
    """The camera's motion between every two frames that are compared.

    Args:
        links: of the clip.
        height, width: of a frame in units.
        random: draws the links that the camera's motion is fitted to.
    """

    def __init__(self, links: Links, height: int, width: int, random: np.random.Generator) -> None:
        self._links, self._random = links, random
        self.borders = [near_border(points, height, width) for points in links.points]
        """[point] for each frame: what lies in the band along the border."""
        self._found: dict[tuple[int, int], Camera | None] = {}

    def between(self, frame: int, other: int) -> Camera | None:
        """From `frame` to `other`; None where nothing is known."""
        if (frame, other) not in self._found:
            back = self._found.get((other, frame))
            self._found[frame, other] = (
                Camera.fit(*self._linked(frame, other), self.borders[frame], self._random)
                if back is None
                else back.inverse()
            )
        return self._found[frame, other]

    def pairs(self) -> list[tuple[int, int]]:
        """Between which something is known, the earlier frame first."""
        return [(frame, other) for (frame, other), found in self._found.items() if frame < other and found is not None]

    def forget(self, pair: tuple[int, int]) -> Camera | None:
        """Nothing is known between these frames, the earlier first; what was."""
        former = self._found[pair]
        self._found[pair] = self._found[pair[1], pair[0]] = None
        return former

    def mend(self, pair: tuple[int, int], among: Mask, unlike: Camera | None) -> None:
        """Fits the camera between two frames, the earlier first, to links of some points of the first, [point].

        It is believed where it explains most of them, and is `unlike` a motion that is known not to be the camera's:
        that one explains less than half of these.
        """
        source, target, weight = self._linked(*pair)
        border = self.borders[pair[0]]
        camera = Camera.fit(source, target, weight * among, border, self._random)
        if camera is None:
            return
        explained, weight = camera.explains(source, target), by_border(weight * among, border)
        if not _most(explained, weight):
            return
        if unlike is None or not _most(unlike.explains(source, target), weight * explained):
            self._found[pair], self._found[pair[1], pair[0]] = camera, camera.inverse()

    def _linked(self, frame: int, other: int) -> tuple[Floats, Floats, Floats]:
        """Source, target and weight."""
        return self._links.points[frame], self._links.target(frame, other), self._links.weight(frame, other)


def _most(which: Mask, weight: npt.NDArray[np.float64]) -> bool:
    """Whether more than half of the `weight` [point] lies on `which` [point]."""
    return bool(weight[which].sum() > 0.5 * weight.sum())


def neighbours(frame: int, frames: int) -> list[int]:
    """The other frames, of so many, that `frame` is compared with."""
    first, last = max(0, frame - NEIGHBOURS), min(frames - 1, frame + NEIGHBOURS)
    return [other for other in range(first, last + 1) if other != frame]


def near_border(xy: Floats, height: int, width: int) -> Mask:
    """Which of `xy` [point, 2] lie in the band along the border of an image of `height` x `width`."""
    band = BORDER * max(height, width)
    x, y = xy.T
    return (x < band) | (x > width - 1 - band) | (y < band) | (y > height - 1 - band)


def by_border(weight: Floats, border: Mask) -> npt.NDArray[np.float64]:
    """`weight` [point], lowered where a point is not near the `border` [point]."""
    return np.where(border, 1.0, INTERIOR_WEIGHT).astype(np.float64) * weight


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
