"""What a short fit learns from: the model's own answers, the trusted tracks, and what hides a point."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from decomotion.chance import generator
from decomotion.corrections.following import Seen, see
from decomotion.corrections.lesson import lesson_pool
from decomotion.corrections.points import CorrectedPoint, Place
from decomotion.corrections.trusted import TrustedTracks, trusted_tracks
from decomotion.data.pool import Pool
from decomotion.data.prepare import Preparation
from decomotion.model.fusion import DecoMotion
from tiny_fit import tiny_model

FRAMES, HEIGHT, WIDTH = 5, 72, 128
ROWS, COLUMNS = 3, 4
PLACE = (40.0, 30.0)
HIDDEN = math.nan
RANDOM, COVERING = 1024, 512
"""Points of a frame that stay, and of what hides one."""


@pytest.fixture(scope="module")
def model() -> DecoMotion:
    """Nothing moves, and all is the static scene's."""
    found = tiny_model("cpu", frames=FRAMES, height=HEIGHT, width=WIDTH, feature_size=1)
    with torch.no_grad():
        found.static.head.weight[4] = 0
        found.static.head.bias[4] = math.inf
    return found


def prepared() -> Preparation:
    """A point at `PLACE` alone is found to move; features are the numbers of their cells, a hundred a frame on."""
    shape = (FRAMES, ROWS * COLUMNS)
    moving = np.zeros(shape, np.uint8)
    moving[:, 5] = 1
    pool = Pool(
        points=np.broadcast_to(np.array(PLACE, np.float32), (*shape, 2)),
        targets=np.zeros((FRAMES, *shape, 2), np.float32),
        confidence=np.zeros((FRAMES, *shape), np.uint8),
        rgb=np.zeros((*shape, 3), np.uint8),
        feature=(100 * np.arange(FRAMES)[:, None] + np.arange(shape[1]))[..., None].astype(np.float16),
        moving=moving,
        camera=np.full((FRAMES, 2, 3), 1, np.float32),
        object=np.full((FRAMES, 2, 3), 2, np.float32),
        longer_side=WIDTH,
    )
    return Preparation(pool, (), Path(), (ROWS, COLUMNS))


def lesson(model: DecoMotion, *places: Place) -> tuple[Pool, TrustedTracks]:
    """Of one point; red of the clip's frames is their column."""
    frames = np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8)
    frames[..., 0] = np.arange(WIDTH)
    tracks = trusted_tracks(model, [CorrectedPoint.of(list(places))])
    return lesson_pool(model, prepared(), frames, tracks, generator(0, "corrections")), tracks


def test_far_away_all_stays_and_what_contradicts_counts_for_nothing(model: DecoMotion):
    pool, tracks = lesson(model, Place(1, *PLACE), Place(3, 60, 30))
    xy = pool.points[1, :RANDOM]
    away = np.linalg.norm(xy - tracks.bent[0].xy[1], axis=-1)
    at, far = np.flatnonzero(away < 1e-3), np.flatnonzero(away > 8)
    assert len(at) >= RANDOM // 2  # half are on what moves
    assert len(far) > RANDOM // 4
    others = np.array([0, 2, 3, 4])
    np.testing.assert_allclose(pool.targets[1][:, far], np.broadcast_to(xy[far], (FRAMES, len(far), 2)), atol=0.01)
    assert (pool.confidence[1][others][:, far[away[far] > 40]] == 255).all()
    assert (pool.confidence[1, 3, at] == 0).all()
    assert (pool.confidence[1, 1] == 0).all()
    assert tracks.bent[0].moving  # the scene does not lead there
    assert set(pool.moving[1, at]) == {2}
    assert set(pool.moving[1, far]) == {0}


def test_tracks_count_as_they_are_trusted_at_the_less_sure_end(model: DecoMotion):
    pool, tracks = lesson(model, Place(1, *PLACE), Place(3, 60, 30))
    assert pool.num_points == RANDOM + len(tracks.xy)
    mine = slice(RANDOM, None)
    np.testing.assert_allclose(pool.points[3, mine], tracks.xy[:, 3], atol=1e-3)
    np.testing.assert_allclose(pool.targets[1, 3, mine], tracks.xy[:, 3], atol=0.01)
    assert tracks.trust[:, 1].max() == tracks.trust[:, 3].max() == 1  # frames of which something is known
    assert tracks.trust[:, [0, 2, 4]].max() <= 0.5
    for target in (0, 2, 3, 4):
        expected = 255 * np.minimum(tracks.trust[:, 1], tracks.trust[:, target])
        np.testing.assert_allclose(pool.confidence[1, target, mine], expected, atol=0.51)
    assert set(pool.moving[1, mine]) == {1}


def test_colours_and_features_are_those_of_the_places(model: DecoMotion):
    pool, _ = lesson(model, Place(1, *PLACE), Place(3, 60, 30))
    for frame in range(FRAMES):
        xy = pool.points[frame]
        np.testing.assert_allclose(pool.rgb[frame, :, 0], xy[:, 0], atol=0.6)
        row, column = (xy[:, 1] + 0.5) // (HEIGHT / ROWS), (xy[:, 0] + 0.5) // (WIDTH / COLUMNS)
        assert (pool.feature[frame, :, 0] == 100 * frame + row * COLUMNS + column).all()


@pytest.mark.parametrize("place", [PLACE, (0.5, 70.0)])
def test_what_hides_a_point_is_the_other_volume_s_in_that_frame_alone(model: DecoMotion, place: tuple[float, float]):
    """At the border, too: nothing is taught to come from beyond it."""
    pool, tracks = lesson(model, Place(1, *place), Place(3, HIDDEN, HIDDEN))
    assert not tracks.bent[0].moving
    hides = slice(-COVERING, None)
    assert set(pool.moving[3, hides]) == {1}
    standing = np.broadcast_to(pool.points[3, hides], (FRAMES, COVERING, 2))
    np.testing.assert_allclose(pool.targets[3][:, hides], standing, atol=0.02)  # the layers begin near the identity
    away = np.linalg.norm(pool.points[3, hides] - tracks.bent[0].xy[3], axis=-1)
    near = np.exp(-0.5 * (away / 1.5) ** 2)  # 3 units
    for target in (0, 1, 2, 4):
        np.testing.assert_allclose(pool.confidence[3, target, hides], 255 * near, atol=0.51)
    for frame in (0, 1, 2, 4):
        assert not pool.confidence[frame, :, hides].any()
        assert set(pool.moving[frame, hides]) == {2}
    # the point itself is trusted in no link to or from that frame
    assert not tracks.trust[:, 3].any()


def test_what_the_model_is_not_sure_of_counts_less(model: DecoMotion, monkeypatch: pytest.MonkeyPatch):
    """The scene that has 0.92 of a ray counts 0.84; where it has 0.1 the ray is the other volume's, and counts 0.8."""
    plainly = see

    def unsure(*given: Any) -> Seen:
        seen = plainly(*given)
        return Seen(seen.xy, np.where(seen.xy[:, 0, 0] < 64, 0.92, 0.1).astype(np.float32))

    monkeypatch.setattr("decomotion.corrections.lesson.see", unsure)
    pool, _ = lesson(model, Place(1, *PLACE), Place(3, *PLACE))
    xy = pool.points[0, :RANDOM]
    far = np.linalg.norm(xy - PLACE, axis=-1) > 20
    left = xy[:, 0] < 64
    assert set(pool.confidence[0, 2, :RANDOM][far & left]) == {214}
    assert set(pool.confidence[0, 2, :RANDOM][far & ~left]) == {204}
    assert set(pool.moving[0, :RANDOM][far & left]) == {0}
    assert set(pool.moving[0, :RANDOM][far & ~left]) == {1}


def test_a_hidden_point_is_neither_volume_s_where_it_is_hidden(model: DecoMotion):
    """Nor are the random points around: what is seen there is what hides it, whoever that is."""
    pool, tracks = lesson(model, Place(1, *PLACE), Place(3, HIDDEN, HIDDEN))
    assert set(pool.moving[3, RANDOM:-COVERING]) == {2}
    away = np.linalg.norm(pool.points[3, :RANDOM] - tracks.bent[0].xy[3], axis=-1)
    assert set(pool.moving[3, :RANDOM][away < 1.4]) == {2}
    assert set(pool.moving[3, :RANDOM][away > 1.6]) == {0}
    assert not pool.confidence[1, 3, RANDOM:-COVERING].any()
    assert not pool.confidence[3, 1, RANDOM:-COVERING].any()


def test_motions_of_camera_and_object_stay(model: DecoMotion):
    pool, _ = lesson(model, Place(1, *PLACE), Place(3, *PLACE))
    assert (pool.camera == 1).all()
    assert (pool.object == 2).all()
