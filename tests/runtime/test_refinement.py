"""Tracks on the clip's own pixels: exact where a model errs by pixels, untouched where nothing can be told."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest

from decomo_runtime import RefinementError, Tracks
from decomo_runtime.expected_error import calibration
from decomo_runtime.refinement import refine
from moving_planes import BOX, FRAMES, HEIGHT, WIDTH, ErringTracker, Motion, photographed, texture

MOTION = Motion()
ERROR = 4.0


@pytest.fixture(scope="module")
def video() -> npt.NDArray[np.uint8]:
    return photographed(MOTION)


def drawn(number: int, seed: int = 0, frame: int | None = None) -> npt.NDArray[np.float32]:
    """Queries [N, 3] anywhere in the frames, or in one."""
    random = np.random.default_rng(seed)
    t = random.integers(0, FRAMES, number) if frame is None else np.full(number, frame)
    return np.stack([t, *(random.uniform(-0.5, side - 0.5, number) for side in (WIDTH, HEIGHT))], 1).astype(np.float32)


@dataclass(frozen=True)
class Outcome:
    """Tracks and what is known of them."""

    before: Tracks
    after: Tracks
    found: npt.NDArray[np.bool_]
    """[N, M]"""
    seen: npt.NDArray[np.bool_]
    """[N, M], where points are in sight, their own frame left out; the errors in pixels are of these."""
    errors_before: npt.NDArray[np.float32]
    errors: npt.NDArray[np.float32]


def refined(
    video: npt.NDArray[np.uint8],
    queries: npt.NDArray[np.float32],
    motion: Motion = MOTION,
    error: float = ERROR,
    frames: list[int] | None = None,
) -> Outcome:
    tracker = ErringTracker(motion, error)
    before = tracker.track(queries, frames)
    after = refine(tracker, before, video)
    assert after.refined is not None
    truth = ErringTracker(motion).track(queries, frames)
    seen = ~truth.occluded & (queries[:, :1] != truth.frames)
    errors_before, errors = (np.linalg.norm(tracks.xy - truth.xy, axis=-1)[seen] for tracks in (before, after))
    return Outcome(before, after, after.refined, seen, errors_before, errors)


def test_answers_are_as_precise_as_the_pixels(video: npt.NDArray[np.uint8]):
    outcome = refined(video, drawn(80))
    assert np.median(outcome.errors_before) > 1.2
    assert np.median(outcome.errors) < 0.05
    assert outcome.found[outcome.seen].mean() > 0.8
    assert np.percentile(outcome.errors[outcome.found[outcome.seen]], 99) < 0.3
    assert (outcome.errors > outcome.errors_before + 0.1).mean() < 0.005


def test_nothing_else_changes(video: npt.NDArray[np.uint8]):
    outcome = refined(video, drawn(60, 1))
    before, after, found = outcome.before, outcome.after, outcome.found
    assert before.occluded.any()
    assert not found[before.occluded].any()
    assert (after.xy[~found] == before.xy[~found]).all()
    assert (after.xy.dtype, found.dtype) == (np.float32, bool)
    assert vars(replace(after, xy=before.xy, refined=None)) == vars(before)  # the same arrays


def test_the_expected_error_shrinks_where_a_point_is_found(video: npt.NDArray[np.uint8]):
    tracker = ErringTracker(MOTION, ERROR)
    tracks = tracker.track(drawn(12, 1))
    told = np.random.default_rng(0).uniform(1, 9, tracks.occluded.shape).astype(np.float32)
    after = refine(tracker, replace(tracks, error=told), video)
    assert after.refined is not None
    assert after.error is not None
    factor = calibration().refined_factor
    assert 0 < factor < 1
    np.testing.assert_allclose(after.error, np.where(after.refined, factor * told, told), rtol=1e-6)
    assert after.refined.any()
    assert not after.refined.all()


def test_what_the_model_says_to_be_hidden_stays(video: npt.NDArray[np.uint8]):
    tracker = ErringTracker(MOTION, ERROR)
    tracks = tracker.track(drawn(30, 16, 2))
    tracks.occluded[:, [2, 4]] = True
    after = refine(tracker, tracks, video)
    assert after.refined is not None
    assert not after.refined[:, [2, 4]].any()
    assert after.refined[:, [3, 5]].any(0).all()
    assert (after.xy[:, [2, 4]] == tracks.xy[:, [2, 4]]).all()


def test_a_point_is_where_it_was_asked_for(video: npt.NDArray[np.uint8]):
    queries = drawn(20, 2)
    tracker = ErringTracker(MOTION)
    tracks = tracker.track(queries)
    own = np.arange(len(queries)), queries[:, 0].astype(int)
    tracks.xy[own] += 1.5  # a model's answer for the query's own frame need not be the query
    after = refine(tracker, tracks, video)
    assert after.refined is not None
    inside = (tracks.xy[own] < np.array([WIDTH, HEIGHT]) - 0.5).all(1)
    assert (after.refined[own] == inside).all()
    assert (after.xy[own][inside] == queries[inside, 1:]).all()


@pytest.mark.parametrize("frame", [0, 3, FRAMES - 1])
def test_both_ways_from_the_query(video: npt.NDArray[np.uint8], frame: int):
    outcome = refined(video, drawn(30, 3, frame))
    for other in set(range(FRAMES)) - {frame}:
        assert outcome.found[:, other][outcome.seen[:, other]].mean() > 0.7


def test_one_point_does_not_depend_on_the_others(video: npt.NDArray[np.uint8]):
    queries = drawn(24, 4)
    together = refined(video, queries).after
    order = np.random.default_rng(0).permutation(len(queries))
    shuffled = refined(video, queries[order]).after
    np.testing.assert_allclose(shuffled.xy, together.xy[order], atol=1e-3)  # sums of float32 in other batches
    alone = refined(video, queries[5:6]).after
    np.testing.assert_allclose(alone.xy, together.xy[5:6], atol=1e-3)


def test_chunks(video: npt.NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch):
    queries = drawn(11, 4)
    whole = refined(video, queries).after
    monkeypatch.setattr("decomo_runtime.refinement.CHUNK", 4)
    np.testing.assert_allclose(refined(video, queries).after.xy, whole.xy, atol=1e-3)


def test_frames_in_any_order_and_twice(video: npt.NDArray[np.uint8]):
    queries = drawn(20, 5, 3)
    sorted_ = refined(video, queries, frames=[1, 2, 5]).after
    mixed = refined(video, queries, frames=[5, 1, 2, 5, 1]).after
    np.testing.assert_allclose(mixed.xy, sorted_.xy[:, [2, 0, 1, 2, 0]], atol=0.01)  # other begins
    assert refine(ErringTracker(MOTION), ErringTracker(MOTION).track(queries, []), video).xy.shape == (20, 0, 2)
    assert refine(ErringTracker(MOTION), ErringTracker(MOTION).track(np.empty((0, 3))), video).xy.shape == (
        0,
        FRAMES,
        2,
    )


def test_standing_still():
    still = Motion(turn=0, zoom=1, pan=(0, 0), box_velocity=(0, 0))
    video = np.repeat(photographed(still)[:1], FRAMES, axis=0)
    queries = drawn(40, 6)
    after = refined(video, queries, still, error=0).after
    np.testing.assert_allclose(after.xy, np.repeat(queries[:, None, 1:], FRAMES, 1), atol=0.002)  # of a pixel
    outcome = refined(video, queries, still)
    assert np.median(outcome.errors_before) > 1.2
    assert np.median(outcome.errors) < 0.04  # what the model errs by turns its patches, too


def test_the_model_tells_how_patches_turn_and_grow():
    motion = Motion(turn=0.15, zoom=1.07, pan=(0, 0))  # at last 52 degrees and half as large again
    queries = drawn(40, 7, 0)
    outcome = refined(photographed(motion), queries, motion, 2.0)
    assert outcome.found[:, -1][outcome.seen[:, -1]].mean() > 0.6
    assert np.median(outcome.errors_before) > 0.6
    assert np.median(outcome.errors) < 0.1


def test_light_changes(video: npt.NDArray[np.uint8]):
    darker = np.stack([frame * (1 - 0.08 * number) + 4 * number for number, frame in enumerate(video)])
    outcome = refined(np.rint(darker).astype(np.uint8), drawn(40, 8))
    assert np.median(outcome.errors_before) > 1.2
    assert np.median(outcome.errors) < 0.06


def test_what_changes_is_followed_from_frame_to_frame():
    ways = Motion(turn=0, zoom=1, pan=(-2.5, 0.5))
    old, new = texture(1), texture(9)
    shares = np.linspace(0, 0.5, FRAMES)
    blended = [
        np.float32(1 - share) ** 0.5 * (old - 128) + np.float32(share) ** 0.5 * (new - 128) + 128 for share in shares
    ]
    video = np.stack([photographed(ways, ground)[frame] for frame, ground in enumerate(blended)])
    queries = drawn(60, 10, 0)
    outcome = refined(video, queries, ways)
    share = [outcome.found[:, frame][outcome.seen[:, frame]].mean() for frame in range(1, FRAMES)]
    assert share[0] > 0.7
    assert min(share[3:]) > 0.25  # a third to a half of what is seen there is other than in the query's frame
    assert np.median(outcome.errors_before) > 1.2
    assert np.median(outcome.errors[outcome.found[outcome.seen]]) < 0.5


def test_a_little_better_is_no_sign():
    """Surfaces that look a little different in each frame, and answers that are right."""
    ways = Motion(turn=0, zoom=1, pan=(-2.5, 0.5))
    grounds = [texture(1) * 0.93 + (texture(30 + frame) - 128) * 0.35 for frame in range(FRAMES)]
    video = np.stack([photographed(ways, ground)[frame] for frame, ground in enumerate(grounds)])
    outcome = refined(video, drawn(40, 15), ways, error=0.0)
    assert outcome.found[outcome.seen].mean() < 0.05
    assert np.median(outcome.errors) < 0.001


@pytest.mark.parametrize("kind", ["flat", "stripes"])
def test_what_has_no_texture_stays(kind: str):
    ways = Motion(turn=0, zoom=1, pan=(-2.5, 0), box_start=(-400, 0), box_velocity=(0, 0))
    ground = np.full((HEIGHT, WIDTH, 3), 120, np.float32)
    if kind == "stripes":
        ground += 50 * np.sin(np.arange(HEIGHT) / 3)[:, None, None].astype(np.float32)
    video = photographed(ways, ground)
    video = (video + np.random.default_rng(0).integers(0, 4, video.shape)).astype(np.uint8)
    queries = drawn(40, 11)
    found = refined(video, queries, ways).found
    assert found[queries[:, :1] != np.arange(FRAMES)].mean() < 0.01


@pytest.mark.parametrize(("units", "share"), [(1.7, 0.5), (2.1, 0)])
def test_what_is_farther_than_a_model_errs_is_something_else(video: npt.NDArray[np.uint8], units: float, share: float):
    tracker = ErringTracker(MOTION, offset=units * WIDTH / 256)
    tracks = tracker.track(drawn(30, 12, 0), [1])
    after = refine(tracker, tracks, video)
    assert after.refined is not None
    found = after.refined[~tracks.occluded].mean()
    assert found > share if share else found == 0


def test_fine_texture_is_found_from_afar():
    fine = photographed(MOTION, texture(1, 0.2))
    tracker = ErringTracker(MOTION, offset=1.5 * WIDTH / 256)
    tracks = tracker.track(drawn(40, 18, 0), [1])
    after = refine(tracker, tracks, fine)
    assert after.refined is not None
    assert after.refined[~tracks.occluded].mean() > 0.85


def test_another_picture_stays_as_it_is(video: npt.NDArray[np.uint8]):
    other = video.copy()
    other[4] = photographed(MOTION, texture(20))[4][::-1]
    found = refined(other, drawn(60, 13, 1)).found
    assert not found[:, 4].any()
    assert found[:, 5].any()


@pytest.mark.parametrize(("margin", "share"), [(-0.5, 0), (4, 0.5)])
def test_at_the_frames_border(margin: float, share: float):
    still = Motion(turn=0, zoom=1, pan=(0.3, -0.4), box_start=(300, 60), box_velocity=(0, 0))
    queries = np.array(
        [
            *((2, x, y) for x in np.linspace(margin, WIDTH - 1 - margin, 24) for y in (margin, HEIGHT - 1 - margin)),
            *((2, x, y) for x in (margin, WIDTH - 1 - margin) for y in np.linspace(margin, HEIGHT - 1 - margin, 12)),
        ],
        np.float32,
    )
    outcome = refined(photographed(still), queries, still, error=3.0)
    assert np.isfinite(outcome.after.xy).all()
    assert outcome.found[outcome.seen].mean() >= share
    assert (outcome.errors > outcome.errors_before + 0.1).mean() < 0.01


@pytest.mark.parametrize(("margin", "share"), [(2, 0.3), (6, 0.5), (12, 0.7)])
def test_at_an_objects_border(video: npt.NDArray[np.uint8], margin: float, share: float):
    along = np.linspace(10, BOX[0] - 11, 30)
    inside = np.stack([along, np.full(30, margin)], axis=1)
    queries = np.concatenate([np.full((30, 1), 2.0), MOTION.box(2) + inside], axis=1).astype(np.float32)
    outcome = refined(video, queries, error=2.0)
    assert outcome.found[outcome.seen].mean() >= share
    assert (outcome.errors > outcome.errors_before + 0.2).mean() < 0.01


def test_the_surface_behind_does_not_take_a_point_along():
    ways = Motion(turn=0, zoom=1, pan=(-2, 0), box_velocity=(-0.4, 1.3))
    faint = 0.2 * (texture(2, height=int(BOX[1]), width=int(BOX[0])) - 128) + 128
    along = np.linspace(10, BOX[0] - 11, 40)
    inside = np.concatenate([np.stack([along, np.full(40, margin)], axis=1) for margin in (2.0, 3.5, 5.0)])
    queries = np.concatenate([np.full((len(inside), 1), 2), ways.box(2) + inside], axis=1).astype(np.float32)
    outcome = refined(photographed(ways, box=faint), queries, ways, error=0.6)
    assert outcome.found[outcome.seen].mean() > 0.15
    assert not (outcome.errors > outcome.errors_before + 0.3).any()


class Reading:
    """Frames that note when they are read."""

    def __init__(self, video: npt.NDArray[np.uint8]) -> None:
        self.shape, self.read, self._video = video.shape, [], video

    def __getitem__(self, index: int, /) -> npt.NDArray[np.uint8]:
        self.read.append(index)
        return self._video[index]


def test_frames_are_read_in_order_and_only_where_wanted(video: npt.NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("decomo_runtime.refinement.BLOCK", 2)
    tracker = ErringTracker(MOTION)
    for asked_in, frames, read in (
        (0, None, [0, 1, 2, 3, 4, 5, 6]),
        (6, None, [6, 4, 5, 2, 3, 0, 1]),
        (3, [6, 1, 5], [3, 5, 6, 1]),
        (3, [3], [3]),
    ):
        reading = Reading(video)
        refine(tracker, tracker.track(drawn(9, 14, asked_in), frames), reading)
        assert reading.read == read


def test_other_clips_are_refused(video: npt.NDArray[np.uint8]):
    tracker = ErringTracker(MOTION)
    tracks = tracker.track(drawn(3))
    with pytest.raises(RefinementError, match=r"7 frames of 760x200 of planes, .* \[6, 200, 760, 3\]"):
        refine(tracker, tracks, video[1:])
    with pytest.raises(RefinementError, match="tracks are of frames of 200x760 but planes has frames of 760x200"):
        refine(tracker, replace(tracks, size=(WIDTH, HEIGHT)), video)
