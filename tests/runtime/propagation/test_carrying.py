"""Regions, boxes and keypoints of the sliding square, carried by a tracker that knows where it goes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from decomo_runtime import AnnotationError, Tracks, propagate
from decomo_runtime.propagation.carrying import Finding
from decomo_runtime.propagation.outlines import box_around, filled, outlines
from decomo_runtime.propagation.points import _in_box, _moved, carry_points
from decomo_runtime.propagation.report import Report
from decomo_runtime.propagation.rim import Guide
from decomo_runtime.propagation.shapes import Annotation, Kind, Shape, Thing
from tiny_fit import FRAMES, HEIGHT, SQUARE_VELOCITY, WIDTH, sliding_square
from true_tracker import TrueTracker, square_mask

SIZE = HEIGHT, WIDTH


class Fading(TrueTracker):
    """Sees points in its query's frame and so many around it."""

    def __init__(self, reach: int) -> None:
        super().__init__()
        self.reach = reach

    def track(self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None) -> Tracks:
        tracks = super().track(queries, frames)
        gap = np.abs(tracks.frames - tracks.queries[:, :1])
        occlusion = np.maximum(tracks.occlusion, gap > self.reach).astype(np.float32)
        return replace(tracks, occlusion=occlusion, occluded=occlusion > 0.5, error=gap.astype(np.float32))


def annotation(*shapes: Shape, things: int = 1, size: tuple[int, int] = SIZE) -> Annotation:
    return Annotation(size, tuple(Thing(number, f"thing {number}") for number in range(things)), shapes)


def square(frame: int, thing: int = 0) -> Shape:
    return Shape(thing, frame, Kind.MASK, mask=square_mask(frame))


def carried(given: Annotation, tracker: Any = None, **options: Any) -> list[tuple[list[Shape], Any]]:
    return list(propagate(tracker or TrueTracker(), given, **options))


def overlap(mask: npt.NDArray[np.bool_] | None, truth: npt.NDArray[np.bool_]) -> float:
    assert mask is not None
    return float((mask & truth).sum() / (mask | truth).sum())


@pytest.mark.parametrize("with_clip", [True, False])
def test_a_mask_follows_its_object(with_clip: bool):
    frames = sliding_square().frames if with_clip else None
    for frame, (shapes, findings) in enumerate(carried(annotation(square(3)), frames=frames)):
        assert overlap(shapes[0].mask, square_mask(frame)) > 0.9
        assert (shapes[0].frame, shapes[0].kind, findings[0].drawn) == (frame, Kind.MASK, frame == 3)
        assert findings[0].confidence > 0.8
        assert findings[0].in_sight > 0.8


def test_what_is_drawn_stays_as_it_is():
    drawn = square(2)
    assert carried(annotation(drawn))[2][0] == [drawn]


def test_points_in_sight_nowhere_go_by_their_owner_and_colours():
    """Nothing can be followed: the square is found by what its own frame teaches of its looks."""
    (shapes, findings) = carried(annotation(square(0)), Fading(2), frames=sliding_square().frames)[5]
    assert overlap(shapes[0].mask, square_mask(5)) > 0.7
    assert findings[0].in_sight == 0
    assert findings[0].confidence < 0.95


def test_two_objects_keep_their_numbers():
    left = square_mask(0).copy()
    left[:, int(np.flatnonzero(left.any(axis=0)).mean()) :] = False
    shapes = Shape(0, 0, Kind.MASK, mask=left), Shape(1, 0, Kind.MASK, mask=square_mask(0) & ~left)
    for frame, (found, _) in enumerate(carried(annotation(*shapes, things=2))):
        moved = np.roll(left, int(frame * SQUARE_VELOCITY[0]), axis=1)
        assert [shape.thing for shape in found] == [0, 1]
        assert overlap(found[0].mask, moved) > 0.8
        assert overlap(found[1].mask, square_mask(frame) & ~moved) > 0.8


@pytest.mark.parametrize("reach", [5, 9])
def test_of_two_annotated_frames_the_nearer_speaks(reach: int):
    """The second annotation is of a smaller thing: near it the mask is smaller. Both may see all frames."""
    small = square_mask(7).copy()
    small[: HEIGHT // 2 + 2] = False
    found = carried(annotation(square(0), Shape(0, 7, Kind.MASK, mask=small)), Fading(reach))
    assert overlap(found[1][0][0].mask, square_mask(1)) > 0.9
    assert overlap(found[6][0][0].mask, square_mask(6)) < 0.75


def test_where_a_point_is_seen_best_outvotes_many_that_are_less_sure():
    """Frame 5, nearest to 3, has the whole square, three others a part of it."""
    small = {frame: square_mask(frame) & (np.indices(SIZE)[0] >= HEIGHT // 2 + 2) for frame in (0, 6, 7)}
    found = carried(annotation(square(5), *(Shape(0, t, Kind.MASK, mask=mask) for t, mask in small.items())), Fading(9))
    assert overlap(found[3][0][0].mask, square_mask(3)) > 0.9


def test_disagreement_tells_object_frame_and_annotations():
    wrong = np.roll(square_mask(6), 6, axis=0)
    given = annotation(square(0), square(3), Shape(0, 6, Kind.MASK, mask=wrong))
    findings = [each for _, found in carried(given) for each in found]
    worst = Report(given.things, tuple(findings)).worst(region=True)
    assert {each.between for each in worst} == {(0, 6)} or worst[0].between in {(0, 6), (3, 6)}
    assert worst[0].disagreement == pytest.approx(1 - 6 / 18, abs=0.1)
    right = [each for _, found in carried(annotation(square(0), square(6))) for each in found]
    assert max(each.disagreement for each in right) < 0.1


def test_a_frame_says_nothing_of_objects_that_are_not_drawn_in_it():
    """The second object is drawn in frame 6 alone: frame 0, which does not have it, does not take it away."""
    patch = np.zeros(SIZE, bool)
    patch[:6, 20:30] = True
    found = carried(annotation(square(0), Shape(1, 6, Kind.MASK, mask=patch), things=2))
    moved = np.roll(patch, 1, axis=1)  # the scene goes left, a pixel a frame
    assert overlap({each.thing: each for each in found[5][0]}[1].mask, moved) > 0.6


def test_keypoints_follow_and_the_annotation_in_sight_is_asked():
    places = np.array([[5.0, 12.0], [30.0, 3.0], [np.nan, np.nan]])
    shape = Shape(0, 0, Kind.POINTS, xy=places, occluded=np.zeros(3, bool))
    found = carried(annotation(shape))
    np.testing.assert_allclose(found[4][0][0].xy[:2], [[13, 12], [26, 3]])
    assert np.isnan(found[4][0][0].xy[2]).all()
    assert found[4][1][0].confidence == 1
    near = carry_points(
        Fading(3),  # type: ignore[arg-type]
        {0: (places[:1], np.zeros(1, bool)), 7: (places[:1] + np.array([20, 0]), np.zeros(1, bool))},
        np.arange(FRAMES),
    )
    np.testing.assert_allclose(near.xy[0, :, 0], [5, 7, 9, 11, 19, 21, 23, 25])
    assert not near.occluded.any()


class Misled(Fading):
    """Thinks to be surest of what is hidden."""

    def track(self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None) -> Tracks:
        tracks = super().track(queries, frames)
        assert tracks.error is not None
        return replace(tracks, error=FRAMES - tracks.error)


def test_an_annotation_that_has_a_point_in_sight_goes_before_a_surer_one():
    place, seen = np.array([[5.0, 12.0]]), np.zeros(1, bool)
    placed = carry_points(Misled(3), {0: (place, seen), 7: (place + np.array([20, 0]), seen)}, np.arange(FRAMES))  # type: ignore[arg-type]
    np.testing.assert_allclose(placed.xy[0, :, 0], [5, 7, 9, 11, 19, 21, 23, 25])


def test_a_guess_of_a_hidden_point_is_not_followed_where_it_is_drawn_in_sight():
    place = np.array([[5.0, 12.0]])
    drawn = {0: (place, np.zeros(1, bool)), 6: (place + np.array([20, 0]), np.ones(1, bool))}
    placed = carry_points(TrueTracker(), drawn, np.arange(FRAMES))  # type: ignore[arg-type]
    np.testing.assert_allclose(placed.xy[0, :, 0], 5 + 2 * np.arange(FRAMES))
    assert np.isnan(placed.disagreement).all()


def test_what_is_drawn_later_lies_on_top():
    left = square_mask(0) & (np.indices(SIZE)[1] < 8)
    below, above = square(0), Shape(1, 0, Kind.MASK, mask=left)
    found = carried(annotation(below, above, things=2))[1][0]
    assert overlap(found[1].mask, np.roll(left, 2, axis=1)) > 0.8
    assert overlap(found[0].mask, square_mask(1) & ~np.roll(left, 2, axis=1)) > 0.8


def test_keypoints_that_disagree_do_so_in_pixels():
    drawn = {frame: (np.array([[5.0 + 2 * frame + 3 * (frame == 6), 12.0]]), np.zeros(1, bool)) for frame in (0, 6)}
    placed = carry_points(TrueTracker(), drawn, np.arange(FRAMES))  # type: ignore[arg-type]
    np.testing.assert_allclose(placed.disagreement, 3)
    assert (placed.between == (0, 6)).all()


def test_a_point_that_leaves_is_a_gap():
    shape = Shape(0, 0, Kind.POINTS, xy=np.array([[2.0, 3.0]]), occluded=np.zeros(1, bool))
    found = carried(annotation(shape))
    assert [bool(shapes) for shapes, _ in found] == [True] * 3 + [False] * 5
    assert [findings[0].gap for _, findings in found] == [False] * 3 + [True] * 5


def test_a_box_moves_as_what_is_in_it():
    around = box_around(square_mask(1)) + np.array([[-2, -2], [2, 2]])
    found = carried(annotation(Shape(0, 1, Kind.BOX, xy=around, occluded=np.zeros(2, bool))))
    for frame in range(FRAMES - 1):
        moved = around + (frame - 1) * SQUARE_VELOCITY
        np.testing.assert_allclose(found[frame][0][0].xy, moved.clip(-0.5, (WIDTH - 0.5, HEIGHT - 0.5)), atol=0.1)


def test_a_box_without_points_in_sight_is_a_gap():
    shape = Shape(0, 0, Kind.BOX, xy=box_around(square_mask(0)), occluded=np.zeros(2, bool))
    found = carried(annotation(shape), Fading(3))
    assert [findings[0].gap for _, findings in found] == [False] * 4 + [True] * 4


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (annotation(), "nothing is drawn"),
        (annotation(square(0), size=(HEIGHT, WIDTH + 1)), "of frames of 41x28 but the clip is 40x28"),
        (annotation(replace(square(0), frame=FRAMES)), "frame 8 but the clip has frames 0 to 7"),
    ],
)
def test_another_clip_s_annotation_is_refused(given: Annotation, sentence: str):
    with pytest.raises(AnnotationError, match=sentence):
        propagate(TrueTracker(), given)  # type: ignore[arg-type]


def test_a_polygon_is_the_pixels_of_which_half_is_within():
    polygon = np.array([[1.5, 2.5], [6.5, 2.5], [6.5, 4.5], [1.5, 4.5]])
    truth = np.zeros((7, 9), bool)
    truth[3:5, 2:7] = True
    np.testing.assert_array_equal(filled([polygon], (7, 9)), truth)
    np.testing.assert_array_equal(filled([polygon + 0.4], (7, 9)), truth)
    assert not filled([polygon + 20], (7, 9)).any()


def test_outlines_lead_back_to_their_mask():
    y, x = np.mgrid[:50, :70]
    mask = ((x - 30) ** 2 + (y - 20) ** 2 < 15**2) | (x > 60)
    rims = outlines(mask)
    assert len(rims) == 2
    assert overlap(filled(rims, mask.shape), mask) > 0.95


def test_the_rim_goes_to_the_picture_s_edge():
    full = np.zeros((180, 450, 3), np.float32)
    full[:, 227:] = (0.8, 0.3, 0.1)
    small = full[1::3, 1::3].copy()
    soft = np.zeros(small.shape[:2], np.float32)
    soft[:, 77:] = 1  # a pixel of the small raster off, three of the picture
    rim = Guide(small, full)(soft) > 0.5
    assert rim[:, 229:].all()  # of 231
    assert not rim[:, :226].any()


def test_points_are_as_sure_as_they_are_in_sight():
    """One of two is told; it is seen in three frames around."""
    places = np.array([[5.0, 12.0], [np.nan, np.nan]])
    placed = carry_points(Fading(3), {0: (places, np.zeros(2, bool))}, np.arange(FRAMES))  # type: ignore[arg-type]
    assert placed.in_sight.tolist() == placed.confidence.tolist() == [1] * 4 + [0] * 4


def test_a_box_grows_as_the_points_in_it_go_apart():
    """Twice as wide and half as high; along an axis on which they lie within a pixel it only moves."""
    box = np.array([[0.0, 10], [10, 30]])
    here = np.stack(np.meshgrid(np.arange(1.0, 10), np.arange(12.0, 29)), axis=-1).reshape(-1, 2)
    there = here * (2, 0.5) + (5, -3)
    np.testing.assert_allclose(_moved(box, here, there), box * (2, 0.5) + (5, -3))
    line = np.stack([np.linspace(4.5, 5.5, 9), np.arange(12.0, 21)], axis=-1)
    np.testing.assert_allclose(_moved(box, line, line * (9, 2)), [[45 - 5, 32 - 12], [45 + 5, 32 + 28]])


@pytest.mark.parametrize(("columns", "own"), [(3, True), (2, False)])
def test_a_box_is_of_what_moves_in_a_quarter_of_it(columns: int, own: bool):
    """It has 12 points across its shorter side, and ten columns of which so many are an object's."""
    tracker = TrueTracker()
    tracker.on_object = lambda points: np.asarray(points)[:, 1] < columns  # type: ignore[method-assign]
    queries = _in_box(tracker, np.array([[-0.5, -0.5], [9.5, 19.5]]), 2)  # type: ignore[arg-type]
    assert (queries[:, 0] == 2).all()
    assert len(queries) == 20 * (columns if own else 10)
    assert (queries[:, 1] < columns).all() == own


def test_the_worst_frame_of_each_pair_is_told():
    def finding(frame: int, disagreement: float | None, pair: tuple[int, int], kind: Kind = Kind.MASK) -> Finding:
        return Finding(frame, 0, kind, False, 1.0, False, 1.0, disagreement, pair)

    found = (
        finding(1, 0.2, (0, 6)),
        finding(2, 0.4, (0, 6)),
        finding(2, 0.9, (3, 6)),
        finding(3, 0.3, (0, 3)),
        finding(4, 0.1, (0, 9)),
        finding(5, None, (0, 7)),
        finding(6, 30.0, (0, 6), Kind.BOX),
    )
    report = Report((Thing(0, "thing"),), found)
    assert [(each.frame, each.disagreement) for each in report.worst(region=True)] == [(2, 0.9), (2, 0.4), (3, 0.3)]
    assert [each.frame for each in report.worst(region=False)] == [6]


def test_outlines_begin_with_the_largest_and_lie_on_the_pixels():
    mask = np.zeros((20, 40), bool)
    mask[2:5, 1:6] = mask[8:16, 20:36] = True
    large, small = outlines(mask)
    np.testing.assert_allclose([large.min(axis=0), large.max(axis=0)], [[19.6, 7.6], [35.4, 15.4]], atol=0.05)
    np.testing.assert_allclose([small.min(axis=0), small.max(axis=0)], [[0.6, 1.6], [5.4, 4.4]], atol=0.05)
