"""How far annotated frames part in what they say of one frame: of all pairs, that which parts the most.

Pairs grow with the square of the annotated frames; none is looked at by itself, so that they cost little beside the
model's answers, which grow with their number.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def of_regions(said: Mask, in_sight: Mask, least: int) -> tuple[float, tuple[int, int]] | None:
    """1 - IoU of what two of A annotated frames say of pixels that both have in sight, the most of all, and the two.

    `said` [A, N] is where each has the object, `in_sight` [A, N] where it has the pixel. None where no two have at
    least so many pixels on the object in sight. Of equals it is the first pair.
    """
    seen = _in_common(in_sight)
    both = _in_common(in_sight & said)
    either = seen - _in_common(in_sight & ~said)
    apart = np.full(both.shape, -1.0)
    enough = np.triu(either >= least, 1)
    apart[enough] = 1 - both[enough] / either[enough]
    one, other = divmod(int(apart.argmax()), len(apart))
    return (float(apart[one, other]), (one, other)) if apart[one, other] >= 0 else None


def _in_common(masks: Mask) -> Floats:
    """[A, A], how many pixels two of the masks [A, N] have in common.

    By OpenCV, in one thread: numpy's product waits for all cores, be they busy or not. Counts up to 2^24 are exact.
    """
    return cv2.mulTransposed(masks.astype(np.float32), aTa=False).astype(np.float64)


def of_points(xy: Floats, hidden: Mask) -> tuple[Floats, npt.NDArray[np.int64]]:
    """[M], pixels between what two of A annotated frames say, the most of all, in the mean over points, and [M, 2], the
    two.

    `xy` [A, P, M, 2] are the places, `hidden` [A, P, M] where they do not count. nan and -1 where no two have a point
    in sight. Of equals it is the first pair.
    """
    length = xy.shape[2]
    told = ~hidden & np.isfinite(xy).all(axis=-1)
    places = np.where(told[..., None], xy, 0)
    most, between = np.full(length, np.nan), np.full((length, 2), -1)
    columns = np.arange(length)
    for one in range(len(xy) - 1):
        common = told[one] & told[one + 1 :]
        step = places[one] - places[one + 1 :]
        apart = np.sqrt(step[..., 0] ** 2 + step[..., 1] ** 2)
        number = common.sum(axis=1)
        mean = np.where(common, apart, 0).sum(axis=1) / np.maximum(number, 1)
        mean[number == 0] = -1
        other = mean.argmax(axis=0)
        mean = mean[other, columns]
        more = (mean >= 0) & ~(mean <= most)
        most[more] = mean[more]
        between[more] = np.column_stack([np.full(length, one), one + 1 + other])[more]
    return most, between
