from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from decomo_runtime import ModelFacts, OverlayError, Tracks, overlay
from decomo_runtime.overlay import Painter, check_clip, contact_sheet, draw_tracks, rainbow
from decomotion.clip import Clip


def tracks_at(xy: Sequence[Sequence[tuple[float, float]]], occluded: list[list[bool]], frames: list[int]) -> Tracks:
    places, hidden = np.array(xy, np.float32), np.array(occluded)
    queries = np.concatenate([np.zeros((len(places), 1), np.float32), places[:, 0]], axis=1)
    return Tracks(places, hidden, hidden.astype(np.float32), queries, np.array(frames))


def grey_clip(frames: int, height: int, width: int) -> np.ndarray:
    return np.full((frames, height, width, 3), 100, np.uint8)


def inked(frame: np.ndarray) -> np.ndarray:
    """[H, W] bool: where a frame of the grey clip has colour."""
    return np.ptp(frame.astype(int), axis=-1) > 30


@pytest.mark.parametrize(
    ("height", "width", "expected"),
    [(256, 256, (512, 512)), (40, 48, (440, 528)), (511, 600, (512, 600)), (300, 513, (300, 514)), (1, 1, (512, 512))],
)
def test_canvas_is_legible_and_even(height: int, width: int, expected: tuple[int, int]):
    (frame,) = draw_tracks(grey_clip(1, height, width), tracks_at([[(0, 0)]], [[False]], [0]))
    assert frame.shape == (*expected, 3)
    assert frame.dtype == np.uint8


def test_a_point_in_sight_is_a_disc_at_its_place():
    frame = next(draw_tracks(grey_clip(1, 64, 64), tracks_at([[(20, 10)]], [[False]], [0])))
    rows, columns = np.nonzero(inked(frame))
    factor = 8  # 64 pixels to 512; the centre of pixel (20, 10) is then at (163.5, 83.5)
    assert columns.mean() == pytest.approx((20 + 0.5) * factor - 0.5, abs=0.2)  # antialiasing is not quite even
    assert rows.mean() == pytest.approx((10 + 0.5) * factor - 0.5, abs=0.2)
    assert inked(frame)[83, 163]


def test_an_occluded_point_is_a_ring():
    frame = next(draw_tracks(grey_clip(1, 64, 64), tracks_at([[(20, 10)]], [[True]], [0])))
    assert not inked(frame)[83, 163]
    assert inked(frame)[78:90, 157:171].any()


@pytest.mark.parametrize(("mark", "centre", "corner", "side"), [("cross", True, True, False), ("none",) + (False,) * 3])
def test_other_marks_of_an_occluded_point(mark: str, centre: bool, corner: bool, side: bool):
    """Its radius is 4.6 pixels of the canvas."""
    (frame,) = draw_tracks(grey_clip(1, 64, 64), tracks_at([[(20, 10)]], [[True]], [0]), mark=mark)
    ink = inked(frame)
    assert ink[82:85, 162:165].any() == centre
    assert ink[86:88, 166:168].any() == corner
    assert ink[83, 167:170].any() == side
    assert ink.any() == (mark != "none")


def test_trails_relative_to_the_scene():
    """The camera pans 5 pixels a frame: a point of the scene has no trail, one that stands in the image has."""

    class Pan:
        def carry(self, xy: np.ndarray, frame: int, other: int) -> np.ndarray:
            return xy + np.array([-5.0 * (other - frame), 0])

    scene = [(50 - 5.0 * frame, 10) for frame in range(6)]
    tracks = tracks_at([scene, [(30, 50)] * 6], [[False] * 6] * 2, list(range(6)))
    last = list(draw_tracks(grey_clip(6, 64, 64), tracks, motion=Pan()))[-1]
    columns = [np.flatnonzero(inked(last)[rows].any(axis=0)) for rows in (slice(0, 256), slice(256, 512))]
    assert np.ptp(columns[0]) < 20  # the disc
    assert columns[1].min() < (30 - 20) * 8 < (30 + 1) * 8 < columns[1].max() + 8
    plain = list(draw_tracks(grey_clip(6, 64, 64), tracks))[-1]
    assert np.ptp(np.flatnonzero(inked(plain)[:256].any(axis=0))) > 150


def test_a_picture_of_another_size_is_brought_to_the_canvas():
    painter = Painter(tracks_at([[(20, 10)]], [[False]], [0]), (64, 64))
    frame = painter.draw(np.full((100, 100, 3), 100, np.uint8), 0)
    assert frame.shape == (512, 512, 3)
    assert inked(frame)[83, 163]


def test_the_trail_ends_after_its_length_and_fades():
    clip = grey_clip(6, 64, 64)
    xy = [[(10 * column + 5, 32) for column in range(6)]]
    last = list(draw_tracks(clip, tracks_at(xy, [[False] * 6], list(range(6))), trail=3))[-1]
    background = last[0, 0].astype(int)

    def strength(x: float) -> int:
        return int(np.abs(last[260, int((x + 0.5) * 8 - 0.5)].astype(int) - background).max())

    assert strength(20) == 0  # between frames 1 and 2: four frames ago
    assert 0 < strength(30) < strength(40) < strength(50)


def test_only_the_frames_of_the_tracks_are_drawn():
    clip = grey_clip(4, 64, 64) * np.array([0, 1, 2, 2], np.uint8)[:, None, None, None]
    frames = list(draw_tracks(clip, tracks_at([[(5, 5), (6, 6)]], [[False, False]], [3, 1])))
    assert len(frames) == 2
    assert frames[0][-1, -1, 0] > frames[1][-1, -1, 0]


@pytest.mark.parametrize("far", [(1e9, 0.0), (-1e30, 5.0), (float("nan"), 3.0), (0.0, float("inf"))])
def test_points_far_outside_draw_nothing(far: tuple[float, float]):
    tracks = tracks_at([[(5, 5), far]], [[False, False]], [0, 1])
    assert not inked(list(draw_tracks(grey_clip(2, 64, 64), tracks))[1]).any()


def test_no_points():
    tracks = Tracks(
        np.empty((0, 2, 2), np.float32),
        np.empty((0, 2), bool),
        np.empty((0, 2), np.float32),
        np.empty((0, 3), np.float32),
        np.arange(2),
    )
    assert len(list(draw_tracks(grey_clip(2, 64, 64), tracks))) == 2


def test_the_clip_is_left_as_it_was():
    clip = grey_clip(1, 600, 600)
    next(draw_tracks(clip, tracks_at([[(20, 10)]], [[False]], [0])))
    assert (clip == 100).all()


def test_rainbow_runs_from_red_to_magenta():
    """Saturation 0.75 leaves a quarter of the other channels; red, then halfway round 300 degrees, then magenta."""
    colours = rainbow(np.array([[0, 0, 0], [3, 50, 25], [1, 100, 50]], np.float32))
    np.testing.assert_allclose(colours, [[255, 64, 64], [64, 255, 160], [255, 64, 255]], atol=2)  # 8-bit HSV


@pytest.mark.parametrize("count", [0, 1, 2])
def test_rainbow_of_few_or_equal_places(count: int):
    assert rainbow(np.zeros((count, 3), np.float32)).shape == (count, 3)


def test_contact_sheet():
    frames = [np.full((4, 6, 3), value, np.uint8) for value in (10, 20, 30)]
    sheet = contact_sheet(frames, gap=2)
    assert sheet.shape == (4, 22, 3)
    assert sheet[0, :, 0].tolist() == [10] * 6 + [255] * 2 + [20] * 6 + [255] * 2 + [30] * 6
    np.testing.assert_array_equal(contact_sheet(frames[:1]), frames[0])


def test_check_clip():
    model = ModelFacts("goat", num_frames=3, height=4, width=6, fps=24.0, preset="cpu", occlusion_threshold=0.5)
    check_clip(Clip("goat", np.zeros((3, 4, 6, 3), np.uint8), 24.0), model)
    for shape in ((2, 4, 6, 3), (3, 6, 4, 3)):
        with pytest.raises(OverlayError, match=f"the clip cat has {shape[0]} frames of {shape[2]}x{shape[1]} but"):
            check_clip(Clip("cat", np.zeros(shape, np.uint8), 24.0), model)


def test_rainbow_by_hand():
    """Hue 150 along 0.6 of the width and 0.4 of the height of the box of all queries; a quarter of white in it."""
    places = [(10, 20), (110, 60), (110, 20), (60, 40)]
    queries = np.array([(3, x, y) for x, y in places], np.float32)
    red, magenta, two_thirds, half = rainbow(queries).tolist()
    assert red == [255, 64, 64]
    assert magenta == [255, 64, 255]  # 300 degrees
    assert two_thirds == [64, 255, 255]  # 0.6 * 300 = 180 degrees: cyan
    assert half == [64, 255, 160]  # 150 degrees: between green and cyan


@pytest.mark.parametrize(("points", "radius"), [(1, 2.7), (400, 2.041), (1000, 1.291), (10_000, 0.81), (0, 2.7)])
def test_discs_are_a_sixth_of_the_spacing_within_what_is_legible(points: int, radius: float):
    """Of a canvas of 300 x 200: at most 0.009 of its longer side, and not below 0.3 of that."""
    pen = overlay._pen_for(points, np.zeros((200, 300, 3), np.uint8))
    assert pen.radius == pytest.approx(radius, abs=1e-3)
    assert pen.thickness == max(1, round(0.55 * pen.radius))


def test_a_disc_has_its_ink_and_a_dark_rim():
    frame = grey_clip(1, 600, 900)
    (drawn,) = draw_tracks(frame, tracks_at([[(400, 300)], [(800, 500)]], [[False], [False]], [0]))
    assert drawn[300, 400].tolist() == [255, 64, 64]
    assert drawn[500, 800].tolist() == [255, 64, 255]
    # 0.009 * 900 = 8.1 pixels, then a rim of one, 0.55 black over grey of 0.8 * 100
    assert drawn[300, 407].tolist() == [255, 64, 64]
    assert drawn[300, 412].tolist() == [80, 80, 80]
    assert 36 <= drawn[300, 410].max() < 80


def test_frames_are_muted():
    """0.8 of the light; 0.55 of the colour kept, the rest grey: 0.299, 0.587 and 0.114 of red, green and blue."""
    frame = np.full((1, 600, 900, 3), (200, 100, 0), np.uint8)
    (drawn,) = draw_tracks(frame, tracks_at([[(0, 0)]], [[False]], [0]))
    grey = 0.299 * 200 + 0.587 * 100
    expected = [0.8 * (0.55 * channel + 0.45 * grey) for channel in (200, 100, 0)]
    np.testing.assert_allclose(drawn[300, 400], expected, atol=1)
    (white,) = draw_tracks(np.full((1, 600, 900, 3), 255, np.uint8), tracks_at([[(0, 0)]], [[False]], [0]))
    assert white[300, 400].tolist() == [204] * 3


def test_the_sheet_has_eight_white_pixels_between_frames():
    sheet = contact_sheet([np.zeros((6, 10, 3), np.uint8)] * 3)
    assert sheet.shape == (6, 10 * 3 + 8 * 2, 3)
    assert (sheet[:, 10:18] == 255).all()
    assert not sheet[:, 18:28].any()


def test_a_whole_ink_covers_and_none_leaves_all():
    canvas = np.full((1, 3, 3), 255, np.uint8)
    layer = np.array([[(0, 0, 0, 0), (10, 20, 30, 255), (100, 0, 0, 51)]], np.uint8)
    assert overlay._laid_over(canvas, layer)[0].tolist() == [[255] * 3, [10, 20, 30], [255, 204, 204]]
