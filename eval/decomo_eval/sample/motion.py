"""How a layer moves: a map between its material and the frame at every time, in closed form both ways.

Frame coordinates are (x, y) fractions of the raster, 0..1 across the frame: the centre of pixel i lies at
(i + 0.5) / size. Material coordinates (u, v) are fixed to the layer and have their origin at its middle. Time runs
from 0 at the first frame to 1 at the last, so a clip of any length shows the whole motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Swing:
    """A number in time: mean + slope (time - 1/2) + amplitude sin(2 pi (cycles time + phase))."""

    mean: float = 0.0
    slope: float = 0.0
    amplitude: float = 0.0
    cycles: float = 0.0
    phase: float = 0.0

    def at(self, time: float) -> float:
        """The number at `time`."""
        turn = 2 * math.pi * (self.cycles * time + self.phase)
        return self.mean + self.slope * (time - 0.5) + self.amplitude * math.sin(turn)


@dataclass(frozen=True)
class Warp:
    """Material to frame at one time: a bend of v by u, a wave of u by v, then an affine map.

    Bend and wave each change one coordinate by a function of the other, so both are undone by subtraction.
    """

    bend: float
    """Curvature: v grows by bend u^2."""
    ripple: tuple[float, float, float]
    """Amplitude, angular frequency, phase of the sine of u that is added to v."""
    wave: tuple[float, float, float]
    """The same of the sine of v that is added to u."""
    matrix: npt.NDArray[np.float64]
    """[2, 2], material to frame."""
    centre: npt.NDArray[np.float64]
    """[2], where the bent material's origin lies in the frame."""

    def to_frame(self, uv: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Material [..., 2] to frame [..., 2]."""
        u, v = uv[..., 0], uv[..., 1]
        v = v + self._bent(u)
        u = u + self._waved(v)
        return np.stack([u, v], axis=-1) @ self.matrix.T + self.centre

    def to_material(self, xy: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Frame [..., 2] to material [..., 2]."""
        straight = (xy - self.centre) @ np.linalg.inv(self.matrix).T
        u, v = straight[..., 0], straight[..., 1]
        u = u - self._waved(v)
        v = v - self._bent(u)
        return np.stack([u, v], axis=-1)

    def _bent(self, u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        amplitude, frequency, phase = self.ripple
        return self.bend * u**2 + amplitude * np.sin(frequency * u + phase)

    def _waved(self, v: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        amplitude, frequency, phase = self.wave
        return amplitude * np.sin(frequency * v + phase)


@dataclass(frozen=True)
class Undulation:
    """A sine across the layer whose amplitude and phase change with time."""

    amplitude: Swing = Swing()
    frequency: float = 0.0
    phase: Swing = Swing()

    def at(self, time: float) -> tuple[float, float, float]:
        """Amplitude, angular frequency, phase at `time`."""
        return self.amplitude.at(time), self.frequency, self.phase.at(time)


@dataclass(frozen=True)
class Motion:
    """All that changes with time in a layer's map."""

    x: Swing
    y: Swing
    angle: Swing
    """Radians."""
    log_scale: Swing
    """Logarithm of the frame fractions in one unit of material."""
    stretch: Swing
    """Logarithm by which u grows and v shrinks."""
    shear: Swing = Swing()
    bend: Swing = Swing()
    ripple: Undulation = Undulation()
    wave: Undulation = Undulation()

    def at(self, time: float) -> Warp:
        """The map at `time`."""
        angle, scale, stretch = self.angle.at(time), math.exp(self.log_scale.at(time)), math.exp(self.stretch.at(time))
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        shape = np.array([[stretch, self.shear.at(time)], [0.0, 1 / stretch]])
        return Warp(
            bend=self.bend.at(time),
            ripple=self.ripple.at(time),
            wave=self.wave.at(time),
            matrix=scale * turn @ shape,
            centre=np.array([self.x.at(time), self.y.at(time)]),
        )
