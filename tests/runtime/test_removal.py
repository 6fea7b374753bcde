from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from decomo_runtime import Appearance, QueryError, RenderError
from decomo_runtime import footage as footage_module
from decomo_runtime import objects as objects_module
from decomo_runtime import removal as removal_module
from decomo_runtime.footage import FAR, NEAR, others_of
from decomo_runtime.objects import Objects
from decomo_runtime.raster import whole
from decomo_runtime.removal import propagate, remove_objects
from decomo_runtime.scene_motion import follow_scene
from tiny_fit import FRAMES, HEIGHT, SCENE_VELOCITY, WIDTH, sliding_square
from true_tracker import TrueTracker, square_mask

FRAME = 4


def scene_of(frame: int) -> tuple[np.ndarray, np.ndarray]:
    """The scene behind the square of `frame`, [H, W, 3], and where any other frame shows it: one pixel at a time."""
    frames = sliding_square().frames
    colour, known = frames[frame].astype(float), ~square_mask(frame)
    for y, x in np.argwhere(square_mask(frame)):
        for other in range(FRAMES):
            there = x + round(SCENE_VELOCITY[0] * (other - frame))
            if 0 <= there < WIDTH and not square_mask(other)[y, there]:
                colour[y, x], known[y, x] = frames[other, y, there], True
    return colour, known


@pytest.fixture(autouse=True)
def narrow_edges(monkeypatch: pytest.MonkeyPatch):
    """Of a frame of 32 pixels; the true mask needs no margin, and covers a third of the frame."""
    monkeypatch.setattr(objects_module, "GROWN", 4.0)
    monkeypatch.setattr(objects_module, "FEATHER", 4.0)


def tracker(static: float = 1.0):
    return TrueTracker(static)


def tracker_of_two() -> TrueTracker:
    """Of the first two frames."""
    model = tracker()
    model.facts = replace(model.facts, num_frames=2)
    return model


def objects(frames: np.ndarray) -> Objects:
    return Objects(tracker(), frames, follow_scene(tracker()))


def test_the_scene_behind_the_square_is_what_other_frames_show():
    frames = sliding_square().frames
    (made,) = remove_objects(tracker(), frames, [FRAME])
    expected, known = scene_of(FRAME)
    behind = square_mask(FRAME) & known
    assert behind.sum() > 100  # of 144
    apart = np.abs(made[behind].astype(float) - expected[behind]).max(axis=1)
    assert np.quantile(apart, 0.9) <= 2  # rounding and interpolation; next to the masks' edges less is known
    assert np.abs(frames[FRAME][behind].astype(float) - expected[behind]).mean() > 20  # there was something to remove


@pytest.mark.parametrize(("near", "fewest"), [(16, 95), (1, 60)])
def test_rasters_smaller_than_the_clip_and_not_square(monkeypatch: pytest.MonkeyPatch, near: int, fewest: int):
    """32x24, rendered at 16x12 and compared at 24x18; and where but every fourth frame and the next ones are asked."""
    height = 24
    monkeypatch.setattr(objects_module, "RENDERED_SIDE", 16)
    monkeypatch.setattr(objects_module, "COMPARED_SIDE", 24)
    monkeypatch.setattr(footage_module, "NEAR", near)
    frames = sliding_square().frames[:, :height]
    (made,) = remove_objects(TrueTracker(height=height), frames, [FRAME])
    expected, known = scene_of(FRAME)
    behind = (square_mask(FRAME) & known)[:height]
    assert behind.sum() > 100
    apart = np.abs(made[behind].astype(float) - expected[:height][behind]).max(axis=1)
    assert (apart <= 3).sum() >= fewest
    far = np.ones((height, WIDTH), bool)
    rows, columns = np.nonzero(square_mask(FRAME))
    far[max(0, rows.min() - 4) : rows.max() + 5, max(0, columns.min() - 4) : columns.max() + 5] = False
    np.testing.assert_array_equal(made[far], frames[FRAME][far])


def test_far_from_the_square_the_clip_s_own_pixels_stay():
    frames = sliding_square().frames
    (made,) = remove_objects(tracker(), frames, [FRAME])
    far = objects(frames).share(FRAME) == 0
    assert far.sum() > HEIGHT * WIDTH / 3
    np.testing.assert_array_equal(made[far], frames[FRAME][far])


def test_exposure_does_not_show():
    """Every frame brighter than the one before: the colours that are carried are those of the frame made."""
    frames = sliding_square().frames // 2
    plain = next(remove_objects(tracker(), frames, [FRAME]))
    brighter = frames + (10 * np.arange(FRAMES, dtype=np.uint8))[:, None, None, None]
    made = next(remove_objects(tracker(), brighter, [FRAME]))
    np.testing.assert_allclose(made.astype(int) - 10 * FRAME, plain, atol=2)


def test_the_share_falls_from_the_object_outwards():
    share = objects(sliding_square().frames).share(FRAME)
    mask = square_mask(FRAME)
    assert (share[mask] == 1).all()
    row, right = 16, np.flatnonzero(mask[16])[-1]
    assert (np.diff(share[row, right:]) <= 0).all()
    assert share[row, right + 3] == 0  # 8 of 256 pixels are 1 of 32


def test_a_leg_of_the_square_goes_with_it_and_a_stranger_stays(monkeypatch: pytest.MonkeyPatch):
    """The model's mask holds neither; the one hangs on the square, the other is far from it."""
    monkeypatch.setattr(objects_module, "STRIDE", 1)
    frames, leg, stranger = sliding_square().frames.copy(), [], []
    for frame in range(FRAMES):
        rows, columns = np.nonzero(square_mask(frame))
        leg.append((slice(rows.max() + 1, rows.max() + 4), slice(columns.min() + 4, columns.min() + 7)))
        stranger.append((slice(rows.min() - 9, rows.min() - 6), leg[-1][1]))
        frames[frame][leg[-1]] = frames[frame][stranger[-1]] = (0, 255, 0)
    share = objects(frames).share(FRAME)
    gone = share[leg[FRAME]] == 1
    assert gone.sum() >= 7  # of 9: its edge may look like the scene beside it
    assert (share[stranger[FRAME]] == 0).all()
    (made,) = remove_objects(tracker(), frames, [FRAME])
    scene = sliding_square().frames[FRAME]
    np.testing.assert_allclose(made[leg[FRAME]][gone].astype(int), scene[leg[FRAME]][gone], atol=3)
    np.testing.assert_array_equal(made[stranger[FRAME]], frames[FRAME][stranger[FRAME]])


def test_what_no_frame_shows_is_continued_and_then_carried_on():
    """Two frames: the square hides most of the same scene in both."""
    frames = sliding_square().frames[:2].copy()
    model = tracker_of_two()
    motion, found = follow_scene(model), objects(frames)
    behind = propagate(frames, 0, whole((HEIGHT, WIDTH)), motion, found)
    unknown = np.isnan(behind).any(-1) & (found.share(0) > 0)
    assert unknown.any()
    assert np.isnan(behind[found.share(0) == 0]).all()
    first, second = remove_objects(model, frames, [0, 1])
    inner = unknown & (found.share(0) == 1) & np.roll(square_mask(1), 1, axis=1)
    inner &= np.roll(np.isnan(propagate(frames, 1, whole((HEIGHT, WIDTH)), motion, found)).any(-1), 1, axis=1)
    assert inner.any()
    places = np.argwhere(inner)
    np.testing.assert_allclose(
        second[places[:, 0], places[:, 1] - 1].astype(int), first[places[:, 0], places[:, 1]], atol=2
    )


def test_a_hole_of_the_static_volume_leaves_no_hole_in_the_picture(monkeypatch: pytest.MonkeyPatch):
    """Its colour there is black; what is around it goes on instead."""
    frames, model = sliding_square().frames[:2], tracker_of_two()
    whole = next(remove_objects(model, frames, [0]))
    sample = model.sample

    def with_hole(queries: np.ndarray) -> Appearance:
        seen = sample(queries)
        hole = seen.static_confidence < 0.5
        return replace(
            seen,
            rgb_static=np.where(hole[:, None], 0, seen.rgb_static).astype(np.float32),
            static_opacity=np.where(hole, 0, seen.static_opacity).astype(np.float32),
        )

    monkeypatch.setattr(model, "sample", with_hole)
    np.testing.assert_allclose(next(remove_objects(model, frames, [0])).astype(int), whole, atol=2)


def test_nothing_moves_nothing_changes(monkeypatch: pytest.MonkeyPatch):
    model = tracker()
    sample = model.sample
    monkeypatch.setattr(model, "sample", lambda queries: sample(np.asarray(queries) * [1, 0, 0] + [0, 31, 0]))
    frames = sliding_square().frames
    for frame, made in enumerate(remove_objects(model, frames, range(FRAMES))):
        np.testing.assert_array_equal(made, frames[frame])


def test_a_model_without_a_static_scene():
    with pytest.raises(RenderError, match="holds nothing in sliding to be static"):
        next(remove_objects(tracker(0.0), sliding_square().frames, [0]))


@pytest.mark.parametrize("frame", [-1, FRAMES, 1.5])
def test_frames_that_the_clip_does_not_have(frame: Any):
    with pytest.raises(QueryError, match="frames"):
        next(remove_objects(tracker(), sliding_square().frames, [frame]))


class Decoded(Sequence[np.ndarray]):
    """A clip whose frames are made when they are asked for, one by one; `asked` says which were."""

    def __init__(self, frames: np.ndarray) -> None:
        self._frames, self.asked = frames, []

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, frame: int) -> np.ndarray:
        self.asked.append(frame)
        return self._frames[frame].copy()


def test_each_frame_is_decoded_and_rendered_once(monkeypatch: pytest.MonkeyPatch):
    frames, model, rendered = Decoded(sliding_square().frames), tracker(), []
    sample = model.sample

    def counted(queries: np.ndarray) -> Appearance:
        rendered.append(len(queries))
        return sample(queries)

    monkeypatch.setattr(model, "sample", counted)
    made = list(remove_objects(model, frames, range(FRAMES)))
    assert sorted(frames.asked) == list(range(FRAMES))
    assert rendered.count(HEIGHT * WIDTH) == FRAMES
    for frame, picture in enumerate(remove_objects(tracker(), sliding_square().frames, range(FRAMES))):
        np.testing.assert_array_equal(made[frame], picture)


def test_where_little_is_held_it_is_made_again(monkeypatch: pytest.MonkeyPatch):
    frames = sliding_square().frames
    expected = list(remove_objects(tracker(), frames, range(FRAMES)))
    for module in (objects_module, footage_module):
        monkeypatch.setattr(module, "HELD", 2)
    monkeypatch.setattr(footage_module, "HELD_BYTES", 3 * frames[0].nbytes)
    decoded = Decoded(frames)
    for made, picture in zip(remove_objects(tracker(), decoded, range(FRAMES)), expected, strict=True):
        np.testing.assert_array_equal(made, picture)
    assert len(decoded.asked) > 2 * FRAMES


def test_a_frame_looks_at_no_more_of_a_longer_clip():
    others = others_of(500, 10_000)
    assert others == sorted(others, key=lambda other: abs(other - 500))
    assert set(others) == set(others_of(500, 1000))
    assert {500 - NEAR, 501, 500 + NEAR, 500 + NEAR + 4} <= set(others)
    assert 500 not in others
    assert max(abs(other - 500) for other in others) <= FAR
    assert len(others) < 80
    assert others_of(0, 30)[-1] == 29  # shows the most of what all before it hide


def test_a_pixel_that_enough_frames_show_is_followed_no_further(monkeypatch: pytest.MonkeyPatch):
    frames, looked_at = sliding_square().frames, []

    def in_sight(self: Objects, frame: int, places: np.ndarray) -> np.ndarray:
        looked_at.append((frame, len(places)))
        return places[:, 0] > (15 if frame < FRAME else -np.inf)

    monkeypatch.setattr(Objects, "in_sight", in_sight)
    monkeypatch.setattr(removal_module, "COLOURS", 2)
    found = objects(frames)
    propagate(frames, FRAME, whole((HEIGHT, WIDTH)), follow_scene(tracker()), found)
    assert [frame for frame, _ in looked_at] == [3, 5, 2, 6]
    assert [count for _, count in looked_at][:2] == [(found.share(FRAME) > 0).sum()] * 2
    assert looked_at[-1][1] < looked_at[0][1]


def test_the_share_reaches_beyond_the_mask(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(objects_module, "GROWN", 16.0)
    monkeypatch.setattr(objects_module, "FEATHER", 16.0)
    share = objects(sliding_square().frames).share(FRAME)
    right = np.flatnonzero(square_mask(FRAME)[16])[-1]
    assert (share[16, right : right + 3] == 1).all()  # 16 of 256 pixels are 2 of 32
    assert 0 < share[16, right + 3] < 1
    assert share[16, right + 6] == 0


def test_in_sight_is_what_no_object_covers_within_the_frame():
    found = objects(sliding_square().frames)
    rows, columns = np.nonzero(square_mask(FRAME))
    places = np.array([[columns.mean(), rows.mean()], [columns.max() + 3, rows.mean()], [-2, 3], [3, HEIGHT + 1]])
    np.testing.assert_array_equal(found.in_sight(FRAME, places), [False, True, False, False])
