from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decomo_runtime import ModelFacts, QueryError
from decomo_runtime.queries import (
    check_frames,
    check_queries,
    grid_queries,
    parse_frames,
    parse_grid,
    parse_points,
    read_queries,
)

MODEL = ModelFacts("clip", num_frames=6, height=40, width=48, fps=24.0, preset="cpu", occlusion_threshold=0.5)
NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize("corner", [(0, -0.5, -0.5), (5, 47.5, 39.5), (0, 47.5, -0.5)])
def test_the_whole_frame_may_be_asked(corner: tuple[float, float, float]):
    np.testing.assert_array_equal(check_queries([corner], MODEL), [corner])


@pytest.mark.parametrize(
    ("query", "reason"),
    [
        ((NAN, 1, 1), "t, x and y must be finite numbers"),
        ((0, NAN, 1), "t, x and y must be finite numbers"),
        ((0, 1, INF), "t, x and y must be finite numbers"),
        ((0.5, 1, 1), "t must be a whole frame number"),
        ((-1, 1, 1), r"t must be within 0 \.\. 5, the clip's frames"),
        ((6, 1, 1), r"t must be within 0 \.\. 5, the clip's frames"),
        ((0, -0.51, 1), r"x must be within -0\.5 \.\. 47\.5, inside the frame"),
        ((0, 48, 1), r"x must be within -0\.5 \.\. 47\.5, inside the frame"),
        ((0, 1, -2), r"y must be within -0\.5 \.\. 39\.5, inside the frame"),
        ((0, 1, 39.6), r"y must be within -0\.5 \.\. 39\.5, inside the frame"),
    ],
)
def test_the_first_bad_row_is_named(query: tuple[float, float, float], reason: str):
    place = ", ".join(f"{name}={value:g}" for name, value in zip("txy", query, strict=True))
    with pytest.raises(QueryError, match=rf"^query row 2 \(counted from 0; {place}\): {reason}$"):
        check_queries([(0, 1, 1), (0, 2, 2), query, (99, 99, 99)], MODEL)


@pytest.mark.parametrize("queries", [(0, 1, 2), [[0, 1]], [[[0, 1, 2]]], 7, np.empty((3, 0)), np.empty((0, 2))])
def test_bad_shape(queries: Any):
    with pytest.raises(QueryError, match=r"must have the shape \[N, 3\]"):
        check_queries(queries, MODEL)


@pytest.mark.parametrize("queries", [[(0, 1), (0, 1, 2)], [("a", "b", "c")], [None], {"t": 0}])
def test_not_numbers(queries: Any):
    with pytest.raises(QueryError, match=r"rows of three numbers|shape"):
        check_queries(queries, MODEL)


def test_check_frames_defaults_to_all():
    np.testing.assert_array_equal(check_frames(None, 3), [0, 1, 2])


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        ([0, 1, -1], r"frames\[2\] is -1; it must be within 0 \.\. 5"),
        ([6], r"frames\[0\] is 6"),
        ([0.0, 1.0], "integer type.*float64"),
        ([True, False], "integer type.*bool"),
        (["a"], "integer type"),
        (3, r"shape \[\]"),
        ([[0, 1]], r"shape \[1, 2\]"),
        ([[0], [0, 1]], "something else"),
    ],
)
def test_bad_frames(frames: Any, reason: str):
    with pytest.raises(QueryError, match=reason):
        check_frames(frames, 6)


def test_points():
    np.testing.assert_array_equal(parse_points(["0,1.5,-0.25", " 3, 4 ,5"]), [[0, 1.5, -0.25], [3, 4, 5]])


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "1,2,x", "1 2 3"])
def test_bad_point(text: str):
    with pytest.raises(QueryError, match=f"--point {text} is not T,X,Y"):
        parse_points(["0,1,2", text])


@pytest.mark.parametrize(
    "text",
    [
        "t,x,y\n0,1.5,2\n3,4,5\n",
        "y,t,x\n2,0,1.5\n5,3,4\n",
        "\ufefft,x,y\r\n0,1.5,2\r\n\r\n3,4,5",
        "name, T, X, Y\nfoot, 0, 1.5, 2\nhand, 3, 4, 5\n",
        "t;x;y\n0;1.5;2\n3;4;5\n",
        "t;x;y\r\n0;1,5;2\r\n3;4,0;5\r\n",
        "t\tx\ty\n0\t1.5\t2\n3\t4\t5\n",
        "t\ty\tx\tname\n0\t2\t1,5\tleft, below\n3\t5\t4\t\n",
        '"t";"x";"y";"name"\n0;1,5;2;"a;b"\n3;4;5;"c"\n',
        "sep=;\r\nt;x;y\r\n0;1,5;2\r\n3;4;5\r\n",
        "\ufeffsep=,\nname;s,t,x,y\n;;;;;,0,1.5,2\n;,3,4,5\n",
    ],
)
def test_csv(tmp_path: Path, text: str):
    path = tmp_path / "q.csv"
    path.write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_queries(path), [[0, 1.5, 2], [3, 4, 5]])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_csv_in_any_encoding(tmp_path: Path, encoding: str):
    path = tmp_path / "q.csv"
    path.write_text("name,t,x,y\nFüße,0,1.5,2\nHände,3,4,5\n", encoding=encoding)
    np.testing.assert_array_equal(read_queries(path), [[0, 1.5, 2], [3, 4, 5]])


@pytest.mark.skipif(not Path("/dev/fd").is_dir(), reason="the system does not name open files")
def test_csv_from_a_pipe():
    reading, writing = os.pipe()
    os.write(writing, b"t;x;y\n0;1,5;2\n")
    os.close(writing)
    try:
        np.testing.assert_array_equal(read_queries(f"/dev/fd/{reading}"), [[0, 1.5, 2]])
    finally:
        os.close(reading)


def test_csv_without_points(tmp_path: Path):
    path = tmp_path / "q.csv"
    path.write_text("t,x,y\n")
    assert read_queries(path).shape == (0, 3)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "must begin with the header t,x,y; it has no column t, x, y"),
        (b"0,1,2\n", "must begin with the header t,x,y"),
        (b"t,x\n0,1\n", "has no column y$"),
        (b"t,x,y\n0,1,2\n0,one,2\n", r"line 3 \(0,one,2\) must give numbers"),
        (b"t,x,y\n0,1,2\n\n0,1\n", "line 4 has 2 values but the header names 3 columns"),
        (b"t,x,y\n0,1,2,3\n", "line 2 has 4 values"),
        (b"t,x,y\n\xff\xfe,1,2\n", r"line 2 \(.*,1,2\) must give numbers"),
        (b"t;x;y\n0;1,000,5;2\n", r"line 2 \(0;1,000,5;2\) must give numbers"),
        (b"t,x,y\n0,1;5,2\n", r"line 2 \(0,1;5,2\) must give numbers"),
        (b"sep=;\nt;x;y\n0;one;2\n", r"line 3 \(0;one;2\) must give numbers"),
        (b"t|x|y\n0|1|2\n", "must begin with the header t,x,y"),
        ("t,x,y\n0,1,2\n".encode("utf-16-le"), "is not a text file; give a csv file in UTF-8"),
        (b"\xff\xfet", "is not a text file"),
    ],
)
def test_bad_csv(tmp_path: Path, content: bytes, reason: str):
    path = tmp_path / "q.csv"
    path.write_bytes(content)
    with pytest.raises(QueryError, match=reason) as caught:
        read_queries(path)
    assert str(caught.value).startswith(str(path))


def test_csv_that_is_not_there(tmp_path: Path):
    with pytest.raises(QueryError, match=r"no\.csv cannot be read \(No such file or directory\)"):
        read_queries(tmp_path / "no.csv")


def test_grid_by_hand():
    """Seven pixels hold three points three apart, 0 3 6; four hold two, half a pixel from the border: 0 3."""
    expected = [[2, x, y] for y in (0, 3) for x in (0, 3, 6)]
    np.testing.assert_array_equal(grid_queries(3, 2, height=4, width=7), expected)
    np.testing.assert_array_equal(grid_queries(4, 0, height=1, width=7), [[0, 1, 0], [0, 5, 0]])
    np.testing.assert_array_equal(grid_queries(100, 0, height=5, width=8), [[0, 3.5, 2]])


@given(st.floats(1, 100), st.integers(1, 40), st.integers(1, 40))
def test_grid_lies_in_the_frame_and_in_its_middle(step: float, height: int, width: int):
    model = ModelFacts("clip", 1, height, width, 24.0, "cpu", 0.5)
    queries = check_queries(grid_queries(step, 0, height, width), model)
    middle = (queries[:, 1:].max(0) + queries[:, 1:].min(0)) / 2
    np.testing.assert_allclose(middle, [(width - 1) / 2, (height - 1) / 2], atol=1e-4)  # float32 below 100
    assert (queries[:, 1:].min(0) < step / 2 + 1e-4).all()  # no further point would fit


def test_parse_grid():
    assert parse_grid("16@3") == (16, 3)
    assert parse_grid("7.5@0") == (7.5, 0)


@pytest.mark.parametrize("text", ["16", "@", "16@", "@2", "16@1.5", "a@1", "16@1@2"])
def test_bad_grid(text: str):
    with pytest.raises(QueryError, match=f"--grid {text} is not STEP@T"):
        parse_grid(text)


@pytest.mark.parametrize("text", ["0@0", "-4@0", "0.5@0", "nan@0", "inf@0"])
def test_bad_spacing(text: str):
    with pytest.raises(QueryError, match="the spacing must be at least 1 pixel"):
        parse_grid(text)


@pytest.mark.parametrize(
    ("text", "frames"),
    [("0:6", range(6)), (":", range(6)), ("2:", range(2, 6)), (":3", range(3)), ("4:5", [4])],
)
def test_parse_frames(text: str, frames: Any):
    np.testing.assert_array_equal(parse_frames(text, 6), list(frames))


@pytest.mark.parametrize("text", ["", "3", "a:b", "1:2:3", "1.5:3"])
def test_bad_frame_range(text: str):
    with pytest.raises(QueryError, match=f"--frames {text} is not a:b"):
        parse_frames(text, 6)


@pytest.mark.parametrize("text", ["0:7", "-1:3", "3:3", "4:2", "6:"])
def test_frame_range_outside(text: str):
    with pytest.raises(QueryError, match=f"--frames {text} must select frames within 0:6"):
        parse_frames(text, 6)
