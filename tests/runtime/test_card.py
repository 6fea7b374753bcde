"""A model's card: what its files tell, and nothing where they do not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from decomo_runtime import Card, ModelFileError, Origin, Tracker, contract
from decomo_runtime.info_cli import main
from decomotion.quality import Figures, Quality
from decomotion.windows import FILE_NAME, Windows, split
from tiny_model import write_tiny_model

FRAMES, HEIGHT, WIDTH = 30, 60, 90


def quality(median: float) -> Quality:
    return Quality(1234, None, Figures(60, median, 3.0, 2 * median, 6.0, 0.5, 0.6, 0.7, 0.4), None, None, ())


TOLD = {
    contract.META_FITTED_BY: "0.1.0+g0123456789ab",
    contract.META_WRITER_VERSION: "0.2.0",
    contract.META_STEPS: "1234",
    contract.META_BUDGET: '{"steps": 9000, "seconds": 600.0}',
    contract.META_LICENCE: "CC BY 4.0",
    contract.META_BAKE: "depth",
    contract.META_PRECISION: "fp16",
    contract.META_DEVIATION: "0.012 0.05",
    contract.META_QUALITY: quality(0.3).as_json(),
}


def single(path: Path, **metadata: str) -> Path:
    return write_tiny_model(
        path, num_frames=FRAMES, height=HEIGHT, width=WIDTH, clip_name="walk", metadata={**TOLD, **metadata}
    )


def several(folder: Path, told: bool) -> Path:
    """30 frames in three windows, the last of which is the worst."""
    layout = Windows("walk", FRAMES, HEIGHT, WIDTH, 15.0, split(FRAMES, [], 16))
    qualities = tuple(quality(0.2 + number) for number in range(len(layout.windows))) if told else None
    for window in layout.windows:
        write_tiny_model(
            folder / f"{window.name}.onnx", num_frames=len(window), height=HEIGHT, width=WIDTH, metadata=TOLD
        )
    Windows(*(*list(vars(layout).values())[:-1], qualities)).save(folder / FILE_NAME)
    return folder


def test_all_that_a_file_tells(tmp_path: Path):
    path = single(tmp_path / "walk.onnx")
    card = Tracker(path).card
    assert isinstance(card, Card)
    assert (card.path, card.bytes, card.preset) == (path, path.stat().st_size, "cpu")
    assert (card.clip_name, card.num_frames, card.height, card.width) == ("walk", 30, 60, 90)
    assert (card.fps, card.seconds, card.pixel_aspect) == (12.5, pytest.approx(2.4), 1.0)
    assert card.providers == ("CPUExecutionProvider",)
    assert card.origin == Origin(
        fitted_by="0.1.0+g0123456789ab",
        exported_by="0.2.0",
        steps=1234,
        budget_steps=None,
        budget_seconds=600.0,
        bake="depth",
        precision="fp16",
        deviation=(0.012, 0.05),
        licence="CC BY 4.0",
    )
    (window,) = card.windows
    assert (window.name, window.begin, window.end, window.bytes) == ("walk", 0, 30, card.bytes)
    assert window.quality == card.quality == quality(0.3)


def test_an_older_file_tells_what_it_knows(tmp_path: Path):
    path = write_tiny_model(tmp_path / "old.onnx", num_frames=4, height=20, width=30)
    card = Tracker(path).card
    assert card.origin == Origin(exported_by="0")
    assert card.quality is None
    assert dict(card.rows()) == {
        "model": f"{path} (0.0 MiB)",
        "clip": "tiny",
        "licence": "not told",
        "frames": "4 of 30x20, 12.5 a second, 0.32 s",
        "windows": "1",
        "preset": "cpu",
        "budget": "not told",
        "steps": "not told",
        "fitted by": "not told",
        "exported by": "decomotion 0",
        "tables": "not told",
        "precision": "not told",
        "runs on": "CPUExecutionProvider",
        "quality": "not told",
    }


def test_a_clip_of_several_windows(tmp_path: Path):
    card = Tracker(several(tmp_path, told=True)).card
    assert [(each.name, each.begin, each.end) for each in card.windows] == [
        ("window-000", 0, 13),
        ("window-001", 9, 21),
        ("window-002", 17, 30),
    ]
    assert (card.clip_name, card.num_frames, card.fps, card.seconds) == ("walk", 30, 15.0, pytest.approx(2.0))
    assert card.bytes == sum(file.stat().st_size for file in tmp_path.glob("*.onnx"))
    assert [each.quality for each in card.windows] == [quality(0.2), quality(1.2), quality(2.2)]
    assert card.quality == quality(2.2)
    assert dict(card.rows())["windows"].splitlines() == [
        "3",
        "window-000: frames 0 to 12, 0.0 MiB, held-out links missed by 0.20 px of 256",
        "window-001: frames 9 to 20, 0.0 MiB, held-out links missed by 1.20 px of 256",
        "window-002: frames 17 to 29, 0.0 MiB, held-out links missed by 2.20 px of 256",
    ]
    assert dict(card.rows())["quality"].startswith("of the window that misses its links the most:\nheld-out links are ")


def test_an_older_folder_does_not_tell_how_good_its_windows_are(tmp_path: Path):
    card = Tracker(several(tmp_path, told=False)).card
    assert [each.quality for each in card.windows] == [None, None, None]
    assert card.quality is None


@pytest.mark.parametrize(
    ("metadata", "row", "text"),
    [
        ({}, "budget", "600 s"),
        ({contract.META_BUDGET: '{"steps": 9000, "seconds": null}'}, "budget", "9000 steps"),
        ({}, "precision", "fp16, which moves tracks by 0.012 px in the mean, 0.05 at the 99th percentile"),
        ({contract.META_PRECISION: "fp32"}, "precision", "fp32"),
        (
            {contract.META_PIXEL_ASPECT: "1.0667"},
            "frames",
            "30 of 90x60, 12.5 a second, 2.4 s, pixels 1.067 times as wide as high",
        ),
    ],
)
def test_rows(tmp_path: Path, metadata: dict[str, str], row: str, text: str):
    assert dict(Tracker(single(tmp_path / "walk.onnx", **metadata)).card.rows())[row] == text


def test_the_command_shows_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = single(tmp_path / "walk.onnx", **{contract.META_QUALITY: quality(2.9).as_json()})
    assert main([str(path)]) == 0
    printed = capsys.readouterr().out
    assert "\nlicence      CC BY 4.0\n" in printed
    assert "\nquality      held-out links are missed by 2.90 px of 256" in printed
    assert printed.splitlines()[-1].startswith(" " * 13 + "the fit falls short of its links: held-out links are missed")


def test_the_command_writes_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main([str(several(tmp_path, told=True)), "--json"]) == 0
    card = json.loads(capsys.readouterr().out)
    assert set(card) == set(Card.__dataclass_fields__)
    assert card["path"] == str(tmp_path)
    assert card["origin"]["licence"] == "CC BY 4.0"
    assert [each["end"] for each in card["windows"]] == [13, 21, 30]
    assert card["quality"]["all"]["median"] == 2.2


def test_a_run_is_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(ModelFileError, match=r"give what decomo-export wrote"):
        Tracker(tmp_path)
    assert main([str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
