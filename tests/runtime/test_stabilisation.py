"""Clips held still, by a tracker that answers truly."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from decomo_runtime import QueryError, RenderError, Tracks, TracksFileError, draw_stabilised, stabilise
from decomo_runtime import Stabilisation as Done
from decomo_runtime.options import CROP, DENSE, FILL, HOMOGRAPHY, NONE, SIMILARITY, TRANSFORMS, TRANSLATION
from decomo_runtime.stabilisation import (
    ANCHORS,
    REACH,
    Still,
    _averaged,
    _fitted,
    _held,
    _is_sane,
    _Pairs,
    format_of_transforms,
)
from tiny_fit import FRAMES, HEIGHT, SCENE_VELOCITY, SQUARE_VELOCITY, WIDTH, sliding_square
from true_tracker import TrueTracker, square_mask


class ShakenTracker(TrueTracker):
    """Of the clip with each frame shifted by `shake` [T, 2], in pixels."""

    def __init__(self, shake: npt.NDArray[np.float64]) -> None:
        super().__init__()
        self.shake = shake

    def track(
        self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None, *, max_memory: int | None = None
    ) -> Tracks:
        asked = np.array(queries, np.float32)
        asked[:, 1:] -= self.shake[asked[:, 0].astype(int)]
        tracks = super().track(asked, frames)
        return replace(tracks, xy=(tracks.xy + self.shake[tracks.frames]).astype(np.float32))


def shifts(done: Done) -> npt.NDArray[np.float64]:
    """[T, 2], by what the middle of each frame is moved."""
    middle = np.array([[[WIDTH / 2, HEIGHT / 2]]])
    return np.stack([cv2.perspectiveTransform(middle, matrix)[0, 0] for matrix in done.matrices]) - middle[0, 0]


@pytest.mark.parametrize(
    ("rows", "sane"),
    [
        ([[7.9, 0, -90], [0, 7.9, 5], [0, 0, 1]], True),
        ([[8.1, 0, 0], [0, 8.1, 0], [0, 0, 1]], False),
        ([[0.13, 0, 0], [0, 0.13, 0], [0, 0, 1]], True),
        ([[0.12, 0, 0], [0, 0.12, 0], [0, 0, 1]], False),
        ([[-1, 0, WIDTH], [0, 1, 0], [0, 0, 1]], False),  # turned over
        ([[0, -1, 9], [1, 0, 0], [0, 0, 1]], True),  # a quarter turn
        ([[1, 0, 0], [0, 1, 0], [-1 / (WIDTH - 4), 0, 1]], False),  # its right edge is beyond the horizon
    ],
)
def test_a_transform_stretches_and_turns_a_frame_within_reason(rows: list[list[float]], sane: bool):
    assert _is_sane(np.array(rows, np.float64), (HEIGHT, WIDTH)) == sane


@pytest.mark.parametrize("by", [TRANSLATION, SIMILARITY, HOMOGRAPHY, DENSE, None])
@pytest.mark.parametrize(
    ("still", "velocity"),
    [
        ("scene@3", SCENE_VELOCITY),
        ("object@3", SQUARE_VELOCITY),
        ("8,10,12,12@3", SQUARE_VELOCITY),
        ("24,2,14,24@3", SCENE_VELOCITY),
    ],
)
def test_what_is_still(still: str, velocity: np.ndarray, by: str | None):
    done = stabilise(TrueTracker(), still, by=by)  # type: ignore[arg-type]
    assert done.known.all()
    expected = -(np.arange(FRAMES) - 3)[:, None] * velocity
    np.testing.assert_allclose(shifts(done), expected, atol=0.05)


def test_smoothing_keeps_the_slow_motion_and_takes_the_shaking_out():
    shake = 2 * np.array([[1.0, -1.0], [-1.0, 1.0]] * (FRAMES // 2))
    done = stabilise(ShakenTracker(shake), "scene", smooth=2.5 / 24, by=TRANSLATION)  # type: ignore[arg-type]
    path = np.arange(FRAMES)[:, None] * SCENE_VELOCITY + shake + shifts(done)
    assert np.abs(np.diff(shake, 2, axis=0)).max() == 8
    assert np.abs(np.diff(path, 2, axis=0)).max() < 0.5
    assert -8 < path[-1, 0] - path[0, 0] < -3  # of 7 that it moved


class EvenPairs:
    """Each frame lies a pixel to the right of the one before; `asked` says between which it was looked."""

    size = HEIGHT, WIDTH

    def __init__(self) -> None:
        self.asked: list[tuple[int, int]] = []

    def between(self, frame: int, other: int) -> np.ndarray:
        self.asked.append((frame, other))
        return np.array([[1.0, 0, other - frame], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize("deviation", [0.4, 1.0, 7.3, 24.0])
def test_a_frame_looks_at_anchors_near_it_alone_however_long_the_clip_is(deviation: float):
    pairs, step = EvenPairs(), max(1, int(deviation / ANCHORS))
    wanted, length = [0, 5, 500_000_000, 999_999_999], 10**9
    found = _averaged(pairs, wanted, deviation, range(length))  # type: ignore[arg-type]
    reach = round(REACH * deviation) + 2 * step
    near = {
        frame: [
            anchor
            for anchor in range(max(0, frame - reach), min(length, frame + reach + 1))
            if anchor % step == 0 and abs(anchor - frame) / deviation <= REACH
        ]
        for frame in wanted
    }
    assert pairs.asked == [(frame, anchor) for frame in wanted for anchor in near[frame]]
    assert found.keys() == {frame for frame in wanted if set(near[frame]) - {frame}}


def test_pictures_of_a_still_scene():
    clip, tracker = sliding_square(), TrueTracker()
    done, pictures = draw_stabilised(tracker, clip.frames, stabilise(tracker, "scene@3"), border=NONE)  # type: ignore[arg-type]
    for frame, picture in enumerate(pictures):
        assert picture.shape == (HEIGHT, WIDTH, 4)
        shift = frame - 3  # to the right
        shown = np.zeros((HEIGHT, WIDTH), bool)
        shown[:, max(0, shift) : WIDTH + min(0, shift)] = True
        np.testing.assert_allclose(picture[..., 3] > 127, shown)
        scene = shown & ~np.roll(square_mask(frame), shift, axis=1) & ~square_mask(3)
        scene[:, : max(0, shift) + 1] = scene[:, WIDTH + min(0, shift) - 1 :] = False
        np.testing.assert_allclose(picture[scene][:, :3], clip.frames[3][scene], atol=6)
    np.testing.assert_array_equal(done.frames, np.arange(FRAMES))


def test_dense_pictures_of_a_still_object():
    clip, tracker = sliding_square(), TrueTracker()
    _, pictures = draw_stabilised(tracker, clip.frames, stabilise(tracker, "object@3", by=DENSE))  # type: ignore[arg-type]
    inner = cv2.erode(square_mask(3).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    for picture in pictures:
        np.testing.assert_allclose(picture[inner][:, :3], clip.frames[3][inner], atol=6)


def test_a_crop_shows_only_what_all_frames_do_and_says_so_in_its_transforms():
    clip, tracker = sliding_square(), TrueTracker()
    still = stabilise(tracker, "scene@3", by=TRANSLATION)  # type: ignore[arg-type]
    done, pictures = draw_stabilised(tracker, clip.frames, still, border=CROP)  # type: ignore[arg-type]
    assert all(picture.shape == (HEIGHT, WIDTH, 3) for picture in pictures)
    for matrix in done.matrices:
        corners = np.array([[[-0.5, -0.5], [WIDTH - 0.5, HEIGHT - 0.5]]])
        inside = cv2.perspectiveTransform(corners, np.linalg.inv(matrix))[0]
        assert (inside >= -0.51).all()
        assert (inside <= np.array([WIDTH, HEIGHT]) - 0.49).all()
    assert done.matrices[0, 0, 0] == pytest.approx(WIDTH / (WIDTH - 7), rel=0.1)  # 4 and 3 pixels are not always shown


def test_a_crop_that_leaves_nothing_is_refused():
    tracker = TrueTracker()
    done = stabilise(tracker, "scene@0", by=TRANSLATION)  # type: ignore[arg-type]
    apart = Done(done.frames, done.matrices.copy(), done.known, done.still, done.size, done.times)
    apart.matrices[-1, 0, 2] += 38
    with pytest.raises(RenderError, match="nothing to crop it to; smooth the motion"):
        draw_stabilised(tracker, sliding_square().frames, apart, border=CROP)  # type: ignore[arg-type]


def test_borders_are_filled_from_frames_that_show_the_scene_there():
    """On a clip that is large enough for the exposure of two frames to be compared."""
    clip, tracker = sliding_square(), TrueTracker()
    still = stabilise(tracker, "scene@3", frames=[0])  # type: ignore[arg-type]
    _, (picture,) = draw_stabilised(tracker, clip.frames, still, border=FILL)  # type: ignore[arg-type]
    assert picture.shape == (HEIGHT, WIDTH, 3)
    beyond = np.zeros((HEIGHT, WIDTH), bool)
    beyond[:, WIDTH - 3 :] = True  # where frame 0, brought to frame 3, ends
    error = np.abs(picture[beyond].astype(int) - clip.frames[3][beyond])
    assert np.median(error) < 8


def test_frames_without_the_object_move_as_those_around(monkeypatch: pytest.MonkeyPatch):
    tracker = TrueTracker()
    track = tracker.track

    def hidden(queries: npt.ArrayLike, frames: npt.ArrayLike | None = None, **_: object):
        tracks = track(queries, frames)
        tracks.occluded[:, np.isin(tracks.frames, (4, 5))] = True
        return tracks

    monkeypatch.setattr(tracker, "track", hidden)
    done = stabilise(tracker, "object@3")  # type: ignore[arg-type]
    np.testing.assert_array_equal(np.flatnonzero(~done.known), [4, 5])
    expected = -(np.arange(FRAMES) - 3)[:, None] * SQUARE_VELOCITY
    np.testing.assert_allclose(shifts(done), expected, atol=0.05)
    smooth = stabilise(tracker, "object@3", smooth=0.1)  # type: ignore[arg-type]
    np.testing.assert_array_equal(np.flatnonzero(~smooth.known), [4, 5])


def test_transforms_as_files(tmp_path: Path):
    tracker = TrueTracker()
    done = stabilise(tracker, "scene@3", by=TRANSLATION, frames=[2, 3, 5])  # type: ignore[arg-type]
    done.save(tmp_path / "a.csv", tracker.facts)
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert [row["frame"] for row in rows] == ["2", "3", "5"]
    assert [float(row["h13"]) for row in rows] == pytest.approx([-1, 0, 2], abs=0.01)
    assert (rows[2]["seconds"], rows[2]["known"], rows[2]["h33"]) == ("0.208333", "1", "1")
    done.save(tmp_path / "a.nk", tracker.facts)
    node = (tmp_path / "a.nk").read_text()
    assert "CornerPin2D" in node
    assert " to1 {{curve x3 -1.0000 x4 0.0000 x6 2.0000}" in node
    assert f" to3 {{{{curve x3 {WIDTH - 1}.0000 x4 {WIDTH}.0000 x6 {WIDTH + 2}.0000}}" in node
    assert format_of_transforms(Path("a.txt.nk")) is not None
    with pytest.raises(TracksFileError, match="does not end as a file of tracks does"):
        format_of_transforms(Path("a.doc"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [("scene", Still("scene")), ("object@12", Still("object", 12)), ("1,2.5,30,4@7", Still("1,2.5,30,4", 7))],
)
def test_what_is_to_be_still(text: str, expected: Still):
    assert Still.parse(text) == expected


@pytest.mark.parametrize("text", ["sky", "scene@", "scene@first", "1,2,3", "object@-1"])
def test_what_is_not(text: str):
    with pytest.raises(RenderError, match="is not scene, object or X,Y,WIDTH,HEIGHT"):
        Still.parse(text)


@pytest.mark.parametrize(
    ("still", "options", "error", "sentence"),
    [
        ("scene@8", {}, RenderError, "the frame of reference, 8, must be within 0 .. 7"),
        ("scene", {"by": "magic"}, RenderError, f"choose from {', '.join(TRANSFORMS)}"),
        ("scene", {"smooth": -1}, RenderError, "must be a time of 0 seconds or more"),
        ("scene", {"smooth": float("nan")}, RenderError, "must be a time of 0 seconds or more"),
        ("scene", {"smooth": 1, "by": DENSE}, RenderError, "leave one out"),
        ("90,90,5,5", {}, QueryError, "--stabilise 90,90,5,5@0 lies outside of the frame"),
        ("a,b,c,d", {}, QueryError, "--stabilise a,b,c,d@0 is not X,Y,WIDTH,HEIGHT@T"),
        ("scene", {"frames": [9]}, QueryError, "frame"),
        ("scene", {"frames": []}, RenderError, "no frame to hold still"),
    ],
)
def test_bad_input(still: str, options: dict, error: type[Exception], sentence: str):
    with pytest.raises(error, match=sentence):
        stabilise(TrueTracker(), still, **options)  # type: ignore[arg-type]


def test_a_scene_without_objects():
    tracker = TrueTracker()
    tracker.on_object = lambda points: np.zeros(len(points), bool)  # type: ignore[method-assign]
    with pytest.raises(RenderError, match="holds nothing in sliding to move by itself"):
        stabilise(tracker, "object")  # type: ignore[arg-type]


class Known:
    """Transforms between frames at `places` [T, 2], which move without turning; None farther than `reach` apart."""

    size = HEIGHT, WIDTH

    def __init__(self, places: npt.ArrayLike, reach: int = 99, scale: float = 1.0) -> None:
        self.places, self.reach, self.scale = np.asarray(places, np.float64), reach, scale

    def between(self, frame: int, other: int) -> np.ndarray | None:
        if abs(frame - other) > self.reach:
            return None
        enlarged = self.scale ** (other - frame)
        shift = self.places[other] - enlarged * self.places[frame]
        return np.array([[enlarged, 0, shift[0]], [0, enlarged, shift[1]], [0, 0, 1]])


@pytest.mark.parametrize(("deviation", "every"), [(2.0, 1), (7.0, 2)])
def test_the_mean_is_weighted_by_time(deviation: float, every: int):
    """By a bell that ends at three deviations, over three frames of each deviation."""
    places = np.random.default_rng(0).uniform(-4, 4, (30, 2))
    found = _averaged(Known(places), [0, 13], deviation, range(30))  # type: ignore[arg-type]
    for frame in (0, 13):
        anchors = [each for each in range(0, 30, every) if abs(each - frame) <= 3 * deviation]
        weights = [np.exp(-0.5 * ((each - frame) / deviation) ** 2) for each in anchors]
        mean = np.average(places[anchors], axis=0, weights=weights)
        np.testing.assert_allclose(found[frame][:2, 2], mean - places[frame], atol=1e-4)  # corners are float32
        np.testing.assert_allclose(found[frame][:2, :2], np.eye(2), atol=1e-5)


def test_a_frame_that_no_other_shows_has_no_mean():
    assert _averaged(Known(np.zeros((5, 2)), reach=0), [2], 1.0, range(5)) == {}  # type: ignore[arg-type]


@pytest.mark.parametrize("reference", [0, 2, 4])
def test_where_two_frames_share_nothing_it_goes_over_those_between(reference: int):
    """Each frame is a tenth larger than the one before, so that the order of steps matters."""
    places = np.array([[0, 0], [3, 1], [-2, 5], [4, 4], [1, -3]], float)
    direct, steps = (Known(places, reach, 1.1) for reach in (99, 1))
    found = _held(steps, reference, range(5))  # type: ignore[arg-type]
    assert sorted(found) == list(range(5))
    for frame, matrix in found.items():
        np.testing.assert_allclose(matrix, direct.between(frame, reference), atol=1e-9)


def test_a_crop_by_hand():
    """Twice as large from (10, 5) on, pixels from the corner: the edge of pixel 10 is the picture's left edge."""
    one = Done(np.arange(1), np.eye(3)[None], np.ones(1, bool), Still("scene"), (HEIGHT, WIDTH), np.zeros(1))
    moved = cv2.perspectiveTransform(np.array([[[9.5, 4.5], [10, 5], [12, 9]]]), one.cropped(10, 5, 2).matrices[0])
    np.testing.assert_allclose(moved[0], [[-0.5, -0.5], [0.5, 0.5], [4.5, 8.5]])


@pytest.mark.parametrize(("form", "least"), [(TRANSLATION, 2), (SIMILARITY, 4), (HOMOGRAPHY, 12)])
def test_few_points_tell_no_transform(form: str, least: int):
    here = np.random.default_rng(0).uniform(0, 28, (least, 2)).astype(np.float32)

    class Motion:
        count = least

        def common(self, frame: int, other: int) -> tuple[np.ndarray, np.ndarray]:
            return here[: self.count], here[: self.count] + np.float32([2, 1])

    motion = Motion()
    matrix = _Pairs(motion, form, (HEIGHT, WIDTH)).between(0, 1)  # type: ignore[arg-type]
    np.testing.assert_allclose(matrix, [[1, 0, 2], [0, 1, 1], [0, 0, 1]], atol=1e-3)
    motion.count -= 1
    assert _Pairs(motion, form, (HEIGHT, WIDTH)).between(0, 1) is None  # type: ignore[arg-type]


@pytest.mark.parametrize("form", [TRANSLATION, SIMILARITY, HOMOGRAPHY])
def test_points_that_go_elsewhere_do_not_count(form: str):
    """A quarter of them, by nine pixels: a transform may be missed by 1.5 units, here a fifth of a pixel."""
    here = np.random.default_rng(0).uniform(0, 28, (80, 2))
    there = here + (2, 1) + np.where(np.arange(80) % 4 == 0, 9, 0)[:, None]
    np.testing.assert_allclose(_fitted(here, there, form, WIDTH / 256), [[1, 0, 2], [0, 1, 1], [0, 0, 1]], atol=1e-3)
