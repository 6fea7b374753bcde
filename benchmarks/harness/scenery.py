"""Long procedural clips of any length and frame size, with exact truth, drawn frame by frame: none is held.

The scene, its motion and its camera are those of `decomo-sample` (`eval/decomo_eval/sample`), of which one act is as
long as there the whole clip: the camera travels on, at an act's pace; objects go to and fro in the view, and so does
all else that moves. Beyond its edges, two views apart, the ground is mirrored.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_eval.sample.motion import Motion, Swing, Undulation
from decomo_eval.sample.render import photograph, render_frame, render_layers
from decomo_eval.sample.scene import BACKGROUND, Body, Layer, Scene, draw_scene
from decomo_eval.sample.truth import follow_points
from decomo_runtime import Tracks
from decomo_runtime.pictures import write_video
from harness.records import Record

FPS = 24.0
ACT = 100
"""Frames."""
PROBED = 240
"""Width of the maps of layers from which points are chosen."""
BAND = 64
"""Rows that are drawn at a time."""

Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Scenery:
    """A procedural clip; width is even and no less than height, which is even too."""

    num_frames: int
    width: int
    height: int
    seed: int = 0

    @property
    def name(self) -> str:
        """Of the clip, and of its file."""
        return f"scenery{self.seed}-{self.width}x{self.height}x{self.num_frames}"

    def frames(self) -> Iterator[Image]:
        """The frames [H, W, 3], RGB, in order."""
        noise = np.random.default_rng((self.seed, self.num_frames))
        phase, top = noise.random(), self._top
        for time in self._times:
            bands = [range(row, min(row + BAND, top + self.height)) for row in range(top, top + self.height, BAND)]
            frame = np.concatenate([render_frame(self._scene, time, self.width, rows) for rows in bands])
            yield photograph(frame, time, phase, noise)

    def write(self, folder: Path) -> Path:
        """The clip as H.264, written where it is not there yet."""
        path = folder / f"{self.name}.mp4"
        if not path.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            write_video(path, self.frames(), FPS)
        return path

    def truth(self) -> tuple[npt.NDArray[np.float64], Mask]:
        """Tracks [N, T, 2] in pixels of points on ground and objects, and whether they are occluded [N, T]."""
        maps = np.stack([render_layers(self._scene, time, PROBED) for time in self._times])
        lines = (np.arange(PROBED) + 0.5) * self.width / PROBED
        maps[:, (lines < self._top) | (lines > self._top + self.height)] = -1  # not in the view
        true = follow_points(self._scene, self._times, maps, np.random.default_rng((self.seed, PROBED)))
        xy = true.points * self.width - 0.5 - (0, self._top)
        outside = (xy[..., 1] < -0.5) | (xy[..., 1] >= self.height - 0.5)
        occluded = true.occluded | outside
        known = ~occluded.all(axis=1)
        return xy[known], occluded[known]

    def follow(
        self, queries: npt.NDArray[np.floating], frames: Sequence[int] | None = None
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """Where `queries` [N, 3], (t, x, y) in pixels, are in `frames` [M], by default all, and whether they are hidden
        there: [N, M, 2] and [N, M].
        """
        asked_frames = range(self.num_frames) if frames is None else frames
        top, extent = self._top, np.array([self.width, self.height])
        shape = len(queries), len(asked_frames)
        xy, occluded = np.empty((*shape, 2)), np.ones(shape, bool)
        for t in np.unique(queries[:, 0]).astype(int).tolist():
            rows = np.flatnonzero(queries[:, 0] == t)
            asked = (queries[rows, 1:] + (0.5, 0.5 + top)) / self.width
            owner = self._scene.layer_at(asked, float(self._times[t]))
            for index, layer in enumerate(self._scene.layers):
                own = rows[owner == index]
                material = layer.warp(float(self._times[t])).to_material(asked[owner == index])
                for column, time in enumerate(self._times[list(asked_frames)].tolist()):
                    place = layer.warp(time).to_frame(material)
                    xy[own, column] = place * self.width - 0.5 - (0, top)
                    occluded[own, column] = self._scene.layer_at(place, time) != index
        return xy, occluded | ((xy < -0.5) | (xy >= extent - 0.5)).any(axis=-1)

    def on_object(self, queries: npt.NDArray[np.floating]) -> Mask:
        """[N], whether `queries` [N, 3] lie on an object, and not on the ground."""
        places = (queries[:, 1:] + (0.5, 0.5 + self._top)) / self.width
        found = np.zeros(len(queries), bool)
        for t in np.unique(queries[:, 0]).astype(int).tolist():
            rows = queries[:, 0] == t
            found[rows] = self._scene.layer_at(places[rows], float(self._times[t])) != BACKGROUND
        return found

    def ground(self, xy: npt.NDArray[np.floating], frame: int, other: int) -> npt.NDArray[np.float64]:
        """Where the ground at `xy` [N, 2] of a frame lies in another, in sight or not."""
        layer, corner = self._scene.layers[BACKGROUND], np.array([0.5, 0.5 + self._top])
        material = layer.warp(float(self._times[frame])).to_material((xy + corner) / self.width)
        return layer.warp(float(self._times[other])).to_frame(material) * self.width - corner

    @property
    def _times(self) -> npt.NDArray[np.float64]:
        return np.linspace(0, 1, self.num_frames)

    @property
    def _top(self) -> int:
        """The view is the middle of a square: its first row there."""
        return (self.width - self.height) // 2

    @cached_property
    def _scene(self) -> Scene:
        scene = draw_scene(np.random.default_rng(self.seed), self.width)
        acts, slant = self.num_frames / ACT, self.height / self.width
        return Scene(tuple(_longer(layer, index, acts, slant) for index, layer in enumerate(scene.layers)))


def precision_figures(tracks: Tracks, asked: npt.NDArray[np.integer], xy: npt.NDArray, occluded: Mask) -> Record:
    """Errors in pixels of tracks whose true places are `xy` [N, T, 2] and whose queries lie in frames `asked` [N].

    Of the points in sight, but for the queries themselves; and of those of them that the tracks tell to be in sight.
    """
    counted = ~occluded & (np.arange(occluded.shape[1]) != asked[:, None])
    apart = np.linalg.norm(tracks.xy - xy, axis=-1)
    return {"in_sight": _spread(apart[counted]), "told_in_sight": _spread(apart[counted & ~tracks.occluded])}


def _spread(apart: npt.NDArray[np.floating]) -> Record:
    median, p90 = np.quantile(apart, [0.5, 0.9]) if len(apart) else (np.nan, np.nan)
    return {"points": len(apart), "median": float(median), "p90": float(p90)}


def _longer(layer: Layer, index: int, acts: float, slant: float) -> Layer:
    """A layer that moves through so many acts; objects stay about the view, which is `slant` times as high as wide."""
    motion = layer.body.motion
    longer: dict[str, Any] = {}
    for name, value in vars(motion).items():
        if isinstance(value, Undulation):
            waves = _to_and_fro(value.amplitude, acts), _to_and_fro(value.phase, acts)
            longer[name] = Undulation(waves[0], value.frequency, waves[1])
        else:
            longer[name] = _to_and_fro(value, acts)
    if index == BACKGROUND:
        longer |= {"x": _onward(motion.x, acts), "y": _onward(motion.y, acts)}
    else:
        y, scale = longer["y"], longer["log_scale"]
        longer["y"] = replace(y, mean=0.5 + slant * (y.mean - 0.5), amplitude=slant * y.amplitude)
        longer["log_scale"] = replace(scale, mean=scale.mean + math.log(slant))
    return Layer(Body(Motion(**longer), layer.body.outline), layer.texture)


def _onward(swing: Swing, acts: float) -> Swing:
    """Goes as far in each act as it did in one, from where it was at the beginning."""
    slope = swing.slope * acts
    return Swing(swing.mean - (swing.slope - slope) / 2, slope, swing.amplitude, swing.cycles * acts, swing.phase)


def _to_and_fro(swing: Swing, acts: float) -> Swing:
    """Goes back and forth over what it went one way in one act."""
    return Swing(swing.mean, 0.0, swing.amplitude + swing.slope / 2, (swing.cycles or 0.5) * acts, swing.phase)
