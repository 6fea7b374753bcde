"""The outline of an object in its material: a smooth closed curve around the origin, about one unit away from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

ORDERS = np.arange(2, 6)


@dataclass(frozen=True)
class Outline:
    """Radius as a function of the polar angle: 1 + sum over k = 2..5 of amplitude_k cos(k angle + phase_k)."""

    amplitudes: npt.NDArray[np.float64]
    """[4]; their absolute values sum to less than 1."""
    phases: npt.NDArray[np.float64]
    """[4]"""

    @staticmethod
    def draw(rng: np.random.Generator) -> Outline:
        """A random blob."""
        return Outline(rng.uniform(0.4, 1.0, 4) * np.array([0.2, 0.13, 0.06, 0.04]), rng.uniform(0, 2 * np.pi, 4))

    def radius(self, angle: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Distance of the curve from the origin at polar angles [...]."""
        return 1 + np.cos(angle[..., None] * ORDERS + self.phases) @ self.amplitudes

    def slope(self, angle: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Derivative of `radius`."""
        return -np.sin(angle[..., None] * ORDERS + self.phases) @ (self.amplitudes * ORDERS)

    def distance(self, uv: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Signed distance to the curve from material [..., 2]: negative inside, its size of first order."""
        angle = np.arctan2(uv[..., 1], uv[..., 0])
        radius = self.radius(angle)
        return (np.hypot(uv[..., 0], uv[..., 1]) - radius) / np.hypot(1, self.slope(angle) / radius)

    def polygon(self, corners: int = 128) -> npt.NDArray[np.float64]:
        """Points [corners, 2] along the curve."""
        angle = np.linspace(0, 2 * np.pi, corners, endpoint=False)
        return self.radius(angle)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
