"""A scene: one background under a moving camera and two to four objects, drawn from a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from decomo_eval.sample.motion import Motion, Swing, Undulation, Warp
from decomo_eval.sample.outline import Outline
from decomo_eval.sample.texture import Image, Texture, draw_grain, draw_ground, draw_skin

BACKGROUND = 0
GROUND_EXTENT = 1.0
"""Half the width of the background's texture, in frames: what pan, zoom and rotation can bring into view."""
SKIN_EXTENT = 1.55
"""Half the width of an object's texture, in units of its radius: a little more than its outline reaches."""
SHADE = 0.45
"""How much darker an object is at its outline than in its middle."""
REFERENCE_SIZE = 256
"""Textures are drawn finely enough for this frame size at least."""
FINEST_SIZE = 1024
"""Textures are drawn finely enough for this frame size at most; what larger frames show beyond is grain."""
PROBE_TIMES = np.linspace(0, 1, 13)


@dataclass(frozen=True)
class Body:
    """The geometry of a layer."""

    motion: Motion
    outline: Outline | None
    """None: the layer is everywhere."""

    def covers(self, xy: npt.NDArray[np.float64], time: float) -> npt.NDArray[np.bool_]:
        """Whether the layer lies at frame positions [..., 2]."""
        if self.outline is None:
            return np.ones(xy.shape[:-1], bool)
        return self.outline.distance(self.motion.at(time).to_material(xy)) < 0


@dataclass(frozen=True)
class Layer:
    """A body and its colours."""

    body: Body
    texture: Texture

    def warp(self, time: float) -> Warp:
        """Its map between material and frame at `time`."""
        return self.body.motion.at(time)


@dataclass(frozen=True)
class Scene:
    """Layers from back to front; the first is the background."""

    layers: tuple[Layer, ...]

    def layer_at(self, xy: npt.NDArray[np.float64], time: float) -> npt.NDArray[np.int64]:
        """Index [...] of the frontmost layer at frame positions [..., 2], inside the frame or not."""
        front = np.zeros(xy.shape[:-1], np.int64)
        for index, layer in enumerate(self.layers):
            front[layer.body.covers(xy, time)] = index
        return front


def draw_scene(rng: np.random.Generator, size: int) -> Scene:
    """A random scene; `size` of the frames decides how fine its textures are, not its geometry."""
    bodies_rng, *texture_rngs = rng.spawn(6)
    bodies = draw_bodies(bodies_rng)
    detail = min(max(size, REFERENCE_SIZE), FINEST_SIZE)
    hue = bodies_rng.random()
    layers = []
    for index, (body, texture_rng) in enumerate(zip([_draw_camera(bodies_rng), *bodies], texture_rngs, strict=False)):
        if index == BACKGROUND:
            # two texels to a pixel, and noise down to three pixels a cycle: about as fine as the frame can show
            width = 2 * GROUND_EXTENT * detail
            texture = draw_ground(texture_rng, round(2 * width), GROUND_EXTENT, width / 3, hue)
        else:
            width = 2 * SKIN_EXTENT * math.exp(body.motion.log_scale.mean) * detail
            object_hue = hue + 0.25 + 0.618 * index
            skin = draw_skin(texture_rng, round(2 * width), SKIN_EXTENT, width / 3, object_hue)
            texture = _shaded(skin, body)
        if size > detail:
            pixel = math.exp(-body.motion.log_scale.mean) / size
            texture = replace(texture, grain=draw_grain(texture_rng, pixel, math.log2(size / detail)))
        layers.append(Layer(body, texture))
    return Scene(tuple(layers))


def draw_bodies(rng: np.random.Generator) -> list[Body]:
    """Two to four objects, drawn again until the clip has what a tracker should be tried on (`is_eventful`)."""
    count = int(rng.integers(2, 5))
    while True:
        bodies = _draw_crossing(rng, count)
        if is_eventful(bodies):
            return bodies


def is_eventful(bodies: list[Body]) -> bool:
    """Whether two objects meet and part, one leaves the frame at least by half, and each is well seen on the whole."""
    share_inside, share_seen, overlap = _probe(bodies)
    meets = any(
        overlap[:, a, b].max() > 0.3 and overlap[:, a, b].min() < 0.02 for a, b in combinations(range(len(bodies)), 2)
    )
    leaves = ((share_inside.min(axis=0) < 0.4) & (share_inside.max(axis=0) > 0.95)).any()
    return bool(meets and leaves and share_seen.mean(axis=0).min() > 0.5)


def _probe(bodies: list[Body]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Shares of each body's material: [time, body] in the frame, [time, body] seen, [time, a, b] of a under b."""
    grid = np.stack(np.meshgrid(*[np.linspace(-1.4, 1.4, 11)] * 2), axis=-1).reshape(-1, 2)
    shape = (len(PROBE_TIMES), len(bodies))
    inside, seen, overlap = np.zeros(shape), np.zeros(shape), np.zeros((*shape, len(bodies)))
    for moment, time in enumerate(PROBE_TIMES):
        for a, body in enumerate(bodies):
            assert body.outline is not None
            xy = body.motion.at(time).to_frame(grid[body.outline.distance(grid) < 0])
            in_frame = ((xy > 0) & (xy < 1)).all(axis=-1)
            free = in_frame.copy()
            for b in range(a + 1, len(bodies)):
                covered = bodies[b].covers(xy, time) & in_frame
                overlap[moment, a, b] = covered.mean()
                free &= ~covered
            inside[moment, a], seen[moment, a] = in_frame.mean(), free.mean()
    return inside, seen, overlap


def _draw_crossing(rng: np.random.Generator, count: int) -> list[Body]:
    """Objects of which two pass near one place at one time, in different directions, in random depth order."""
    time, place, heading = rng.uniform(0.25, 0.75), rng.uniform(0.25, 0.75, 2), rng.uniform(0, 2 * np.pi)
    bodies = []
    for index in range(count):
        if index >= 2:
            time, place, heading = rng.uniform(0.1, 0.9), rng.uniform(0.1, 0.9, 2), rng.uniform(0, 2 * np.pi)
        else:
            place, heading = place + rng.uniform(-0.06, 0.06, 2), heading + rng.uniform(0.6, 1.4) * np.pi
        bodies.append(_draw_object(rng, time, place, heading))
    return [bodies[index] for index in rng.permutation(count)]


def _draw_object(rng: np.random.Generator, time: float, place: npt.NDArray[np.float64], heading: float) -> Body:
    """An object that passes about `place` at `time`; it turns, breathes, bends and ripples on its way."""
    speed = rng.uniform(0.28, 0.5)
    velocity = speed * np.array([np.cos(heading), np.sin(heading)])
    x, y = place + velocity * (0.5 - time)
    radius = rng.uniform(0.13, 0.19)
    motion = Motion(
        x=Swing(x, velocity[0], *_swing(rng, 0.02, 0.05)),
        y=Swing(y, velocity[1], *_swing(rng, 0.02, 0.05)),
        angle=Swing(rng.uniform(0, 2 * np.pi), rng.uniform(-0.7, 0.7), *_swing(rng, 0.05, 0.2)),
        log_scale=Swing(math.log(radius), rng.uniform(-0.15, 0.15), *_swing(rng, 0.02, 0.08)),
        stretch=Swing(rng.uniform(-0.1, 0.1), 0.0, *_swing(rng, 0.05, 0.12)),
        shear=Swing(0.0, 0.0, *_swing(rng, 0.0, 0.1)),
        bend=Swing(rng.uniform(-0.1, 0.1), 0.0, *_swing(rng, 0.12, 0.3)),
        ripple=_draw_undulation(rng),
        wave=_draw_undulation(rng),
    )
    return Body(motion, Outline.draw(rng))


def _draw_undulation(rng: np.random.Generator) -> Undulation:
    """A wave that runs along an object; amplitude times frequency, its steepest shear, stays below 0.45."""
    frequency = rng.uniform(1.5, 3.5)
    amplitude = Swing(rng.uniform(0.05, 0.3) / frequency, 0.0, rng.uniform(0, 0.15) / frequency, rng.uniform(0.4, 0.9))
    return Undulation(amplitude, frequency, Swing(rng.uniform(0, 2 * np.pi), rng.uniform(-4.0, 4.0)))


def _swing(rng: np.random.Generator, low: float, high: float) -> tuple[float, float, float]:
    """Amplitude, cycles, phase."""
    return rng.uniform(low, high), rng.uniform(0.4, 0.9), rng.random()


def _draw_camera(rng: np.random.Generator) -> Body:
    """The background as a panning, turning, zooming camera sees it; rows move unequally, as ground seen at a slant."""
    heading, pan = rng.uniform(0, 2 * np.pi), rng.uniform(0.12, 0.3)
    parallax = Swing(0.0, rng.uniform(0.02, 0.05) * rng.choice([-1, 1]))
    motion = Motion(
        x=Swing(0.5, pan * math.cos(heading), *_swing(rng, 0.005, 0.02)),
        y=Swing(0.5, pan * math.sin(heading), *_swing(rng, 0.005, 0.02)),
        angle=Swing(rng.uniform(0, 2 * np.pi), rng.uniform(-0.12, 0.12), *_swing(rng, 0.005, 0.02)),
        log_scale=Swing(0.05, rng.uniform(-0.1, 0.1), *_swing(rng, 0.0, 0.01)),
        stretch=Swing(),
        shear=Swing(0.0, rng.uniform(-0.03, 0.03)),
        wave=Undulation(parallax, rng.uniform(1.5, 2.5), Swing(rng.uniform(0, 2 * np.pi))),
    )
    return Body(motion, None)


def _shaded(skin: Texture, body: Body) -> Texture:
    """The texture darkened towards the outline, as a round body is."""
    assert body.outline is not None
    texel = (np.arange(len(skin.image)) + 0.5) / len(skin.image) * 2 - 1
    uv = skin.extent * np.stack(np.meshgrid(texel, texel), axis=-1)
    reach = np.clip(1 + body.outline.distance(uv), 0, 1)
    shaded: Image = (skin.image * (1 - SHADE * reach**3)[..., None]).astype(np.float32)
    return Texture(shaded, skin.extent)
