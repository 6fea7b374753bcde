"""A clip's times and its key."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from clip_files import flat_frames, write_images
from decomotion.clip import Clip, read_clip


class TestTimes:
    frames = flat_frames([1, 2, 3, 4])

    def test_of_an_even_rate(self):
        clip = Clip("goat", self.frames, 12.5)
        np.testing.assert_allclose(clip.times, [0, 0.08, 0.16, 0.24])
        assert (clip.times.dtype, clip.fps, clip.variable_rate, clip.pixel_aspect) == (np.float64, 12.5, False, 1.0)

    @pytest.mark.parametrize("rate", [24.0, 25.0, 12.0, 7.3, 1 / 3600, 240.0])
    @pytest.mark.parametrize("length", [2, 3, 97])
    def test_the_rate_is_that_of_the_times(self, rate: float, length: int):
        assert Clip("goat", np.zeros((length, 2, 3, 3), np.uint8), rate).fps == pytest.approx(rate, rel=1e-11)

    def test_without_a_rate_it_is_24(self):
        assert Clip("goat", self.frames).fps == 24.0
        assert Clip("goat", self.frames[:1]).fps == 24.0

    def test_the_rate_is_the_mean_over_the_clip(self):
        clip = Clip("goat", self.frames, times=[0, 0.1, 0.2, 0.6])
        assert (clip.fps, clip.variable_rate) == (5.0, True)

    @pytest.mark.parametrize("rate", [24, 30, 60, 240, 400])
    def test_whole_milliseconds_make_no_variable_rate(self, rate: int):
        times = np.round(np.arange(100) * 1000 / rate) / 1000
        clip = Clip("goat", np.zeros((100, 2, 3, 3), np.uint8), times=times)
        assert not clip.variable_rate
        kept = np.delete(np.arange(100), 50)
        assert Clip("goat", clip.frames[kept], times=times[kept]).variable_rate

    def test_a_part_has_its_own_from_zero(self):
        clip = Clip("goat", self.frames, times=[0, 0.1, 0.3, 0.6], pixel_aspect=4 / 3)
        part = clip.part(1, 4, "late")
        np.testing.assert_allclose(part.times, [0, 0.2, 0.5])
        assert (part.name, part.pixel_aspect) == ("goat-late", 4 / 3)

    @pytest.mark.parametrize("times", [[0, 1, 2], [0, 1, 1, 2], [0, 2, 1, 3], [1, 2, 3, 4], [0, 1, 2, np.nan]])
    def test_others_are_a_mistake(self, times: list[float]):
        with pytest.raises(ValueError, match="as many increasing times"):
            Clip("goat", self.frames, times=times)

    def test_a_rate_and_times_are_a_mistake(self):
        with pytest.raises(TypeError, match="not both"):
            Clip("goat", self.frames, 24.0, times=[0, 1, 2, 3])


class TestDigest:
    frames = flat_frames([1, 2, 3])

    def test_is_the_same_on_every_machine_and_day(self):
        assert Clip("goat", self.frames, 24.0).digest() == "c730763c9e21d62a"

    def test_depends_on_content_alone(self, tmp_path: Path):
        clip = Clip("goat", self.frames, 24.0)
        assert dataclasses.replace(clip, name="dog", times=clip.times * 2).digest() == clip.digest()
        assert Clip("goat", np.asfortranarray(self.frames), 24.0).digest() == clip.digest()
        write_images(tmp_path / "a", ["0.png", "1.png", "2.png"], self.frames)
        shutil.copytree(tmp_path / "a", tmp_path / "b")
        assert read_clip(tmp_path / "a").digest() == read_clip(tmp_path / "b").digest()

    def test_is_made_once(self, monkeypatch: pytest.MonkeyPatch):
        clip = Clip("goat", self.frames)
        digest = clip.digest()
        monkeypatch.setattr("decomotion.clip.hashlib", None)
        assert clip.digest() == digest

    def test_changes_with_one_value_the_order_or_the_shape(self):
        one_value = self.frames.copy()
        one_value[-1, -1, -1, -1] ^= 1
        other = [one_value, self.frames[::-1], self.frames[:-1], self.frames.reshape(3, 24, 16, 3)]
        digests = {Clip("goat", frames, 24.0).digest() for frames in [self.frames, *other]}
        assert len(digests) == 1 + len(other)
