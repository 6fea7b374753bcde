"""From evidence of motion to labels: moving or not, smooth along the motion and with the edges of the image.

The evidence of a point is averaged along its links to the frames around. Labels are then the mean field of a random
field over the points of each frame: a unary term from the evidence, and a pairwise term that prefers equal labels
between neighbours of similar colour. What moves in one part of the clip may stand in another: a second field hears what
the first found at the same place of the thing in frames far away.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import numpy.typing as npt

from decomotion.data.masks.cameras import NEIGHBOURS
from decomotion.data.masks.evidence import RESIDUAL_NOISE, Evidence
from decomotion.data.masks.links import Links

Floats = npt.NDArray[np.float32]

SMOOTHED = 4
"""Evidence is averaged along links over frames up to this far away."""
CARRIED = range(4, 29, 4)
"""Labels are heard from frames so far away."""
CARRIED_WEIGHT = 2.0
"""Log-odds from the labels of those frames, where they agree."""
RESIDUAL_UNITS = 1.0
"""Least threshold: residual per square root of the gap, in units, below which nothing counts as moving."""
CHANGE_RANGE = (1.0, 3.0)
"""A photometric change up to the first voids the evidence for motion; from the second on it counts in full."""
EVIDENCE_GAIN = 1.5
"""Log-odds of moving for a residual e times the threshold."""
EVIDENCE_LIMIT = 3.0
"""Largest log-odds that a point's own evidence gives."""
SPATIAL_WEIGHT = 2.0
"""Log-odds from one neighbour of like colour."""
ITERATIONS = 20
DAMPING = 0.5

STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows and columns to half of the eight neighbours."""


def moving_probability(evidence: Evidence, lab: Floats, links: Links) -> Floats:
    """Probability that each point moves, [frame, point].

    Args:
        evidence: of all points.
        lab: [frame, point, 3], colours in a space where distances are perceptual.
        links: between the same points.
    """
    near = range(-SMOOTHED, SMOOTHED + 1)
    log_residual = along_links(np.log(evidence.residual + RESIDUAL_NOISE), links, near)
    log_change = along_links(np.log(evidence.change + RESIDUAL_NOISE), links, near)
    own = log_odds(np.exp(log_residual), np.exp(log_change))
    unary = (own + EVIDENCE_LIMIT * evidence.heard).astype(np.float32)
    first = mean_field(unary, lab, links.grid)
    far = [sign * gap for gap in CARRIED for sign in (1, -1)]
    far_away = np.nan_to_num(along_links(2 * first - 1, links, far, doubt=1.0))
    return mean_field((unary + CARRIED_WEIGHT * far_away).astype(np.float32), lab, links.grid)


def along_links(values: Floats, links: Links, gaps: Iterable[int], doubt: float = 0.0) -> Floats:
    """Means of `values` [frame, point] of the frames so far away, along links and by confidence; NaN says nothing.

    `doubt` counts as so many links to a 0.
    """
    frames, gaps = len(values), list(gaps)
    known = ~np.isnan(values)
    with_known = np.stack([np.where(known, values, 0), known], axis=-1).astype(np.float32)
    result = np.full(values.shape, np.nan, np.float32)
    for frame in range(frames):
        total = np.zeros_like(with_known[0])
        for other in (frame + gap for gap in gaps if 0 <= frame + gap < frames):
            total += links.weight(frame, other)[:, None] * links.read(with_known[other], frame, other)
        value, weight = total.T
        seen = weight > 1e-3
        result[frame, seen] = value[seen] / (weight[seen] + doubt)
    return result


def log_odds(residual: Floats, change: Floats) -> Floats:
    """Log-odds of moving from the evidence alone, [frame, point]; 0 where there is none."""
    known = ~np.isnan(residual)
    ratio = (np.where(known, residual, 1) + RESIDUAL_NOISE) / thresholds(residual)[:, None]
    odds = np.where(known, np.clip(EVIDENCE_GAIN * np.log(ratio), -EVIDENCE_LIMIT, EVIDENCE_LIMIT), 0)
    believed = np.interp(np.nan_to_num(change), CHANGE_RANGE, (0, 1))
    return np.where(odds > 0, odds * believed, odds).astype(np.float32)


def thresholds(residual: Floats) -> Floats:
    """What a residual [frame, point] must pass to speak for motion, [frame].

    Otsu's threshold of the clip, or of the frames around where that is lower: what moves fast elsewhere says nothing
    about what moves slowly here.
    """
    known = np.sqrt(residual)  # the noise of a residual grows with it
    ranges = (slice(max(0, frame - NEIGHBOURS), frame + NEIGHBOURS + 1) for frame in range(len(residual)))
    around = [otsu(known[some][~np.isnan(known[some])]) ** 2 for some in ranges]
    return np.clip(around, RESIDUAL_UNITS, max(RESIDUAL_UNITS, otsu(known[~np.isnan(known)]) ** 2)).astype(np.float32)


def otsu(values: Floats) -> float:
    """The threshold that divides `values` [n] into two classes of largest variance between them (Otsu 1979)."""
    if len(values) < 2:
        return 0.0
    ordered = np.sort(values).astype(np.float64)
    sums, below = np.cumsum(ordered), np.arange(1, len(ordered))
    above = len(ordered) - below
    gap = (sums[-1] - sums[:-1]) / above - sums[:-1] / below
    last = (below * above * gap**2).argmax()
    return float(ordered[last : last + 2].mean())


def mean_field(unary: Floats, lab: Floats, grid: tuple[int, int]) -> Floats:
    """Damped mean field of a binary random field whose pairwise terms soften where colours differ, [frame, point].

    Args:
        unary: [frame, point], log-odds.
        lab: [frame, point, 3].
        grid: rows and columns of the points of a frame.
    """
    frames = len(unary)
    edges = list(_edges(lab.reshape(frames, *grid, 3)))
    probability = sigmoid(unary)
    for _ in range(ITERATIONS):
        odds = unary.copy()
        spin, received = (2 * probability - 1).reshape(frames, *grid), odds.reshape(frames, *grid)
        for first, second, weight in edges:
            received[first] += SPATIAL_WEIGHT * weight * spin[second]
            received[second] += SPATIAL_WEIGHT * weight * spin[first]
        probability = DAMPING * probability + (1 - DAMPING) * sigmoid(odds)
    return probability.astype(np.float32)


Window = tuple[slice, slice, slice]


def _edges(image: Floats) -> Iterator[tuple[Window, Window, Floats]]:
    """Pairs of windows of [frame, row, column, 3] and the weight of the edges between them, near 0 across a contour.

    The contrast-sensitive weight of Boykov and Jolly 2001, its scale the mean squared difference of neighbours.
    """
    rows, columns = image.shape[1:3]
    found = []
    for down, right in STEPS:
        first = (slice(None), slice(0, rows - down), slice(max(0, -right), columns - max(0, right)))
        second = (slice(None), slice(down, rows), slice(max(0, right), columns - max(0, -right)))
        found.append((first, second, ((image[first] - image[second]) ** 2).sum(-1), np.hypot(down, right)))
    scale = 2 * np.mean([squared.mean() for _, _, squared, _ in found if squared.size]) + 1e-6
    for first, second, squared, length in found:
        yield first, second, (np.exp(-squared / scale) / length).astype(np.float32)


def sigmoid(odds: Floats) -> Floats:
    """Probabilities of log-odds."""
    return (1 / (1 + np.exp(-odds))).astype(np.float32)
