"""`decomo-convert`, and `decomo-track --out` with the endings of other tools."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from clip_files import flat_frames, write_video
from decomo_runtime import About, Tracker, Tracks, convert
from decomo_runtime.cli import main as track
from decomo_runtime.contract import META_PIXEL_ASPECT
from decomo_runtime.convert_cli import main
from decomo_runtime.formats.registry import FORMATS
from known_tracks import known_tracks
from tool_readers import read_3dequalizer, read_after_effects, read_nuke

HEIGHT, WIDTH, NUM_FRAMES = 40, 48, 6  # of the model and the clip of conftest.py


@pytest.fixture
def sized(tmp_path: Path) -> Path:
    known_tracks().save(tmp_path / "tracks.npz")
    return tmp_path / "tracks.npz"


@pytest.fixture
def unsized(tmp_path: Path) -> Path:
    known_tracks(timed=False).save(tmp_path / "tracks.csv")
    return tmp_path / "tracks.csv"


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def refusal(capsys: pytest.CaptureFixture[str], folder: Path, *arguments: object) -> str:
    before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    assert run(*arguments) == 2
    assert {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()} == before
    text = capsys.readouterr().err
    assert text.startswith("Error: ")
    assert text.count("\n") == 1
    return text


def test_convert(sized: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "new" / "a.nk"
    assert run(sized, out, "--first-frame", 1001) == 0
    assert capsys.readouterr().out == f"3 points in 5 frames, for Nuke, a Tracker4 node\nwrote {out}\n"
    assert list(read_nuke(out.read_text())["point_00"]) == [1001, 1002, 1004, 1005]


def test_from_csv_with_what_it_does_not_say(unsized: Path, tmp_path: Path):
    assert run(unsized, tmp_path / "a.txt", "--to", "after-effects", "--size", "640x360", "--fps", "23.976") == 0
    source, _ = read_after_effects((tmp_path / "a.txt").read_text())
    assert (source["Source Width"], source["Source Height"], source["Units Per Second"]) == (640, 360, 23.976)


def test_size_and_rate_of_a_clip(clip_path: Path, tmp_path: Path):
    xy = np.full((1, NUM_FRAMES, 2), 3, np.float32)
    seen = np.zeros((1, NUM_FRAMES), bool)
    tracks = Tracks(xy, seen, seen.astype(np.float32), np.array([[0, 3, 3]], np.float32), np.arange(NUM_FRAMES))
    tracks.save(tmp_path / "a.csv")
    assert run(tmp_path / "a.csv", tmp_path / "a.txt", "--to", "after-effects", "--clip", clip_path) == 0
    source, properties = read_after_effects((tmp_path / "a.txt").read_text())
    assert (source["Source Width"], source["Source Height"], source["Units Per Second"]) == (WIDTH, HEIGHT, 24)
    assert set(next(iter(properties.values())).values()) == {(3.5, 3.5)}
    replace(tracks, times=np.arange(NUM_FRAMES) / 30).save(tmp_path / "timed.csv")  # a folder has no rate of its own
    assert run(tmp_path / "timed.csv", tmp_path / "a.txt", "--to", "after-effects", "--clip", clip_path) == 0
    assert read_after_effects((tmp_path / "a.txt").read_text())[0]["Units Per Second"] == 30
    assert run(tmp_path / "a.csv", tmp_path / "a.py", "--clip", clip_path) == 0
    assert f"CLIP = {str(clip_path / '0.png')!r}\n" in (tmp_path / "a.py").read_text()


def test_there_and_back(sized: Path, tmp_path: Path):
    for name in ("a.json", "b.csv", "c.npz"):
        assert run(sized, tmp_path / name) == 0
        np.testing.assert_array_equal(Tracks.load(tmp_path / name).xy, known_tracks().xy)
    assert run(tmp_path / "a.json", tmp_path / "d.npz") == 0
    assert Tracks.load(tmp_path / "d.npz").size == (360, 640)


def test_a_csv_gets_the_size_that_is_told(unsized: Path, tmp_path: Path):
    assert run(unsized, tmp_path / "a.npz", "--size", "640x360") == 0
    assert Tracks.load(tmp_path / "a.npz").size == (360, 640)


def test_python_twin(sized: Path, unsized: Path, tmp_path: Path):
    found = convert(sized, tmp_path / "a.txt", "3dequalizer", first_frame=5)
    np.testing.assert_array_equal(found.xy, known_tracks().xy)
    assert list(read_3dequalizer((tmp_path / "a.txt").read_text())["point_01"]) == [8, 9]
    convert(str(unsized), str(tmp_path / "b.txt"), "3dequalizer", size=(360, 640), first_frame=5)
    assert (tmp_path / "b.txt").read_text() == (tmp_path / "a.txt").read_text()


def test_a_folder(sized: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    arguments = [sized, tmp_path / "layers", "--to", "after-effects-layers"]
    assert run(*arguments) == 0
    assert len(list((tmp_path / "layers").iterdir())) == 2
    assert "exists already; give the name of a new folder" in refusal(capsys, tmp_path, *arguments)


def test_refusals(sized: Path, unsized: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "a.nk"
    out.write_text("former")
    for words, arguments in {
        "may be several things by its ending; say which with --to": (sized, tmp_path / "a.txt"),
        "fusion is no format of tracks; there are npz, csv": (sized, out, "--to", "fusion"),
        "does not end as a file of tracks does": (sized, tmp_path / "a.xyz"),
        "do not say the clip's size; give --size WIDTHxHEIGHT": (unsized, out),
        "do not say the clip's frame rate; give --fps": (unsized, tmp_path / "b.txt", "--to", "after-effects",
                                                         "--size", "640x360"),
        "outside of frames of 3x2; give the clip that the tracks are of": (unsized, out, "--size", "3x2"),
        "in frames of 640x360 but those of the clip are 640x480": (sized, out, "--size", "640x480"),
        "--size 640 is not WIDTHxHEIGHT": (sized, out, "--size", "640"),
        "--size 0x360 is not WIDTHxHEIGHT": (sized, out, "--size", "0x360"),
        "fps must be a number above 0": (sized, out, "--fps", "0"),
        "fps must be a number above 0, got nan": (sized, out, "--fps", "nan"),
        "is not an .npz file of plain arrays": (tmp_path / "none.npz", out),
        "a.nk is not a file of tracks by its ending": (out, tmp_path / "b.nk"),
        "would replace": (unsized, unsized),
        "made of 4 points, the corners, but there are 3": (sized, out, "--to", "nuke-corner-pin"),
    }.items():  # fmt: skip
        assert words in refusal(capsys, tmp_path, *arguments)


def test_another_clip(sized: Path, clip_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    text = refusal(capsys, tmp_path, sized, tmp_path / "a.nk", "--clip", clip_path)
    assert "in frames of 640x360 but those of the clip are 48x40" in text


def test_a_shorter_clip(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    known_tracks(sized=False).save(tmp_path / "a.csv")
    (tmp_path / "short").mkdir()
    for number in range(2):
        cv2.imwrite(str(tmp_path / "short" / f"{number}.png"), np.zeros((360, 640, 3), np.uint8))
    text = refusal(capsys, tmp_path, tmp_path / "a.csv", tmp_path / "a.nk", "--clip", tmp_path / "short")
    assert "the tracks reach frame 4 but the clip has 2 frames" in text


def test_help_lists_the_formats_and_loads_nothing():
    code = (
        "import sys; from decomo_runtime.convert_cli import main; main(['--help']);"
        "print([name for name in ('numpy', 'cv2', 'onnxruntime', 'av') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    *text, loaded = done.stdout.splitlines()
    assert loaded == "[]"
    for each in FORMATS:
        words = [each.name, *each.kind.split(), *each.purpose.split()]
        assert any(line.split() == words and line.endswith("  " + each.purpose) for line in text)


class TestTrack:
    """`decomo-track --out`: the model knows the clip's size, rate, length and name."""

    def test_nuke(self, model_path: Path, tmp_path: Path):
        arguments = [str(model_path), "--point", "0,10,12", "--out"]
        assert track([*arguments, str(tmp_path / "a.nk")]) == 0
        assert track([*arguments, str(tmp_path / "a.npz")]) == 0
        (keys,) = read_nuke((tmp_path / "a.nk").read_text()).values()
        tracks = Tracks.load(tmp_path / "a.npz")
        assert [frame - 1 for frame in keys] == np.flatnonzero(~tracks.occluded[0]).tolist()
        first = next(iter(keys.values()))
        np.testing.assert_allclose(first, (tracks.xy[0, 0, 0] + 0.5, HEIGHT - 0.5 - tracks.xy[0, 0, 1]), atol=6e-5)

    def test_what_a_model_says_of_its_clip(self, write_model: Callable[..., Path], tmp_path: Path):
        facts = Tracker(write_model({META_PIXEL_ASPECT: "1.5"})).facts
        assert About.of(facts, tmp_path) == About(
            *((HEIGHT, WIDTH), facts.fps, NUM_FRAMES), pixel_aspect=1.5, name="slide", clip=tmp_path
        )

    def test_to(self, model_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
        arguments = [str(model_path), "--point", "0,10,12", "--out", str(tmp_path / "a.txt")]
        assert track(arguments) == 2
        assert "may be several things by its ending; say which with --to" in capsys.readouterr().err
        assert track([*arguments, "--to", "after-effects"]) == 0
        source, _ = read_after_effects((tmp_path / "a.txt").read_text())
        assert (source["Source Width"], source["Source Height"]) == (WIDTH, HEIGHT)

    def test_folder(self, model_path: Path, tmp_path: Path):
        out = tmp_path / "layers"
        assert track([str(model_path), "--grid", "16@0", "--out", str(out), "--to", "after-effects-layers"]) == 0
        assert len(list(out.iterdir())) > 1

    def test_some_frames_are_no_json_of_the_page(
        self,
        model_path: Path,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        monkeypatch: pytest.MonkeyPatch,
    ):
        arguments = [str(model_path), "--point", "0,10,12", "--out", str(tmp_path / "a.json")]
        with monkeypatch.context() as patched:  # before any work
            patched.setattr(Tracker, "track", None)
            assert track([*arguments, "--frames", "0:3"]) == 2
        assert f"the page's JSON holds all {NUM_FRAMES} frames of the clip" in capsys.readouterr().err
        assert track(arguments) == 0
        assert Tracks.load(tmp_path / "a.json").size == (HEIGHT, WIDTH)


def test_what_is_told_goes_before_what_the_clip_says(unsized: Path, tmp_path: Path):
    """A proxy of half the size, of which each picture is shown for twice as long."""
    proxy = write_video(tmp_path / "proxy.mp4", flat_frames(range(5), 180, 320), 12, pixel_aspect=Fraction(4, 3))
    convert(unsized, tmp_path / "a.txt", "after-effects", clip=proxy, size=(360, 640), fps=24)
    source, _ = read_after_effects((tmp_path / "a.txt").read_text())
    assert (source["Source Width"], source["Source Height"], source["Units Per Second"]) == (640, 360, 24)
    assert source["Source Pixel Aspect Ratio"] == pytest.approx(4 / 3, rel=1e-5)
    found = convert(unsized, tmp_path / "b.txt", "after-effects", clip=proxy, size=(360, 640))
    assert read_after_effects((tmp_path / "b.txt").read_text())[0]["Units Per Second"] == 12
    assert found.size is None
