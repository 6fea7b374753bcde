"""How much of one frame's structure is found in another once motion is undone: near 0 between two scenes.

Structure is what remains of brightness when its local mean and local contrast are divided out: light, exposure and
fades leave it as it is. Motion is dense optical flow, which starts where the frames may lie to each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from decomotion.greys import Grey

SURROUND = 6.0
"""Standard deviation, in pixels, of the neighbourhood whose mean and contrast are divided out."""
SOFTNESS = 0.25
"""Contrast below this share of the frame's stays low: noise in flat places is no structure."""
LEAST_CONTRAST = 1.0
"""In grey levels. A frame of less, black or white, has no structure."""
NONE, AMPLITUDE = 128, 50
"""Level of an image where there is no structure, and what structure adds or takes."""
WINDOW = 6.0
"""Standard deviation, in pixels, of the window of a correlation."""
LEAST_VARIANCE = 25.0
"""A window of less, in levels of an image, has no structure."""
CORRELATED = 0.7
"""Two places are alike from this correlation on."""
ENOUGH = 0.3
"""A likeness that leaves no doubt: the flow is not started elsewhere."""
NUM_FEATURES = 300
"""Of a frame, at most."""
DISTINCT = 0.8
"""A match is nearer than the next best by this factor."""

Flow = npt.NDArray[np.float32]
"""[h, w, 2] as (x, y) in pixels of the structure."""


@dataclass(frozen=True, eq=False)
class StructureImage:
    """Of one frame."""

    image: npt.NDArray[np.uint8]
    """[h, w], around `NONE`."""

    @cached_property
    def features(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """SIFT: places [N, 2] as (x, y) and descriptors [N, 128]."""
        sift = cv2.SIFT.create(NUM_FEATURES, contrastThreshold=0.02)
        keys, descriptors = sift.detectAndCompute(self.image, None)  # pyright: ignore[reportArgumentType, reportCallIssue]
        places = np.array([key.pt for key in keys], np.float32).reshape(-1, 2)
        return places, np.zeros((0, 128), np.float32) if descriptors is None else np.asarray(descriptors, np.float32)


def structure_of(grey: Grey) -> StructureImage | None:
    """Of a frame as `greys.small_grey` makes it; None where it has none."""
    detail = grey - _blurred(grey, SURROUND)
    contrast = float(detail.std())
    if contrast < LEAST_CONTRAST:
        return None
    levels = AMPLITUDE * detail / (np.sqrt(_blurred(detail**2, SURROUND)) + SOFTNESS * contrast)
    return StructureImage(np.clip(NONE + levels, 0, 255).astype(np.uint8))


def likeness(first: StructureImage, second: StructureImage) -> float:
    """The share of `first`'s structure that is in `second`, 0 to 1; both of frames of one size.

    The best of no motion and of flow that starts there, at the frame's shift as a whole, and at matched features.
    """
    share = _share_alike(first.image, second.image)
    for start in (_no_motion, _shift, _matched):
        if share >= ENOUGH:
            break
        share = max(share, _share_alike(first.image, _moved(first, second, start(first, second))))
    return share


def _no_motion(first: StructureImage, _: StructureImage) -> Flow:
    return np.zeros((*first.image.shape, 2), np.float32)


def _shift(first: StructureImage, second: StructureImage) -> Flow:
    """Of the frame as a whole, by phase correlation."""
    window = cv2.createHanningWindow(first.image.shape[::-1], cv2.CV_32F)
    shift, _ = cv2.phaseCorrelate(first.image.astype(np.float32) - NONE, second.image.astype(np.float32) - NONE, window)
    return np.full((*first.image.shape, 2), shift, np.float32)


def _matched(first: StructureImage, second: StructureImage) -> Flow:
    """The affine map that most matches agree on; no motion where there are too few."""
    (places, descriptors), (others, other_descriptors) = first.features, second.features
    if len(places) and len(others) > 1:
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(descriptors, other_descriptors, 2)
        matches = [best for best, next_best in pairs if best.distance < DISTINCT * next_best.distance]
        if len(matches) > 3:
            source = places[[match.queryIdx for match in matches]]
            target = others[[match.trainIdx for match in matches]]
            affine, _ = cv2.estimateAffine2D(source, target, ransacReprojThreshold=3)
            if affine is not None:
                here = _places(first)
                return (here @ affine[:, :2].T + affine[:, 2] - here).astype(np.float32)
    return _no_motion(first, second)


def _moved(first: StructureImage, second: StructureImage, start: Flow) -> npt.NDArray[np.uint8]:
    """`second`'s image brought to where `first` has it."""
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    places = _places(first) + np.asarray(dis.calc(first.image, second.image, start), np.float32)
    return np.asarray(
        cv2.remap(
            second.image,
            places[..., 0],
            places[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(NONE,),
        ),
        np.uint8,
    )


def _places(structure: StructureImage) -> Flow:
    """Of its pixels."""
    height, width = structure.image.shape
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)


def _share_alike(first: npt.NDArray[np.uint8], second: npt.NDArray[np.uint8]) -> float:
    """The share of `first`'s structured pixels around which the two correlate."""
    one, other = (image.astype(np.float32) - NONE for image in (first, second))
    mean, other_mean = _blurred(one, WINDOW), _blurred(other, WINDOW)
    variance = _blurred(one**2, WINDOW) - mean**2
    other_variance = _blurred(other**2, WINDOW) - other_mean**2
    structured = (variance > LEAST_VARIANCE) & (other_variance > LEAST_VARIANCE)
    covariance = _blurred(one * other, WINDOW) - mean * other_mean
    alike = structured & (covariance > CORRELATED * np.sqrt(np.maximum(0, variance * other_variance)))
    return float(alike.sum() / max(1, (variance > LEAST_VARIANCE).sum()))


def _blurred(image: npt.NDArray[np.float32], deviation: float) -> npt.NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), deviation), np.float32)
