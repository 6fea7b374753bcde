"""Strain, rotation and change of area out of the deformation gradient F, as continuum mechanics defines them.

F maps a small step dX in the reference frame to the step F dX in another one; x goes right and y down. With the polar
decomposition F = R U, R a rotation:

    green_lagrange  E = (F^T F - I) / 2, exact at any deformation and blind to rotation
    small           (F + F^T) / 2 - I, the small-strain tensor: right where strain and rotation are small
    principal       eigenvalues of E, the larger first, and the direction of the first in the reference frame
    rotation        the angle of R, from x towards y: clockwise as seen
    area_change     det F - 1
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Strain:
    """Of deformation gradients of any shape [...]; nan where F is, or where it folds (det F <= 0)."""

    green_lagrange: Floats
    """[..., 3]: xx, yy, xy (the tensor's, half of the engineering shear)."""
    small: Floats
    """[..., 3]: xx, yy, xy."""
    principal: Floats
    """[..., 2], of E, the larger first."""
    direction: Floats
    """[...], degrees from x towards y, from -90 to 90: of the first principal strain, in the reference frame."""
    rotation: Floats
    """[...], degrees from x towards y."""
    area_change: Floats
    """[...], share: 0.1 is a tenth more."""


def strain_of(gradient: Floats) -> Strain:
    """Of deformation gradients [..., 2, 2]."""
    determinant = gradient[..., 0, 0] * gradient[..., 1, 1] - gradient[..., 0, 1] * gradient[..., 1, 0]
    valid = np.isfinite(determinant) & (determinant > 0)
    f = np.where(valid[..., None, None], gradient, np.nan)
    green = _parts((f.swapaxes(-1, -2) @ f - np.eye(2)) / 2)
    small = _parts((f + f.swapaxes(-1, -2)) / 2 - np.eye(2))
    mean, half, shear = (green[..., 0] + green[..., 1]) / 2, (green[..., 0] - green[..., 1]) / 2, green[..., 2]
    radius = np.hypot(half, shear)
    return Strain(
        green,
        small,
        np.stack([mean + radius, mean - radius], axis=-1),
        np.degrees(np.arctan2(shear, half) / 2),
        np.degrees(np.arctan2(f[..., 1, 0] - f[..., 0, 1], f[..., 0, 0] + f[..., 1, 1])),
        np.where(valid, determinant - 1, np.nan),
    )


def _parts(tensor: Floats) -> Floats:
    """[..., 2, 2], symmetric, as [..., 3]."""
    return np.stack([tensor[..., 0, 0], tensor[..., 1, 1], tensor[..., 0, 1]], axis=-1)
