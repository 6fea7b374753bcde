"""Answers: where queries are in other frames, for models whose motion is known."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from decomotion.compositing import static_share
from decomotion.model.fusion import DecoMotion
from decomotion.model.readout import Answer, answer, carry, static_owns, surface_of
from decomotion.model.volume import Matter
from tiny_fit import randomised, tiny_model

FRAMES = 5

both_presets = pytest.mark.parametrize("preset", ["cpu", "paper"])


def ask(model: DecoMotion, queries: Tensor, frames: Tensor) -> Answer:
    """The answer to `queries`, rows of (t, x, y)."""
    conditioning = model.condition(torch.arange(model.num_frames))
    frame, xy = queries[:, 0].long(), queries[:, 1:]
    with torch.no_grad():
        return answer(model, conditioning, xy, frame, frames)


def owned_by(model: DecoMotion, *, static: bool) -> DecoMotion:
    """The model with one volume alone, whose transform is no more than the affine map it starts with."""
    with torch.no_grad():
        model.static.head.weight[4] = 0
        model.static.head.bias[4] = 50.0 if static else -50.0
        for volume in (model.static, model.dynamic):
            for layer in volume.couplings:
                output = getattr(layer.conditioner, "output", None)  # a grid conditioner starts as the identity
                if output is not None:
                    output.weight.zero_()
    return model


def camera_maps() -> Tensor:
    """A zoom, a turn and a pan, growing from frame to frame."""
    start = torch.eye(3, 4).repeat(FRAMES, 1, 1)
    for frame in range(FRAMES):
        turn = torch.tensor(0.03 * frame)
        rotation = torch.tensor([[turn.cos(), -turn.sin()], [turn.sin(), turn.cos()]])
        start[frame, :2, :2] = (1 + 0.02 * frame) * rotation
        start[frame, :2, 3] = torch.tensor([0.04, -0.02]) * frame
    return start


QUERIES = torch.tensor([[0.0, 15.0, 12.0], [4.0, 8.0, 5.0], [2.0, 31.0, 23.0], [2.0, 0.0, 0.0]])


@both_presets
@pytest.mark.parametrize("static", [True, False])
def test_one_volume_alone_gives_the_affine_answer(preset: str, static: bool):
    start = camera_maps()
    model = owned_by(tiny_model(preset, start=start), static=static)
    given = ask(model, QUERIES, torch.arange(FRAMES))
    met = set()
    for row, (t, *xy) in enumerate(QUERIES.tolist()):
        seen = model.plane.normalise(torch.tensor(xy))
        scene = start[int(t), :2, :2] @ seen + start[int(t), :2, 3]
        for frame in range(FRAMES):
            there = torch.linalg.solve(start[frame, :2, :2], scene - start[frame, :2, 3])
            expected = model.plane.to_pixels(there)
            # float32
            torch.testing.assert_close(given.xy[row, frame], expected, rtol=0, atol=1e-3)
            inside = (expected > -0.4).all() and expected[0] < 31.4 and expected[1] < 23.4
            if inside:
                # at the image's border the target's ray is that of the nearest pixel centre: half a pixel away
                assert given.occlusion[row, frame] < 0.51
                met.add("inside")
            outside = (expected < -0.6).any() or expected[0] > 31.6 or expected[1] > 23.6
            if outside:
                assert given.occlusion[row, frame] == 1
                met.add("outside")
    assert met == {"inside", "outside"}


def test_in_its_own_frame_a_query_is_exactly_where_it_was_and_visible():
    model = randomised(tiny_model("cpu"), 0.5)
    given = ask(model, QUERIES, torch.arange(FRAMES))
    for row, (t, *xy) in enumerate(QUERIES.tolist()):
        assert given.xy[row, int(t)].tolist() == xy
        assert given.occlusion[row, int(t)] == 0


def test_the_surface_is_a_point_of_the_ray():
    """Carried back to its own frame, it is the pixel that it was seen at, however much the maps bend."""
    model = randomised(tiny_model("cpu"), 0.3)
    conditioning = model.condition(torch.arange(FRAMES))
    frame, xy = QUERIES[:, 0].long(), QUERIES[:, None, 1:]
    surface = surface_of(model, xy, conditioning, frame)
    torch.testing.assert_close(carry(model, surface, conditioning, frame), xy, rtol=0, atol=1e-3)


def test_an_object_owns_what_it_has_a_tenth_of():
    static, dynamic = torch.tensor([[0.92, 0.6, 0.2, 0.0], [0.08, 0.3, 0.6, 0.0]])
    assert static_owns(static_share(static, dynamic)).tolist() == [True, False, False, True]


@both_presets
def test_frames_in_any_order_and_number(preset: str):
    model = randomised(tiny_model(preset), 0.05)
    everything = ask(model, QUERIES, torch.arange(FRAMES))
    some = torch.tensor([3, 0, 3])
    given = ask(model, QUERIES, some)
    # float32; a hundredth of what parity allows
    torch.testing.assert_close(given.xy, everything.xy[:, some], rtol=0, atol=1e-4)
    torch.testing.assert_close(given.occlusion, everything.occlusion[:, some], rtol=0, atol=1e-4)


@both_presets
def test_one_query_s_answer_does_not_depend_on_the_others(preset: str):
    model = randomised(tiny_model(preset), 0.05)
    together = ask(model, QUERIES, torch.arange(FRAMES))
    for row in range(len(QUERIES)):
        alone = ask(model, QUERIES[row : row + 1], torch.arange(FRAMES))
        torch.testing.assert_close(alone.xy[0], together.xy[row], rtol=0, atol=1e-4)
        torch.testing.assert_close(alone.occlusion[0], together.occlusion[row], rtol=0, atol=1e-4)


def test_scores_are_scores():
    model = randomised(tiny_model("cpu"), 0.5)
    score = ask(model, QUERIES, torch.arange(FRAMES)).occlusion
    assert ((score >= 0) & (score <= 1)).all()


def test_a_point_that_something_hides_is_occluded_and_carried_on(monkeypatch: pytest.MonkeyPatch):
    """A scene that stands still; before it a wall, out of view in frame 0, that fills the middle of frame 1."""
    model = owned_by(tiny_model("cpu", frames=2, start=torch.eye(3, 4).repeat(2, 1, 1)), static=True)
    model.dynamic.affine.start[0, 0, 3] = 1.5

    def scene(points: Tensor) -> Matter:
        far = (points[..., 2] > 0).float()
        return Matter(density=10 * far, colour=torch.zeros_like(points), confidence=far)

    def wall(points: Tensor) -> Matter:
        near = ((points[..., 2] < 0) & (points[..., 0].abs() < 0.4)).float()
        return Matter(density=10 * near, colour=torch.ones_like(points), confidence=torch.zeros_like(near))

    monkeypatch.setattr(model.static, "matter", scene)
    monkeypatch.setattr(model.dynamic, "matter", wall)
    given = ask(model, torch.tensor([[0.0, 15.0, 12.0], [0.0, 3.0, 12.0]]), torch.arange(2))
    torch.testing.assert_close(given.xy, torch.tensor([[15.0, 12.0], [3.0, 12.0]])[:, None].expand(2, 2, 2))
    assert (given.occlusion > 0.5).tolist() == [[False, True], [False, False]]


@pytest.mark.parametrize(("height", "width"), [(40, 24), (30, 64)])
@pytest.mark.parametrize("static", [True, False])
def test_occlusion_by_hand_at_the_image_s_border(height: int, width: int, static: bool):
    """What moves onto the outer half of a border pixel is compared with that pixel's middle, 0.4 pixels away.

    The score is e / (e + 2), e the error in units: pixels of a frame whose longer side is 256.
    """
    pixels = max(height, width)
    middle = (width // 2, height // 2)
    places = [(width - 1, middle[1], 0.4, 0), (0, middle[1], -0.4, 0), (middle[0], height - 1, 0, 0.4)]
    places += [(middle[0], 0, 0, -0.4), (*middle, 0.4, 0.4), (width - 1, middle[1], 0.6, 0), (middle[0], 0, 0, -0.6)]
    error = 0.4 * 256 / pixels
    expected = [error / (error + 2)] * 4 + [0, 1, 1]
    for (x, y, right, down), score in zip(places, expected, strict=True):
        start = torch.eye(3, 4).repeat(3, 1, 1)
        start[2, :2, 3] = -torch.tensor([right, down]) * 2 / pixels
        model = tiny_model(
            "cpu", frames=3, height=height, width=width, start=start, overrides=("model.occlusion_scale=2.0",)
        )
        given = ask(owned_by(model, static=static), torch.tensor([[0.0, x, y]]), torch.tensor([2]))
        torch.testing.assert_close(given.xy[0, 0], torch.tensor([x + right, y + down]), rtol=0, atol=1e-3)
        assert given.occlusion[0, 0].item() == pytest.approx(score, abs=2e-3)
