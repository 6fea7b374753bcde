"""The same scene photographed otherwise is the same scene: losses and answers, in units, do not notice.

A unit is a pixel of a frame whose longer side is 256; the smallest photograph, 48 x 36, has 0.1875 pixels to a unit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import torch

import scene
from decomotion import checkpoint
from decomotion.clip import Clip
from decomotion.config import Config, load
from decomotion.data.batch import Sampler
from decomotion.data.prepare import prepare
from decomotion.geometry import ImagePlane
from decomotion.losses import LOSSES
from decomotion.model.fusion import DecoMotion
from decomotion.model.readout import answer
from decomotion.train import fit
from tiny_fit import TINY_CPU, offsets, randomised

Array = np.ndarray
UNIT = 48 / 256
"""Pixels of the smallest photograph."""
STEPS = 80


@cache
def config() -> Config:
    """The `cpu` preset with few points, small networks and its own flow."""
    flow = (
        "data.flow={kind: dis, field_side: 512, intervals: [1, 2, 4], longest_interval: 8, upsample: 2, max_side: 320, "
        "patch_stride: 3, descent_iterations: 25, refinement_iterations: 10, gradient_weight: 40}"
    )
    sizes = ("data.pool.points_per_frame=768", "optim.pairs=8", "optim.points=64")
    return load("cpu", overrides=(*TINY_CPU, flow, *sizes))


class TestLosses:
    """Of one model and one batch; what is optimised depends on nothing else."""

    def losses(self, size: int, kinds: type[float] = float) -> dict[str, float]:
        """Every term for the scene's own links, which lie `size` times as far apart."""
        clip = Clip("scene", scene.photographed(1), 24.0)
        pool = prepare(clip, config().data, progress=False)
        targets = np.asarray(pool.targets)
        larger = replace(
            pool,
            points=((pool.points + 0.5) * size - 0.5).astype(np.float32),
            targets=((targets + 0.5) * size - 0.5).astype(np.float32),
            longer_side=scene.WIDTH * size,
        )
        starts = torch.eye(3, 4).repeat(scene.FRAMES, 1, 1)
        torch.manual_seed(0)
        plane = ImagePlane(scene.HEIGHT * size, scene.WIDTH * size)
        model = randomised(DecoMotion(config().model, plane, (starts, starts.clone()), pool.feature_size), 0.1)
        batch = Sampler(larger, config().optim).draw(3, torch.Generator().manual_seed(1))
        with torch.no_grad():
            prediction = model.predict(batch.xy, batch.frame, batch.target_frame, offsets(model, batch.xy, 2))
            return {name: kinds(loss(prediction, batch)) for name, loss in LOSSES.items()}

    @pytest.mark.parametrize("size", [2, 3, 40])
    def test_they_do_not_depend_on_the_clip_s_size(self, size: int):
        once, larger = self.losses(1), self.losses(size)
        assert once["flow_fused"] > 1
        assert larger == pytest.approx(once, rel=1e-3)  # float32


def same(xy: Array) -> Array:
    return xy


@dataclass(frozen=True)
class Photograph:
    """A clip of the scene, and how places in it and in the smallest photograph correspond."""

    video: Callable[[], Array]
    to: Callable[[Array], Array] = same
    """Places of the smallest photograph's frame 0, [N, 2], in this clip's frame that shows it."""
    back: Callable[[Array], Array] = same
    """This clip's tracks [N, T, 2] as the smallest photograph's."""
    first: int = 0
    """The frame that shows frame 0."""


SHIFT = (3, -2)
PHOTOGRAPHS = {
    "plain": Photograph(lambda: scene.photographed(1)),
    "twice as large": Photograph(
        lambda: scene.photographed(2), lambda xy: (xy + 0.5) * 2 - 0.5, lambda xy: (xy + 0.5) / 2 - 0.5
    ),
    "three times as large": Photograph(
        lambda: scene.photographed(3), lambda xy: (xy + 0.5) * 3 - 0.5, lambda xy: (xy + 0.5) / 3 - 0.5
    ),
    "standing": Photograph(
        lambda: scene.photographed(1).swapaxes(1, 2), lambda xy: xy[..., ::-1], lambda xy: xy[..., ::-1]
    ),
    "shifted": Photograph(lambda: scene.photographed(1, SHIFT), lambda xy: xy - SHIFT, lambda xy: xy + SHIFT),
    "backwards": Photograph(lambda: scene.photographed(1)[::-1], same, lambda xy: xy[:, ::-1], scene.FRAMES - 1),
    "blue for red": Photograph(lambda: scene.photographed(1)[..., ::-1]),
}


def queries() -> Array:
    """Places of frame 0, not next to the object's outline, which photographs show differently."""
    y, x = np.mgrid[4 : scene.HEIGHT - 3 : 4, 4 : scene.WIDTH - 3 : 4]
    places = np.stack([x.ravel(), y.ravel()], axis=-1).astype(float)
    return places[scene.on_object(places, 1) | ~scene.on_object(places, -2)]


@cache
def answers(name: str) -> Array:
    """Tracks of `queries` [N, T, 2] after a short fit of that photograph."""
    how = PHOTOGRAPHS[name]
    with TemporaryDirectory() as folder:
        clip = Clip("scene", np.ascontiguousarray(how.video()), 24.0)
        run = fit(clip, Path(folder) / "run", config=config(), steps=STEPS, progress=False)
        model = checkpoint.load(run / checkpoint.FILE_NAME).model
    places = torch.from_numpy(np.ascontiguousarray(how.to(queries()))).float()
    frames = torch.arange(scene.FRAMES)
    with torch.no_grad():
        found = answer(model, model.condition(frames), places, torch.full((len(places),), how.first), frames)
    return how.back(found.xy.numpy())


@pytest.mark.slow
@pytest.mark.parametrize("name", PHOTOGRAPHS)
def test_a_short_fit_answers_alike(name: str):
    """Of points in sight half are within 0.2 units of the truth and of the plain answer, and 85 % within 2.

    Fits of the plain photograph itself differ as much when their seeds do.
    """
    truth = scene.true_tracks(queries())
    seen = ((truth >= 0) & (truth <= np.array([scene.WIDTH, scene.HEIGHT]) - 1)).all(-1)
    on_object = scene.on_object(queries())
    for against in (truth, answers("plain")):
        error = np.linalg.norm(answers(name) - against, axis=-1) / UNIT
        assert np.median(error[seen]) < 0.2
        assert np.quantile(error[seen], 0.85) < 2
        assert np.median(error[on_object][seen[on_object]]) < 2
