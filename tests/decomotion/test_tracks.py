"""Tracks of any tracker: both orders, checked against the clip, nothing in them run."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decomotion.clip import Clip
from decomotion.data.links.tracks import read_tracks
from decomotion.errors import SupervisionError

POINTS, FRAMES, HEIGHT, WIDTH = 5, 8, 24, 32
CLIP = Clip("clip", np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8), 24.0)


def arrays() -> dict[str, Any]:
    """Points that go right by a pixel a frame; the first leaves the image at its end, the last is hidden in frame 3."""
    start = np.array([[27.0, 4], [3, 5], [6, 7], [9, 20], [12, 13]])
    tracks = start[:, None] + np.arange(FRAMES)[None, :, None] * np.array([1.0, 0])
    occluded = np.zeros((POINTS, FRAMES), bool)
    occluded[4, 3] = True
    queries = np.concatenate([np.zeros((POINTS, 1)), start], axis=1)
    return {"tracks": tracks, "occluded": occluded, "queries": queries}


def saved(tmp_path: Path, **content: Any) -> Path:
    np.savez(tmp_path / "tracks.npz", **{name: value for name, value in content.items() if value is not None})
    return tmp_path / "tracks.npz"


def test_what_is_seen_inside_the_image_is_known(tmp_path: Path):
    tracks = read_tracks(saved(tmp_path, **arrays()), CLIP)
    assert len(tracks) == POINTS
    expected = np.ones((POINTS, FRAMES))
    expected[4, 3] = 0
    expected[0, 5:] = 0  # x is 32 and more
    np.testing.assert_array_equal(tracks.confidence, expected)
    np.testing.assert_allclose(tracks.xy, arrays()["tracks"])
    points = tracks.points(CLIP)
    assert points.shape == (FRAMES, POINTS, 2)
    assert points[..., 0].max() == WIDTH - 1
    np.testing.assert_allclose(points[2, 1], [5, 5])


def test_a_link_is_as_sure_as_its_less_sure_end(tmp_path: Path):
    confidence = np.full((POINTS, FRAMES), 0.8)
    confidence[:, 2] = 0.3
    tracks = read_tracks(saved(tmp_path, **arrays(), confidence=confidence), CLIP)
    np.testing.assert_allclose(tracks.confidence_from(0)[1, :4], [0.8, 0.8, 0.3, 0.8])
    np.testing.assert_allclose(tracks.confidence_from(2)[1], 0.3)
    assert not tracks.confidence_from(3)[4].any()


@pytest.mark.parametrize("with_queries", [True, False])
def test_frames_first_is_the_same(tmp_path: Path, with_queries: bool):
    content = arrays()
    content["queries"] = content["queries"] if with_queries else None
    turned = {**content, "tracks": content["tracks"].swapaxes(0, 1), "occluded": content["occluded"].T}
    np.testing.assert_array_equal(
        read_tracks(saved(tmp_path, **turned), CLIP).xy, read_tracks(saved(tmp_path, **content), CLIP).xy
    )


@pytest.mark.parametrize("turned", [False, True])
def test_as_many_tracks_as_frames_are_told_apart_by_their_queries(tmp_path: Path, turned: bool):
    frame = np.arange(3)
    clip = Clip("square", np.zeros((3, 60, 80, 3), np.uint8), 24.0)
    tracks = np.array([[10.0, 10], [40, 20], [70, 50]])[:, None] + frame[:, None]
    occluded = np.zeros((3, 3), bool)
    occluded[0, 2] = True
    queries = np.column_stack([[1, 2, 0], tracks[frame, [1, 2, 0]]])
    order = (1, 0) if turned else (0, 1)
    file = saved(tmp_path, tracks=tracks.transpose(*order, 2), occluded=occluded.transpose(order), queries=queries)
    known = read_tracks(file, clip)
    np.testing.assert_allclose(known.xy, tracks)
    np.testing.assert_array_equal(known.confidence == 0, occluded)


def test_numbers_of_any_kind(tmp_path: Path):
    content = arrays()
    as_numbers = {
        **content,
        "tracks": content["tracks"].astype(np.float16),
        "occluded": content["occluded"].astype(int),
    }
    assert read_tracks(saved(tmp_path, **as_numbers), CLIP).confidence[4, 3] == 0


def test_where_hidden_anything_goes(tmp_path: Path):
    content = arrays()
    content["tracks"][4, 3] = np.nan
    assert np.isfinite(read_tracks(saved(tmp_path, **content), CLIP).xy).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tracks": None}, "has no array 'tracks'"),
        ({"occluded": None}, "has no array 'occluded'"),
        ({"tracks": np.zeros((5, 9, 2))}, r"tracks is \[5, 9, 2\]; it must be \[N, T, 2\] with the clip's T = 8"),
        ({"tracks": np.zeros((5, 8, 3))}, r"it must be \[N, T, 2\], \(x, y\) in pixels"),
        ({"tracks": np.zeros((0, 8, 2)), "queries": None}, "holds no track"),
        ({"occluded": np.zeros((4, 8), bool), "queries": None}, "occluded has 4 points but tracks has 5"),
        ({"confidence": np.full((5, 8), 2.0)}, r"confidence must lie in \[0, 1\]"),
        ({"confidence": np.full((5, 8), np.nan)}, r"confidence must lie in \[0, 1\]"),
        ({"queries": np.zeros((5, 2))}, r"queries is \[5, 2\]"),
        ({"queries": np.array([[8.0, 0, 0]] * 5)}, "a whole number in 0 … 7"),
        ({"queries": arrays()["queries"][:, [0, 2, 1]] * 4}, "from their own queries"),
        ({"tracks": np.full((5, 8, 2), np.inf)}, "not finite numbers where occluded says that they are seen"),
        ({"occluded": np.ones((5, 8), bool)}, "no point is seen inside the 32x24 image"),
        ({"tracks": np.array([["a"]])}, "tracks holds <U1; it must hold numbers"),
        ({"tracks": np.array([{}], object)}, "is not an .npz file of plain arrays"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, change: dict[str, Any], message: str):
    with pytest.raises(SupervisionError, match=message):
        read_tracks(saved(tmp_path, **{**arrays(), **change}), CLIP)


@pytest.mark.parametrize("place", ["data", "header", "method"])
def test_a_damaged_file(tmp_path: Path, place: str):
    file = tmp_path / "tracks.npz"
    np.savez_compressed(file, tracks=np.random.default_rng(0).random((5, 8, 2)), occluded=np.zeros((5, 8), bool))
    content = bytearray(file.read_bytes())
    if place == "data":
        content[80:90] = b"\xff" * 10
    elif place == "header":
        with zipfile.ZipFile(file, "w") as archive:
            for name in ("tracks", "occluded"):
                buffer = io.BytesIO()
                np.save(buffer, np.zeros((5, 8, 2)))
                archive.writestr(f"{name}.npy", buffer.getvalue().replace(b"}", b"("))
        content = bytearray(file.read_bytes())
    else:
        content[content.index(b"PK\x01\x02") + 10] = 99  # a method of compression that there is not
    file.write_bytes(content)
    with pytest.raises(SupervisionError, match=r"is not an \.npz file of plain arrays"):
        read_tracks(file, CLIP)


def test_other_files(tmp_path: Path):
    with pytest.raises(SupervisionError, match="does not exist"):
        read_tracks(tmp_path / "nowhere.npz", CLIP)
    for name, content in (("text.npz", b"text"), ("empty.npz", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SupervisionError, match=r"is not an \.npz file of plain arrays"):
            read_tracks(tmp_path / name, CLIP)
    np.save(tmp_path / "one.npy", np.zeros(3))
    with pytest.raises(SupervisionError, match=r"is not an \.npz file of plain arrays"):
        read_tracks(tmp_path / "one.npy", CLIP)


def test_points_outside_are_looked_at_in_the_nearest_pixel(tmp_path: Path):
    content = arrays()
    content["tracks"][1, 2] = (-3, 40)
    content["tracks"][2, 2] = (50, -1)
    points = read_tracks(saved(tmp_path, **content), CLIP).points(CLIP)
    np.testing.assert_array_equal(points[2, 1:3], [[0, HEIGHT - 1], [WIDTH - 1, 0]])
