"""Edits on the sliding square, by a tracker that answers truly."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from decomo_runtime import Edit, RenderError, draw_edits, edits, read_edit
from decomo_runtime.options import DYNAMIC, SEEN, STATIC
from tiny_fit import FRAMES, HEIGHT, SCENE_VELOCITY, SQUARE, SQUARE_START, SQUARE_VELOCITY, WIDTH, sliding_square
from true_tracker import TrueTracker, square_mask

RED = (250, 20, 30)
PAINTED = 3


def painted(box: tuple[int, int, int, int], factor: int = 1) -> np.ndarray:
    """RGBA, red in a box (x, y, width, height) of the clip's pixels, `factor` times the clip's size."""
    picture = np.zeros((HEIGHT * factor, WIDTH * factor, 4), np.uint8)
    x, y, width, height = (factor * each for each in box)
    picture[y : y + height, x : x + width] = (*RED, 255)
    return picture


def red(picture: np.ndarray) -> np.ndarray:
    """[H, W]: where a picture is of the edit's colour."""
    return np.abs(picture[..., :3].astype(int) - RED).max(axis=2) <= 3


def drawn(edit: Edit | list[Edit], frame: int, **options: bool) -> np.ndarray:
    tracker, clip = TrueTracker(), sliding_square()
    given = edit if isinstance(edit, list) else [edit]
    return next(draw_edits(tracker, clip.frames, given, [frame], **options))  # type: ignore[arg-type]


def moved_box(box: tuple[int, int, int, int], velocity: np.ndarray, frame: int) -> tuple[slice, slice]:
    x, y = (np.array(box[:2]) + (frame - PAINTED) * velocity).astype(int)
    return slice(y, y + box[3]), slice(x, x + box[2])


SCENE_BOX = (28, 4, 6, 5)
SQUARE_BOX = (10, 13, 6, 6)
BOTH_BOX = (4, 11, 16, 8)
"""Over the square's left edge, and the scene beside it: in frame 3 it begins at x = 8."""


@pytest.mark.parametrize("factor", [1, 3])
@pytest.mark.parametrize("frame", [0, PAINTED, 6])
@pytest.mark.parametrize(("box", "velocity"), [(SCENE_BOX, SCENE_VELOCITY), (SQUARE_BOX, SQUARE_VELOCITY)])
def test_an_edit_moves_with_what_it_is_painted_on(box: tuple, velocity: np.ndarray, frame: int, factor: int):
    picture = drawn(Edit(painted(box, factor), PAINTED), frame)
    where = moved_box(box, velocity, frame)
    inner = slice(where[0].start + 1, where[0].stop - 1), slice(where[1].start + 1, where[1].stop - 1)
    assert red(picture)[inner].all()
    outside = np.ones((HEIGHT, WIDTH), bool)
    outside[where[0].start - 2 : where[0].stop + 2, where[1].start - 2 : where[1].stop + 2] = False
    square, around = square_mask(frame).astype(np.uint8), np.ones((3, 3), np.uint8)
    outside &= cv2.dilate(square, around) == cv2.erode(square, around)  # its rim is soft
    np.testing.assert_array_equal(picture[outside], sliding_square().frames[frame][outside])  # the clip's own pixels


def test_on_the_painted_frame_it_is_as_painted():
    picture = drawn(Edit(painted(SCENE_BOX), PAINTED), PAINTED)
    np.testing.assert_array_equal(red(picture), painted(SCENE_BOX)[..., 3] > 0)


def test_what_is_given_to_the_scene_goes_behind_the_square_and_what_is_given_to_the_square_stays_on_it():
    """Painted over both; the scene's part that the square hid then is shown once it has moved on."""
    edit = painted(BOTH_BOX)
    frame = 7
    on_square = red(drawn(Edit(edit, PAINTED, DYNAMIC), frame))
    on_scene = red(drawn(Edit(edit, PAINTED, STATIC), frame))
    square = cv2.erode(square_mask(frame).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    beside = cv2.dilate(square_mask(frame).astype(np.uint8), np.ones((5, 5), np.uint8)) == 0
    assert not on_square[beside].any()
    assert on_square[square].sum() > 40
    assert not on_scene[square].any()
    where = moved_box(BOTH_BOX, SCENE_VELOCITY, frame)
    expected = np.zeros((HEIGHT, WIDTH), bool)
    expected[where[0].start + 1 : where[0].stop - 1, 1 : where[1].stop - 1] = True
    assert (on_scene | ~beside)[expected].all()
    seen = red(drawn(Edit(edit, PAINTED, SEEN), frame))
    was_hidden = np.zeros_like(seen)
    was_hidden[13:17, 7:13] = True  # of the scene, behind the square when it was painted
    assert on_scene[was_hidden & beside].all()
    assert not seen[was_hidden & beside].any()


def test_the_last_edit_lies_on_top():
    blue = painted(SCENE_BOX)
    blue[blue[..., 3] > 0] = (0, 0, 255, 255)
    over = drawn([Edit(painted(SCENE_BOX), PAINTED), Edit(blue, PAINTED)], PAINTED)
    under = drawn([Edit(blue, PAINTED), Edit(painted(SCENE_BOX), PAINTED)], PAINTED)
    assert (red(over).sum(), red(under).sum()) == (0, SCENE_BOX[2] * SCENE_BOX[3])


def test_alone_it_has_alpha_that_is_not_premultiplied():
    half = painted(SCENE_BOX)
    half[half[..., 3] > 0, 3] = 128
    layer = drawn(Edit(half, PAINTED), PAINTED, alone=True)
    np.testing.assert_array_equal(layer[..., 3], half[..., 3])
    assert red(layer)[half[..., 3] > 0].all()
    composite = drawn(Edit(half, PAINTED), PAINTED)
    clip = sliding_square().frames[PAINTED]
    alpha = half[..., 3:] / 255
    np.testing.assert_allclose(composite, layer[..., :3] * alpha + clip * (1 - alpha), atol=1)


def test_light_is_the_clips():
    tracker, frames = TrueTracker(), sliding_square().frames.copy()
    frames[6] = frames[6] // 2
    grey = painted(SCENE_BOX)
    grey[grey[..., 3] > 0] = (200, 200, 200, 255)
    y, x = moved_box(SCENE_BOX, SCENE_VELOCITY, 6)
    inner = slice(y.start + 1, y.stop - 1), slice(x.start + 1, x.stop - 1)
    for relight, expected in ((False, 200), (True, 100)):
        (picture,) = draw_edits(tracker, frames, [Edit(grey, PAINTED)], [6], relight=relight)  # type: ignore[arg-type]
        np.testing.assert_allclose(picture[inner], expected, atol=8)


def test_in_more_light_a_thin_edit_is_no_brighter_than_it_is_thick():
    """White of a third of the alpha over a frame that is twice as bright: white already, it hides a third as before."""
    tracker, frames = TrueTracker(), sliding_square().frames // 2
    frames[6] *= 2
    white = painted(SCENE_BOX)
    white[white[..., 3] > 0] = (255, 255, 255, 85)
    y, x = moved_box(SCENE_BOX, SCENE_VELOCITY, 6)
    inner = slice(y.start + 1, y.stop - 1), slice(x.start + 1, x.stop - 1)
    (picture,) = draw_edits(tracker, frames, [Edit(white, PAINTED)], [6], relight=True)  # type: ignore[arg-type]
    np.testing.assert_allclose(picture[inner], 85 + frames[6][inner] * (2 / 3), atol=2)


def test_reading_an_edit(tmp_path: Path):
    picture = painted(SCENE_BOX)
    cv2.imwrite(str(tmp_path / "a@b.png"), cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA))
    edit = read_edit(f"{tmp_path}/a@b.png@5", DYNAMIC)
    np.testing.assert_array_equal(edit.picture, picture)
    assert (edit.frame, edit.on, edit.name) == (5, DYNAMIC, f"{tmp_path}/a@b.png")
    sixteen = cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA).astype(np.uint16) * 257
    cv2.imwrite(str(tmp_path / "deep.png"), sixteen)
    np.testing.assert_array_equal(read_edit(f"{tmp_path}/deep.png@5").picture, picture)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("logo.png", "--edit logo.png is not PICTURE@T"),
        ("@3", "--edit @3 is not PICTURE@T"),
        ("logo.png@first", "is not PICTURE@T"),
        ("no.png@0", r"--edit no.png cannot be read \(No such file"),
        ("text.png@0", "--edit text.png does not decode as an image"),
    ],
)
def test_what_is_no_edit(text: str, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    Path("text.png").write_text("no picture")
    with pytest.raises(RenderError, match=sentence):
        read_edit(text)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda: Edit(painted(SCENE_BOX), FRAMES), "over frame 8, which must be within 0 .. 7"),
        (lambda: Edit(np.zeros((HEIGHT, WIDTH, 4), np.uint8), 0), "transparent everywhere"),
        (lambda: Edit(np.full((HEIGHT, WIDTH, 4), 255, np.uint8), 0), "has no alpha, or is opaque everywhere"),
        (lambda: Edit(painted(SCENE_BOX)[:, :-2], 0), "is 38x28, of another shape than the clip's frames of 40x28"),
        (lambda: Edit(painted(SCENE_BOX)[..., :3], 0), r"must be RGBA, uint8 \[h, w, 4\], got uint8 \(28, 40, 3\)"),
        (lambda: Edit(painted(SCENE_BOX), 0, "sky"), "cannot be on 'sky'; choose from seen, static, dynamic"),
    ],
)
def test_edits_that_do_not_fit(change: Callable[[], Edit], sentence: str):
    with pytest.raises(RenderError, match=sentence):
        draw_edits(TrueTracker(), sliding_square().frames, [change()], [0])  # type: ignore[arg-type]


def test_a_picture_of_the_shape_that_is_shown_fits_a_clip_whose_pixels_are_not_square():
    from dataclasses import replace

    facts = replace(TrueTracker().facts, pixel_aspect=1.5)
    for width in (WIDTH, WIDTH * 3 // 2):
        picture = np.zeros((HEIGHT, width, 4), np.uint8)
        picture[3:9, 4:9] = 255
        edits.check_edit(Edit(picture, 0), facts)


def test_the_square_is_where_these_tests_take_it_to_be():
    assert SQUARE_START[0] + PAINTED * SQUARE_VELOCITY[0] == 8
    assert SQUARE == 12
