from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TextIO

import numpy as np
import pytest

from decomo_runtime import Tracks, TracksFileError
from full_disk import writes_end_at

FIELDS = ("xy", "occluded", "occlusion", "queries", "frames")


def some_tracks(points: int = 3, frames: int = 4, timed: bool = False) -> Tracks:
    rng = np.random.default_rng(0)
    occlusion = rng.random((points, frames), np.float32)
    return Tracks(
        rng.random((points, frames, 2), np.float32) * 100,
        occlusion > 0.5,
        occlusion,
        rng.random((points, 3), np.float32),
        np.arange(frames) + 7,
        (90, 160),
        np.cumsum(rng.random(frames)) if timed else None,
    )


def test_shown_they_are_a_line():
    tracks = some_tracks()
    assert repr(tracks) == f"Tracks(3 points in 4 frames of 160x90, {tracks.occluded.mean():.0%} occluded)"
    assert repr(replace(some_tracks(1, 1), size=None)).startswith("Tracks(1 point in 1 frame, ")
    assert repr(some_tracks(0, 4)) == "Tracks(0 points in 4 frames of 160x90)"


@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize("shape", [(3, 4), (0, 4), (3, 0), (0, 0), (1, 1)])
def test_npz_round_trip(tmp_path: Path, shape: tuple[int, int], timed: bool):
    tracks = some_tracks(*shape, timed)
    tracks.save(tmp_path / "a.npz")
    again = Tracks.load(tmp_path / "a.npz")
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(again, field), getattr(tracks, field))
        assert getattr(again, field).dtype == getattr(tracks, field).dtype
    assert again.size == (90, 160)
    assert again.times is None if tracks.times is None else np.array_equal(again.times, tracks.times)


def test_npz_of_refined_tracks(tmp_path: Path):
    refined = np.random.default_rng(0).random((3, 4)) < 0.5
    replace(some_tracks(), refined=refined).save(tmp_path / "a.npz")
    again = Tracks.load(tmp_path / "a.npz").refined
    assert again is not None
    assert again.dtype == bool
    np.testing.assert_array_equal(again, refined)
    replace(some_tracks(), refined=refined[:2]).save(tmp_path / "wrong.npz")
    with pytest.raises(TracksFileError, match=r"refined must be numbers of the shape \[3, 4\], got bool of \[2, 4\]"):
        Tracks.load(tmp_path / "wrong.npz")


def test_the_size_is_optional_but_not_half_of_it(tmp_path: Path):
    tracks = some_tracks()
    arrays = {
        "queries": tracks.queries,
        "tracks": tracks.xy,
        "occluded": tracks.occluded,
        "occlusion": tracks.occlusion,
    }
    np.savez(tmp_path / "old.npz", **arrays)
    assert Tracks.load(tmp_path / "old.npz").size is None
    for wrong in ({"width": 160}, {"width": 160, "height": 0}, {"width": [160], "height": [90]}):
        np.savez(tmp_path / "wrong.npz", **arrays, **wrong)
        with pytest.raises(TracksFileError, match="must hold both height and width"):
            Tracks.load(tmp_path / "wrong.npz")


def test_npz_keys(tmp_path: Path):
    """The documented file: others read it with numpy alone."""
    some_tracks().save(tmp_path / "new" / "A.NPZ")
    with np.load(tmp_path / "new" / "A.NPZ", allow_pickle=False) as file:
        described = {key: (file[key].dtype.name, file[key].shape) for key in file.files}
    assert described == {
        "queries": ("float32", (3, 3)),
        "tracks": ("float32", (3, 4, 2)),
        "occluded": ("bool", (3, 4)),
        "occlusion": ("float32", (3, 4)),
        "frames": ("int64", (4,)),
        "height": ("int64", ()),
        "width": ("int64", ()),
    }


def test_csv_by_hand(tmp_path: Path):
    tracks = Tracks(
        np.array([[[1.5, 2], [3, -4.25]]], np.float32),
        np.array([[False, True]]),
        np.array([[0.125, 0.75]], np.float32),
        np.array([[5, 1.5, 2]], np.float32),
        np.array([5, 9]),
    )
    tracks.save(tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == (
        "point,frame,x,y,occlusion,occluded,query_t,query_x,query_y\n"
        "0,5,1.5000,2.0000,0.1250,0,5,1.5000,2.0000\n"
        "0,9,3.0000,-4.2500,0.7500,1,5,1.5000,2.0000\n"
    )  # fmt: skip


@pytest.mark.parametrize("shape", [(3, 4), (0, 4), (3, 0)])
def test_csv_has_a_line_for_each_point_and_frame(tmp_path: Path, shape: tuple[int, int]):
    tracks = some_tracks(*shape)
    tracks.save(tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()[1:]
    assert len(lines) == shape[0] * shape[1]
    for line, (point, column) in zip(lines, np.ndindex(shape), strict=True):
        values = [float(value) for value in line.split(",")]
        assert values[:2] == [point, tracks.frames[column]]
        np.testing.assert_allclose(values[2:4], tracks.xy[point, column], atol=5.1e-5)  # four decimals
        assert values[5] == tracks.occluded[point, column]


@pytest.mark.parametrize("shape", [(3, 4), (1, 1), (0, 0)])
def test_csv_round_trip(tmp_path: Path, shape: tuple[int, int]):
    tracks = some_tracks(*shape)
    tracks.queries[:, 0] = np.floor(tracks.queries[:, 0])
    tracks.save(tmp_path / "a.csv")
    again = Tracks.load(tmp_path / "a.csv")
    for field in FIELDS:
        np.testing.assert_allclose(getattr(again, field), getattr(tracks, field), atol=5.1e-5)  # four decimals
        assert getattr(again, field).dtype == getattr(tracks, field).dtype


def test_csv_with_times_by_hand(tmp_path: Path):
    tracks = Tracks(
        np.array([[[1.5, 2], [3, -4.25]]], np.float32),
        np.array([[False, True]]),
        np.array([[0.125, 0.75]], np.float32),
        np.array([[5, 1.5, 2]], np.float32),
        np.array([5, 9]),
        times=np.array([0.166667, 1.2]),
    )
    tracks.save(tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == (
        "point,frame,x,y,occlusion,occluded,query_t,query_x,query_y,time\n"
        "0,5,1.5000,2.0000,0.1250,0,5,1.5000,2.0000,0.166667\n"
        "0,9,3.0000,-4.2500,0.7500,1,5,1.5000,2.0000,1.200000\n"
    )  # fmt: skip
    np.testing.assert_array_equal(Tracks.load(tmp_path / "a.csv").times, tracks.times)


@pytest.mark.parametrize("shape", [(700, 53), (2, 40_000), (40_000, 2)])
def test_csv_of_many_lines(tmp_path: Path, shape: tuple[int, int]):
    tracks = some_tracks(*shape, timed=True)
    tracks.queries[:, 0] = np.arange(shape[0])
    tracks.save(tmp_path / "a.csv")
    again = Tracks.load(tmp_path / "a.csv")
    for field in (*FIELDS, "times"):
        np.testing.assert_allclose(getattr(again, field), getattr(tracks, field), rtol=1e-6, atol=5.1e-5)


def peak(act: Callable[[], object]) -> int:
    tracemalloc.start()
    act()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


def test_csv_takes_little_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("decomo_runtime.formats.csv.LINES", 1024)
    tracks = some_tracks(400, 50, timed=True)
    tracks.save(tmp_path / "a.csv")  # what is imported at the first time does not count
    assert peak(lambda: tracks.save(tmp_path / "a.csv")) < 400_000  # of a block, whatever the number of lines
    assert peak(lambda: Tracks.load(tmp_path / "a.csv")) < 80 * 400 * 50  # 80 bytes a line


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize(("separator", "point"), [(",", "."), (";", "."), (";", ","), ("\t", ",")])
def test_csv_as_a_spreadsheet_saves_it(tmp_path: Path, encoding: str, separator: str, point: str):
    path = tmp_path / "a.csv"
    tracks = some_tracks(timed=True)
    tracks.save(path)
    lines = [[f"{cell}" for cell in line.split(",")] for line in path.read_text().splitlines()]
    lines = [[f"Fuß {row}" if row else "name", *reversed(line)] for row, line in enumerate(lines)]  # columns moved
    text = "\r\n".join(separator.join(cell.replace(".", point) for cell in line) for line in lines) + "\r\n\r\n"
    expected = Tracks.load(path)
    path.write_text(text, encoding=encoding, newline="")
    again = Tracks.load(path)
    for field in (*FIELDS, "times"):
        np.testing.assert_array_equal(getattr(again, field), getattr(expected, field))


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_a_full_disk_leaves_the_former_file(tmp_path: Path, suffix: str):
    path = tmp_path / f"a{suffix}"
    some_tracks().save(path)
    former = path.read_bytes()
    with writes_end_at(20_000), pytest.raises(OSError, match="File too large") as failure:
        some_tracks(200, 50).save(path)
    assert failure.value.filename == str(path)
    assert path.read_bytes() == former
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("damage", [lambda text: text[:60], lambda text: text.replace("point", "p"), lambda text: ""])
def test_a_damaged_csv(tmp_path: Path, damage: Callable[[str], str]):
    some_tracks().save(tmp_path / "a.csv")
    path = tmp_path / "a.csv"
    path.write_text(damage(path.read_text()))
    with pytest.raises(TracksFileError, match=r"a\.csv is not a csv file of tracks"):
        Tracks.load(path)


@pytest.mark.parametrize("order", [[0, 1, 2, 4, 5], [0, 1, 2, 3, 4, 6], [1, 0, 2, 3, 4, 5], [2, 3, 4, 5], [0, 1, 4, 5]])
def test_a_csv_with_lines_missing(tmp_path: Path, order: list[int]):
    some_tracks(3, 2).save(tmp_path / "a.csv")
    head, *lines = (tmp_path / "a.csv").read_text().splitlines(keepends=True)
    lines = [*lines, lines[4].replace("7", "9")]
    (tmp_path / "a.csv").write_text("".join([head, *(lines[number] for number in order)]))
    with pytest.raises(TracksFileError, match="must have a line for each point and frame"):
        Tracks.load(tmp_path / "a.csv")


@pytest.mark.parametrize("name", ["a.xyz", "a", "a.npz.gz"])
def test_other_suffixes(tmp_path: Path, name: str):
    with pytest.raises(TracksFileError, match="does not end as a file of tracks does"):
        some_tracks().save(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_failed_save_leaves_the_former_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.csv"
    path.write_text("former")

    def full_disk(file: TextIO, *args: object, **options: object) -> None:
        file.write("half")
        raise OSError("no space left")

    monkeypatch.setattr(np, "savetxt", full_disk)
    with pytest.raises(OSError, match="no space left"):
        some_tracks().save(path)
    assert path.read_text() == "former"
    assert list(tmp_path.iterdir()) == [path]


def test_load_of_another_trackers_file_counts_frames_from_0(tmp_path: Path):
    tracks = some_tracks()
    np.savez(
        tmp_path / "a.npz",
        queries=tracks.queries,
        tracks=tracks.xy.astype(np.float64),
        occluded=tracks.occluded.astype(np.uint8),
        occlusion=tracks.occlusion,
    )
    again = Tracks.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(again.frames, [0, 1, 2, 3])
    assert again.xy.dtype == np.float32
    assert again.occluded.dtype == np.bool_


def test_load_refuses_what_is_not_tracks(tmp_path: Path):
    path = tmp_path / "a.npz"
    with pytest.raises(TracksFileError, match=r"is not an \.npz file of plain arrays"):
        Tracks.load(path)
    some_tracks().save(path)
    whole = path.read_bytes()
    for content in (b"", b"text", whole[: len(whole) // 2], whole[:-30]):
        path.write_bytes(content)
        with pytest.raises(TracksFileError, match=r"a\.npz is not an \.npz file of plain arrays.*decomo-track"):
            Tracks.load(path)
    with open(path, "wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(TracksFileError, match=r"is not an \.npz file of plain arrays"):
        Tracks.load(path)


def test_load_never_unpickles(tmp_path: Path):
    np.savez(tmp_path / "a.npz", queries=np.array([len], object))
    with pytest.raises(TracksFileError, match=r"is not an \.npz file of plain arrays"):
        Tracks.load(tmp_path / "a.npz")


def test_load_names_lacking_arrays_and_wrong_shapes(tmp_path: Path):
    path = tmp_path / "a.npz"
    tracks = some_tracks()
    arrays = {"queries": tracks.queries, "tracks": tracks.xy, "occluded": tracks.occluded}
    np.savez(path, **arrays)
    with pytest.raises(TracksFileError, match="lacks the arrays occlusion"):
        Tracks.load(path)
    np.savez(path, **arrays, occlusion=tracks.occlusion[:, :2])
    with pytest.raises(
        TracksFileError, match=r"occlusion must be numbers of the shape \[3, 4\], got float32 of \[3, 2\]"
    ):
        Tracks.load(path)
    arrays["occlusion"] = tracks.occlusion
    for wrong in (np.array(3.0), tracks.xy.astype(str)):
        np.savez(path, allow_pickle=False, **(arrays | {"tracks": wrong}))
        with pytest.raises(TracksFileError, match="tracks must be numbers of the shape"):
            Tracks.load(path)


@pytest.mark.parametrize("twice", ["x", "time", "error"])
def test_a_column_that_is_there_twice(tmp_path: Path, twice: str):
    tracks = some_tracks(timed=True)
    replace(tracks, error=tracks.occlusion).save(tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    lines = [f"{line},{twice if number == 0 else 1}" for number, line in enumerate(lines)]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(TracksFileError, match=r"a\.csv is not a csv file of tracks"):
        Tracks.load(tmp_path / "a.csv")


@pytest.mark.parametrize("key", ["error", "refined", "times", "frames"])
def test_load_looks_at_what_may_be_absent_too(tmp_path: Path, key: str):
    tracks = some_tracks()
    arrays = {
        **{"queries": tracks.queries, "tracks": tracks.xy, "occluded": tracks.occluded, "occlusion": tracks.occlusion},
        key: np.zeros(5),
    }
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(TracksFileError, match=rf"{key} must be numbers of the shape .*, got float64 of \[5\]"):
        Tracks.load(tmp_path / "a.npz")


@pytest.mark.parametrize("frame", [0.5, np.nan, np.inf, 2.0**53])
def test_frames_are_whole_numbers(tmp_path: Path, frame: float):
    tracks = some_tracks(3, 2)
    arrays = {
        "queries": tracks.queries,
        "tracks": tracks.xy,
        "occluded": tracks.occluded,
        "occlusion": tracks.occlusion,
    }
    np.savez(tmp_path / "a.npz", **arrays, frames=np.array([0, frame]))
    with pytest.raises(TracksFileError, match="frames must be whole numbers"):
        Tracks.load(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", **arrays, frames=np.array([0, 2.0**53 - 1]))
    assert Tracks.load(tmp_path / "b.npz").frames.tolist() == [0, 2**53 - 1]


def test_places_beyond_single_precision_are_infinitely_far(tmp_path: Path):
    tracks = some_tracks()
    arrays = {"queries": tracks.queries, "occluded": tracks.occluded, "occlusion": tracks.occlusion}
    np.savez(tmp_path / "a.npz", **arrays, tracks=np.full(tracks.xy.shape, -1e300))
    assert (Tracks.load(tmp_path / "a.npz").xy == -np.inf).all()
