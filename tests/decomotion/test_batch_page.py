"""What the page of a batch says of a clip, and its small picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from decomotion import quality
from decomotion.batch.page import quality_of, write_page
from decomotion.batch.picture import SIDE, strip
from decomotion.clip import Clip
from decomotion.jobs.folder import Results
from decomotion.jobs.task import Outcome
from decomotion.quality import Figures, Quality


def fitted(median: float, steps: int = 4000) -> Quality:
    return Quality(steps, None, Figures(90, median, 9.0, 2 * median, 18.0, 0.5, 0.75, 0.9, 0.4), None, None, ())


def test_of_several_windows_the_worst_counts(tmp_path: Path) -> None:
    assert quality_of(tmp_path) is None
    for number, median in enumerate((0.5, 1.25, 0.75)):
        (tmp_path / f"window-00{number}").mkdir()
        (tmp_path / f"window-00{number}" / quality.FILE_NAME).write_text(fitted(median).as_json())
    (tmp_path / quality.FILE_NAME).write_text("{")  # damaged
    assert quality_of(tmp_path) == fitted(1.25)


def test_a_clip_of_windows_and_one_that_is_starved(tmp_path: Path) -> None:
    (tmp_path / "models" / "long").mkdir(parents=True)
    (tmp_path / "models" / "long" / "windows.json").touch()
    (tmp_path / "videos" / "long" / "run").mkdir(parents=True)
    (tmp_path / "videos" / "long" / "run" / quality.FILE_NAME).write_text(fitted(0.625, steps=7).as_json())
    outcomes = Outcome("long", 1, {"train": 90.0, "export": 30.0}, None), Outcome("untold", 0, {}, None)
    page = write_page(tmp_path, Results(outcomes, (), 1)).read_text()
    for words in ('<a href="models/long">model</a>', "0.62 (1.25)", "75 %", "2.0", "it took 7 steps, which is few"):
        assert words in page
    assert "not told" in page
    assert "Failed" not in page


def test_a_picture_shows_three_frames_in_the_shape_they_are_to_have() -> None:
    """Pixels twice as wide as high: 600 of 300 are shown four times as wide as high, here 192 by 48."""
    frames = np.stack([np.full((300, 600, 3), 20 * number, np.uint8) for number in range(9)])
    picture = strip(Clip("any", frames, 24.0, pixel_aspect=2.0))
    assert picture.shape == (SIDE // 4, 3 * SIDE, 3)
    assert [int(picture[20, place * SIDE + 90, 0]) for place in range(3)] == [20, 80, 140]
