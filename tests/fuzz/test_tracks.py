"""Files of tracks and of queries: ours, the user's for training, and other trackers' for scoring."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decomo_eval.dataset import Video
from decomo_eval.errors import PredictionError
from decomo_eval.predictions import from_npz
from decomo_eval.tapvid import sample_queries
from decomo_runtime import About, ModelFacts, QueryError, Tracks
from decomo_runtime.errors import TracksFileError
from decomo_runtime.layouts import from_cotracker
from decomo_runtime.queries import check_queries, read_queries
from decomo_runtime.regions import queries_in
from decomotion.clip import Clip
from decomotion.data.links.tracks import read_tracks
from decomotion.errors import SupervisionError
from decomotion.images import png
from near_misses import Arrays, answer, any_or_near, forged_npy, forged_zip, near_arrays, near_tree, npy, npz

POINTS, FRAMES, HEIGHT, WIDTH = 4, 7, 24, 40
RANDOM = np.random.default_rng(0)
OCCLUDED = RANDOM.random((POINTS, FRAMES)) < 0.3
OCCLUDED[:, :2] = False
XY = RANDOM.uniform(3, HEIGHT - 4, (POINTS, FRAMES, 2)).astype(np.float32)
QUERIES = np.column_stack([np.zeros(POINTS), XY[:, 0]]).astype(np.float32)
ERROR = RANDOM.uniform(0, 9, (POINTS, FRAMES)).astype(np.float32)
TRACKS = Tracks(XY, OCCLUDED, OCCLUDED.astype(np.float32), QUERIES, np.arange(FRAMES), (HEIGHT, WIDTH), error=ERROR)


def members(arrays: Arrays) -> list[tuple[str, bytes]]:
    return [(f"{name}.npy", npy(array)) for name, array in arrays.items()]


def files(*layouts: Arrays) -> st.SearchStrategy[bytes]:
    """An .npz file of one of these layouts with something wrong."""
    return st.one_of(
        any_or_near(*map(npz, layouts)),
        *(near_arrays(arrays).map(npz) for arrays in layouts),
        *(forged_zip(members(arrays), forged_npy()) for arrays in layouts),
    )


def check_tracks(tracks: Tracks | None) -> None:
    if tracks is not None:
        points, frames = tracks.occluded.shape
        found = [(array.shape, array.dtype) for array in (tracks.xy, tracks.occlusion, tracks.queries, tracks.frames)]
        assert found == [
            ((points, frames, 2), np.float32),
            ((points, frames), np.float32),
            ((points, 3), np.float32),
            ((frames,), np.int64),
        ]
        assert tracks.occluded.dtype == bool
        assert tracks.error is None or (tracks.error.shape, tracks.error.dtype) == ((points, frames), np.float32)
        assert tracks.size is None or min(tracks.size) >= 1


OURS = {
    **{"queries": QUERIES, "tracks": XY, "occluded": OCCLUDED, "occlusion": OCCLUDED.astype(np.float32)},
    **{"frames": np.arange(FRAMES), "height": np.array(HEIGHT), "width": np.array(WIDTH), "error": ERROR},
}


@given(content=files(OURS))
def test_tracks_as_npz(place: Path, content: bytes):
    (place / "a.npz").write_bytes(content)
    check_tracks(answer(lambda: Tracks.load(place / "a.npz"), TracksFileError))


@pytest.mark.parametrize("frame", [np.nan, np.inf, 0.5, 1e300])
def test_frames_are_whole_numbers(place: Path, frame: float):
    (place / "a.npz").write_bytes(npz({**OURS, "frames": np.where(OURS["frames"] == 3, frame, OURS["frames"])}))
    with pytest.raises(TracksFileError, match="frames"):
        Tracks.load(place / "a.npz")


def test_places_that_float32_does_not_hold(place: Path):
    (place / "a.npz").write_bytes(npz({**OURS, "tracks": np.full(XY.shape, 1e300)}))
    check_tracks(answer(lambda: Tracks.load(place / "a.npz"), TracksFileError))


def csv_of(tracks: Tracks, folder: Path) -> bytes:
    tracks.save(folder / "whole.csv")
    return (folder / "whole.csv").read_bytes()


CELLS = (
    "",
    "nan",
    "inf",
    "-1",
    "0.5",
    "1e400",
    "1e30",
    "99999999999999999999",
    "-99999999999",
    "1_0",
    "\u0661",
    "x",
    '"',
    "0x1",
)


@st.composite
def near_csv(draw: st.DrawFn, whole: bytes) -> bytes:
    """A csv file with one to three cells or lines wrong, perhaps in another encoding."""
    rows = [line.split(",") for line in whole.decode().splitlines()]
    for _ in range(draw(st.integers(1, 3))):
        row = draw(st.integers(0, len(rows) - 1))
        place = draw(st.integers(0, len(rows[row])))
        fate = draw(st.integers(0, 5))
        if fate == 0 and len(rows) > 1:
            del rows[row]
        elif fate == 1:
            rows.insert(row, rows[draw(st.integers(0, len(rows) - 1))].copy())
        elif fate == 2:
            rows[row].insert(place, draw(st.sampled_from(CELLS)))
        else:
            rows[row][place : place + 1] = [draw(st.sampled_from(CELLS) | st.text(max_size=5))]
    text = draw(st.sampled_from(("\n", "\r\n", "\r", "\n\n"))).join(
        draw(st.sampled_from((",", ",", ";", "\t"))).join(row) for row in rows
    )
    return text.encode(draw(st.sampled_from(("utf-8", "utf-8", "utf-8-sig", "utf-16", "latin-1"))), "replace")


@given(data=st.data())
def test_tracks_as_csv(place: Path, data: st.DataObject):
    whole = csv_of(TRACKS, place)
    content = data.draw(any_or_near(whole) | near_csv(whole))
    (place / "a.csv").write_bytes(content)
    check_tracks(answer(lambda: Tracks.load(place / "a.csv"), TracksFileError))


def json_of(tracks: Tracks, folder: Path) -> Any:
    tracks.save(folder / "whole.json", about=About(fps=24))
    return json.loads((folder / "whole.json").read_text())


@given(data=st.data())
def test_tracks_as_json(place: Path, data: st.DataObject):
    whole = json_of(TRACKS, place)
    damaged = near_tree(whole).map(lambda tree: json.dumps(tree).encode())
    content = data.draw(any_or_near(json.dumps(whole).encode()) | damaged)
    (place / "a.json").write_bytes(content)
    check_tracks(answer(lambda: Tracks.load(place / "a.json"), TracksFileError))


@pytest.mark.parametrize("clip", [{"num_frames": 10**15}, {"num_frames": 10**8}, {"fps": 1e-320}, {"fps": 1e300}])
def test_a_clip_of_json_that_takes_all_memory(place: Path, clip: dict[str, Any]):
    whole = json_of(TRACKS, place)
    (place / "a.json").write_text(json.dumps({**whole, "points": [], "clip": {**whole["clip"], **clip}}))
    assert answer(lambda: Tracks.load(place / "a.json"), TracksFileError) is None


QUERIES_CSV = b"name,t,x,y\n" + b"".join(b"a,%d,%.1f,%.1f\n" % tuple(row) for row in QUERIES)


@given(content=any_or_near(QUERIES_CSV) | near_csv(QUERIES_CSV))
def test_queries(place: Path, content: bytes):
    (place / "q.csv").write_bytes(content)
    queries = answer(lambda: read_queries(place / "q.csv"), QueryError)
    if queries is not None:
        assert queries.dtype == np.float64
        assert queries.ndim == 2
        assert queries.shape[1] == 3


FACTS = ModelFacts("clip", FRAMES, HEIGHT, WIDTH, 24.0, "cpu", 0.5)
mask_queries, polygon_queries, box_queries = (
    partial(queries_in, option) for option in ("--mask", "--polygon", "--box")
)
REGIONS = {polygon_queries: "3,4,20.5,6,9,18@2", box_queries: "3,4,20.5,6@2"}


def check_queries_of_a_region(queries: npt.NDArray[np.float64] | None) -> None:
    if queries is not None:
        assert len(check_queries(queries, FACTS)) > 0


@given(data=st.data())
@pytest.mark.parametrize("read", REGIONS)
def test_regions(read: Callable[..., npt.NDArray[np.float64]], data: st.DataObject):
    parts = REGIONS[read].replace("@", ",@,").split(",")
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(parts) - 1))
        parts[place : place + 1] = data.draw(st.lists(st.sampled_from([*CELLS, "@", "3", "-7.5", "1e6"]), max_size=2))
        parts = parts or [""]
    text = ",".join(parts).replace(",@,", "@")
    check_queries_of_a_region(answer(lambda: read(text, 1.5, FACTS), QueryError))


MASK = png(255 * (RANDOM.random((HEIGHT, WIDTH)) < 0.2).astype(np.uint8))


@given(content=any_or_near(MASK))
def test_masks(place: Path, content: bytes):
    (place / "m.png").write_bytes(content)
    check_queries_of_a_region(answer(lambda: mask_queries(f"{place / 'm.png'}@3", 2.0, FACTS), QueryError))


CLIP = Clip("clip", np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8), 24.0)
SUPERVISION = {"tracks": XY, "occluded": OCCLUDED, "queries": QUERIES, "confidence": np.ones((POINTS, FRAMES))}
SQUARE = {
    "tracks": XY.mean(0) + np.zeros((FRAMES, FRAMES, 2)),
    "occluded": np.zeros((FRAMES, FRAMES), bool),
    "queries": np.column_stack([np.arange(FRAMES), XY.mean(0)]),
}
COTRACKER = {"queries": QUERIES, "pred_tracks": XY.swapaxes(0, 1), "pred_visibility": ~OCCLUDED.T}
TAPNET = {
    **{"query_points": QUERIES[:, [0, 2, 1]], "tracks": XY, "occlusion": np.where(OCCLUDED, 5.0, -5.0)},
    **{"expected_dist": np.full(OCCLUDED.shape, -5.0), "width": np.array(WIDTH), "height": np.array(HEIGHT)},
}


@given(content=files(SUPERVISION, SQUARE, COTRACKER, TAPNET))
def test_tracks_of_the_user(place: Path, content: bytes):
    (place / "a.npz").write_bytes(content)
    tracks = answer(lambda: read_tracks(place / "a.npz", CLIP), SupervisionError)
    if tracks is not None:
        assert tracks.xy.dtype == tracks.confidence.dtype == np.float32
        assert tracks.xy.shape == (*tracks.confidence.shape, 2)
        assert tracks.confidence.shape[1] == FRAMES
        assert np.isfinite(tracks.xy).all()
        assert ((tracks.confidence >= 0) & (tracks.confidence <= 1)).all()
        assert (tracks.confidence > 0).any()
        inside = ((tracks.xy >= -0.5) & (tracks.xy <= np.array([WIDTH, HEIGHT]) - 0.5)).all(-1)
        assert (inside | (tracks.confidence == 0)).all()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"tracks": np.full(XY.shape, 1e300)}, "not finite numbers where occluded says"),
        ({"tracks": XY.astype("m8[s]")}, "it must hold numbers"),
        ({"tracks": XY.astype(complex)}, "it must hold numbers"),
        ({"occluded": OCCLUDED * 0.5}, "occluded must be true or false"),
        ({"queries": QUERIES * np.nan}, "queries begin with a frame"),
        ({"queries": QUERIES * [1, np.nan, 1]}, "queries must be finite"),
        ({"queries": QUERIES[0]}, r"queries is \[3\]"),
        ({"queries": np.concatenate([QUERIES, QUERIES])}, "queries has 8 points but tracks has 4"),
    ],
)
def test_tracks_of_the_user_are_refused(place: Path, changes: Arrays, reason: str):
    (place / "a.npz").write_bytes(npz({**SUPERVISION, **changes}))
    with pytest.raises(SupervisionError, match=reason):
        read_tracks(place / "a.npz", CLIP)


@pytest.mark.parametrize("content", [SUPERVISION, SQUARE, COTRACKER, TAPNET])
def test_whole_tracks_of_the_user_are_read(place: Path, content: Arrays):
    (place / "a.npz").write_bytes(npz(content))
    assert len(read_tracks(place / "a.npz", CLIP)) == len(content["tracks" if "tracks" in content else "queries"])


@pytest.mark.parametrize("size", [np.inf, np.nan, 0, -1, 0.5, [40, 40]])
def test_tracks_of_the_user_of_frames_of_no_size(place: Path, size: Any):
    (place / "a.npz").write_bytes(npz({**TAPNET, "width": np.array(size)}))
    with pytest.raises(SupervisionError, match="both width and height"):
        read_tracks(place / "a.npz", CLIP)


@pytest.mark.parametrize("name", ["occluded", "confidence"])
def test_as_many_tracks_as_frames_and_an_array_of_no_axes(place: Path, name: str):
    turned = {**SQUARE, "tracks": SQUARE["tracks"] + np.arange(FRAMES)[:, None, None] * [3.0, 0]}
    turned["queries"] = np.column_stack([np.arange(FRAMES), turned["tracks"][range(FRAMES), 0]])
    (place / "a.npz").write_bytes(npz({**turned, name: np.array(1)}))
    with pytest.raises(SupervisionError, match=rf"{name} is \[\]"):
        read_tracks(place / "a.npz", CLIP)


VIDEO = Video(
    "goat",
    np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8),
    HEIGHT,
    WIDTH,
    (XY.astype(np.float64) + 0.5) / [WIDTH, HEIGHT],
    OCCLUDED,
)
ASKED = sample_queries(VIDEO, "first")
ANSWERS = ASKED.tracks / 256 * [WIDTH, HEIGHT] - 0.5
TYX = ASKED.points * [1, HEIGHT / 256, WIDTH / 256] - [0, 0.5, 0.5]
TXY = TYX[:, [0, 2, 1]]
LAYOUTS: dict[str, Arrays] = {
    "ours": {
        **{"queries": TXY, "tracks": ANSWERS, "occluded": ASKED.occluded, "frames": np.arange(FRAMES)},
        **{"height": np.array(HEIGHT), "width": np.array(WIDTH)},
    },
    "cotracker": {
        **{"queries": TXY[None], "pred_tracks": ANSWERS.swapaxes(0, 1)[None]},
        **{"pred_visibility": np.where(ASKED.occluded, 0.1, 0.9).T},
    },
    "tapir": {
        **{"query_points": TYX, "tracks": ANSWERS, "occlusion": np.where(ASKED.occluded, 5.0, -5.0)},
        **{"expected_dist": np.full(ASKED.occluded.shape, -5.0)},
    },
    "tapnet": {"query_points": TYX, "pred_tracks": ANSWERS, "visibles": ~ASKED.occluded},
    "pips": {
        **{"trajs_e": ANSWERS.swapaxes(0, 1), "vis_e": np.where(ASKED.occluded, -5.0, 5.0).T, "queries": TXY},
    },
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_whole_predictions_are_read(place: Path, layout: str):
    (place / "goat.npz").write_bytes(npz(LAYOUTS[layout]))
    assert from_npz(place / "goat.npz", VIDEO, ASKED).tracks.shape == ANSWERS.shape


@pytest.mark.parametrize("layout", LAYOUTS)
@given(data=st.data())
def test_predictions(place: Path, layout: str, data: st.DataObject):
    (place / "goat.npz").write_bytes(data.draw(files(LAYOUTS[layout])))
    prediction = answer(lambda: from_npz(place / "goat.npz", VIDEO, ASKED), PredictionError)
    if prediction is not None:
        assert prediction.tracks.shape == ANSWERS.shape
        assert np.isfinite(prediction.tracks).all()
        assert prediction.occluded.shape == ASKED.occluded.shape
        assert prediction.occluded.dtype == bool
        assert min(prediction.size) >= 1


@pytest.mark.parametrize("size", [np.inf, np.nan, 0, -1, 0.5, "40", [40, 40]])
def test_predictions_of_frames_of_no_size(place: Path, size: Any):
    (place / "goat.npz").write_bytes(npz({**LAYOUTS["ours"], "width": np.array(size)}))
    with pytest.raises(PredictionError, match="both width and height"):
        from_npz(place / "goat.npz", VIDEO, ASKED)


@pytest.mark.parametrize("dtype", [complex, "U3", "m8[s]", [("x", "f4")]])
def test_visibility_of_no_numbers(place: Path, dtype: Any):
    layout = {**LAYOUTS["tapnet"], "visibles": np.zeros(ASKED.occluded.shape, dtype)}
    (place / "goat.npz").write_bytes(npz(layout))
    with pytest.raises(PredictionError, match="true or false as visibles"):
        from_npz(place / "goat.npz", VIDEO, ASKED)


def test_uncertainty_of_another_shape(place: Path):
    layout = {**LAYOUTS["tapir"], "expected_dist": np.zeros((1, FRAMES))}
    (place / "goat.npz").write_bytes(npz(layout))
    with pytest.raises(PredictionError, match=r"expected_dist \[1, 7\]"):
        from_npz(place / "goat.npz", VIDEO, ASKED)


@pytest.mark.parametrize("dtype", [complex, "U3", "m8[s]", [("x", "f4")]])
def test_cotracker_of_no_numbers(dtype: Any):
    with pytest.raises(TracksFileError, match="of numbers"):
        from_cotracker(XY.swapaxes(0, 1), ~OCCLUDED.T, np.zeros((POINTS, 3), dtype))


@given(arrays=near_arrays({"tracks": XY.swapaxes(0, 1)[None], "seen": ~OCCLUDED.T[None], "queries": QUERIES}))
def test_cotracker_in_memory(arrays: Arrays):
    content = [arrays.get(name, np.array(0)) for name in ("tracks", "seen", "queries")]
    check_tracks(answer(lambda: from_cotracker(content[0], content[1], content[2]), TracksFileError))
