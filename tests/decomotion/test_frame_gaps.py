"""What a folder of frames lacks by its names."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from clip_files import flat_frames, write_images
from decomotion.clip import read_clip
from decomotion.errors import ClipError
from decomotion.frame_gaps import check_kinds, missing_numbers


class TestNumbers:
    def test_are_missed_where_the_others_follow_each_other(self, tmp_path: Path, caplog: pytest.LogCaptureFixture):
        folder = write_images(tmp_path / "shot", [f"{number:03}.png" for number in (1, 2, 5, 6)], flat_frames([1] * 4))
        with caplog.at_level(logging.WARNING, "decomotion"):
            assert len(read_clip(folder)) == 4
        assert caplog.messages == ["shot lacks 2 frames by its names: 2 after 002.png; the other 4 are counted from 0"]

    def test_are_missed_by_their_usual_distance(self):
        assert missing_numbers(["v2_f0.png", "v2_f5.png", "v2_f15.png"]) == (
            "lacks 1 frame by its names: 1 after v2_f5.png; the other 3 are counted from 0"
        )

    def test_many_places_are_not_all_named(self):
        found = missing_numbers([f"{number}.jpg" for number in range(400) if number % 50 != 20])
        assert found is not None
        assert "lacks 8 frames" in found
        assert "1 after 219.jpg and at 3 more places; the other 392" in found

    @pytest.mark.parametrize(
        "names",
        [
            ["0.png", "1.png", "2.png"],
            ["10.png", "15.png", "20.png"],
            ["1.png", "9.png"],
            ["a.png", "b.png", "d.png"],
            ["a1.png", "b5.png", "c9.png"],
            ["1_1.png", "1_2.png", "2_1.png", "2_9.png"],
            ["1.png", "3.png", "4.png", "9.png", "10.png", "15.png"],  # by no rate at all
            ["shot.png", "shot (1).png", "shot (9).png"],
            [],
        ],
    )
    def test_are_not_missed(self, names: list[str]):
        assert missing_numbers(names) is None


class TestKinds:
    @pytest.mark.parametrize("suffix", [".webp", ".TIF", ".jfif"])
    def test_a_frame_in_another_is_not_left_out(self, suffix: str, tmp_path: Path):
        write_images(tmp_path, ["a_1.jpg", "a_3.jpg"], flat_frames([10, 20]))
        (tmp_path / f"A 2{suffix}").touch()
        with pytest.raises(ClipError, match=rf"in {tmp_path}, A 2{suffix} is one of the frames by its name, but no"):
            read_clip(tmp_path)

    @pytest.mark.parametrize("other", ["a_1.exr", "thumbnail_7.webp", "a.gif", "2.webp"])
    def test_other_pictures_are_left_alone(self, other: str):
        check_kinds(["a_1.jpg", "a_2.jpg"], [other])
