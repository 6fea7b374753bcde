"""Frames at the size that preparation works at: read once, in order, a few at a time, and kept on disk."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decomotion.clip import Clip
from decomotion.config import load
from decomotion.data.working import build_frames, working_clip, working_side
from full_disk import writes_end_at

FRAMES, HEIGHT, WIDTH = 9, 44, 70


def frame(number: int) -> np.ndarray:
    return np.random.default_rng(number).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)


class Decoded(np.ndarray):
    """Frames that are made when they are asked for, and counted: those asked for, and the most that are held."""

    def begin(self) -> None:
        self.asked: list[int] = []
        self.most = 0
        self.held: list[weakref.ref[np.ndarray]] = []

    def __getitem__(self, number: Any) -> np.ndarray:
        self.asked.append(number)
        made = frame(number)
        self.held = [each for each in self.held if each() is not None] + [weakref.ref(made)]
        self.most = max(self.most, len(self.held))
        return made

    def __iter__(self) -> Iterator[np.ndarray]:  # type: ignore[override]
        return (self[number] for number in range(FRAMES))


def test_frames_are_read_once_in_order_and_never_all_in_memory(tmp_path: Path):
    frames = np.broadcast_to(np.uint8(0), (FRAMES, HEIGHT, WIDTH, 3)).view(Decoded)
    frames.begin()
    build_frames(Clip("decoded", frames, 24.0), 35, False, tmp_path)
    assert frames.asked == list(range(FRAMES))
    assert frames.most <= 2


@pytest.mark.parametrize(("side", "size"), [(35, (35, 22)), (70, (70, 44)), (640, (70, 44))])
def test_they_are_reduced_and_never_enlarged(side: int, size: tuple[int, int], tmp_path: Path):
    times = np.arange(FRAMES) ** 1.5
    clip = Clip("noise", np.stack([frame(number) for number in range(FRAMES)]), times=times, pixel_aspect=1.5)
    assert build_frames(clip, side, False, tmp_path) == {"size": size}
    working = working_clip(clip, tmp_path)
    assert (working.width, working.height, working.name, working.pixel_aspect) == (*size, "noise", 1.5)
    np.testing.assert_array_equal(working.times, times)
    for number in (0, FRAMES - 1):
        expected = cv2.resize(frame(number), size, interpolation=cv2.INTER_AREA)
        np.testing.assert_array_equal(working.frames[number], expected)


@pytest.mark.parametrize(("flow", "side"), [("dis", 640), ("raft-large", 1024)])
def test_the_side_is_what_flow_and_the_others_need(flow: str, side: int):
    settings = load("cpu", flow=flow).data.flow
    assert working_side(settings) == side
    assert working_side(settings.model_copy(update={"max_side": 64})) == 512


def test_a_disk_without_room_for_them(tmp_path: Path):
    clip = Clip("still", np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8), 24.0)
    with pytest.raises(OSError, match=r"frames\.npy"), writes_end_at(FRAMES * 35 * 22 * 3 - 1):
        build_frames(clip, 35, False, tmp_path)
    assert not list(tmp_path.iterdir())
