"""However long a clip is, no more of it is held than one frame looks at, and none is read again and again."""

from __future__ import annotations

import weakref
from collections import Counter
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from decomo_runtime import Edit, OverlayError, Stabilisation, draw_edits, draw_stabilised, propagate, remove_objects
from decomo_runtime import footage as footage_module
from decomo_runtime.footage import BESIDE, Footage, check_footage, others_of
from decomo_runtime.propagation.shapes import Annotation
from decomo_runtime.stabilisation import Still
from decomotion.frames import Frames, Image, Source
from tiny_fit import FRAMES, sliding_square
from true_tracker import TrueTracker

HEIGHT, WIDTH = 18, 30
SMALL = 6, 10
ROOM = 82
"""Whole frames that may be held, as of 1920x1080: those that one frame looks at, and not all between them."""


class Film(Source):
    """Frames of one level each, made when they are read; knows how often each was, and how many there are at most."""

    def __init__(self, count: int, known: Film | None = None) -> None:
        self.shape = (count, HEIGHT, WIDTH, 3)
        self.reads: Counter[int] = known.reads if known else Counter()
        self.alive: list[int] = known.alive if known else [0, 0]
        """Now, and at most."""
        self.back: list[int] = known.back if known else []
        """Frames that were asked for after later ones."""
        self._last = -1

    def again(self) -> Film:
        return Film(self.shape[0], self)

    def read(self, number: int) -> Image:
        if number < self._last:
            self.back.append(number)
        self._last = number
        self.reads[number] += 1
        image = np.full(self.shape[1:], number % 251, np.uint8)
        self.alive[0] += 1
        self.alive[1] = max(self.alive)
        weakref.finalize(image, self._gone)
        return image

    def digest(self, numbers: range) -> str:
        return repr(numbers)

    def _gone(self) -> None:
        self.alive[0] -= 1


def looked_at(film: Film, wanted: range) -> None:
    """Asks for what frames look at, one after the other, as where no object ever leaves its place."""
    count = film.shape[0]
    footage = Footage(Frames(film), (HEIGHT, WIDTH), SMALL)
    for frame in wanted:
        footage.leave_behind(frame)
        assert footage[frame].max() == frame % 251
        for other in others_of(frame, count):
            for near in (max(0, other - BESIDE), min(count - 1, other + BESIDE)):
                assert footage.small(near).min() == near % 251
            assert footage[other].max() == other % 251


@pytest.fixture
def little_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(footage_module, "HELD_BYTES", ROOM * HEIGHT * WIDTH * 3)


@pytest.mark.usefixtures("little_room")
def test_what_is_held_does_not_grow_with_the_clip():
    most = []
    for count in (330, 990):
        film = Film(count)
        looked_at(film, range(count // 2 - 20, count // 2 + 20))
        most.append(film.alive[1])
    assert max(most) <= ROOM + 2  # and one that each reader brings


@pytest.mark.usefixtures("little_room")
def test_no_frame_is_read_more_than_twice_and_both_readers_go_on_in_order():
    film = Film(330)
    looked_at(film, range(330))
    assert set(film.reads) == set(range(330))
    assert max(film.reads.values()) == 2
    assert len(film.back) < 8  # at the beginning, where those before and behind the first are looked at


def test_where_there_is_room_each_is_read_once():
    film = Film(330)
    looked_at(film, range(330))
    assert max(film.reads.values()) == 1


@pytest.mark.parametrize("of", [np.asarray, Frames.again])
def test_arrays_and_parts_serve_too(of: Callable[[Frames], Frames]):
    footage = Footage(of(Frames(Film(60))[7:40]), (HEIGHT, WIDTH), SMALL)
    assert [int(footage[frame].max()) for frame in (20, 0, 32)] == [27, 7, 39]
    assert len(footage) == 33


def test_small_ones_are_means():
    image = np.random.default_rng(0).integers(0, 256, (1, HEIGHT, WIDTH, 3), dtype=np.uint8)
    expected = cv2.resize(image[0], SMALL[::-1], interpolation=cv2.INTER_AREA)
    np.testing.assert_array_equal(Footage(image, (HEIGHT, WIDTH), SMALL).small(0), expected)


def others() -> list[Any]:
    """What is given in place of a clip's frames by mistake."""
    frames = np.asarray(sliding_square().frames)
    return [
        frames[:-1],
        frames[:, :-2],
        frames[..., 0],
        frames / 255,
        list(frames[:, :, :-2]),
        [],
        Frames(Film(FRAMES)),
    ]


class TestFramesOfAnotherClip:
    @pytest.mark.parametrize("which", range(7))
    @pytest.mark.parametrize(
        "draw",
        [
            remove_objects,
            lambda tracker, frames, wanted: draw_edits(tracker, frames, list[Edit](), wanted),
            lambda tracker, frames, _: draw_stabilised(tracker, frames, nothing_moved()),
            lambda tracker, frames, _: propagate(tracker, Annotation((1, 1), (), ()), frames),
        ],
        ids=["remove", "edits", "still", "propagate"],
    )
    def test_are_refused_before_any_work(self, draw: Callable[..., object], which: int):
        frames = others()[which]
        with pytest.raises(OverlayError, match=r"to the 8 frames of 40x28 of sliding, .* but the frames given are "):
            draw(TrueTracker(), frames, [0])

    def test_of_frames_that_are_made_when_asked_for_none_is_made(self):
        class Made:
            def __len__(self) -> int:
                return FRAMES

            def __getitem__(self, frame: int, /) -> Image:
                raise AssertionError

        check_footage(Made(), TrueTracker().facts)
        for same in (sliding_square().frames, list(sliding_square().frames)):
            check_footage(same, TrueTracker().facts)


def nothing_moved() -> Stabilisation:
    known, matrices = np.ones(1, bool), np.eye(3)[None]
    return Stabilisation(np.zeros(1, np.int64), matrices, known, Still("scene"), (28, 40), np.zeros(1))
