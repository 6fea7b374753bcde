"""Tracks in other trackers' layouts, there and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from decomo_runtime import Tracks, TracksFileError
from decomo_runtime.layouts import from_cotracker, from_tapvid, to_cotracker, to_tapvid


def some_tracks() -> Tracks:
    random = np.random.default_rng(0)
    occluded = random.random((3, 4)) > 0.5
    queries = np.column_stack([[0, 2, 3], random.random((3, 2)) * 40]).astype(np.float32)
    xy = random.random((3, 4, 2), np.float32) * 40
    return Tracks(xy, occluded, occluded.astype(np.float32), queries, np.arange(4))


def assert_same(given: Tracks, expected: Tracks) -> None:
    for field in ("xy", "occluded", "occlusion", "queries", "frames"):
        np.testing.assert_allclose(getattr(given, field), getattr(expected, field), atol=1e-4)  # float32 below 256
        assert getattr(given, field).dtype == getattr(expected, field).dtype


def test_cotracker():
    tracks = some_tracks()
    xy, visibility = to_cotracker(tracks)
    assert xy.shape == (1, 4, 3, 2)
    assert visibility.shape == (1, 4, 3)
    assert xy[0, 1, 2].tolist() == tracks.xy[2, 1].tolist()
    assert visibility[0, 1, 2] == (not tracks.occluded[2, 1])
    assert_same(from_cotracker(xy, visibility, tracks.queries), tracks)
    assert_same(from_cotracker(xy[0], visibility[0], tracks.queries, [0, 1, 2, 3]), tracks)


def test_cotracker_s_scores():
    """Cut where its own evaluation does, and kept as the score."""
    tracks = some_tracks()
    xy, visibility = to_cotracker(tracks)
    given = from_cotracker(xy, np.where(visibility, 0.61, 0.59), tracks.queries)
    np.testing.assert_array_equal(given.occluded, tracks.occluded)
    np.testing.assert_allclose(given.occlusion, np.where(tracks.occluded, 0.41, 0.39), rtol=1e-6)


def test_wrong_shapes():
    tracks = some_tracks()
    xy, visibility = to_cotracker(tracks)
    with pytest.raises(TracksFileError, match=r"CoTracker's layout is .* got \[1, 4, 3, 2\], \[1, 4, 2\] and \[3, 3\]"):
        from_cotracker(xy, visibility[..., :2], tracks.queries)
    with pytest.raises(TracksFileError, match="frames must name each of the 4 frames"):
        from_cotracker(xy, visibility, tracks.queries, [0, 1])
    with pytest.raises(TracksFileError, match=r"by a whole number; got float64 of \[4\]"):
        from_cotracker(xy, visibility, tracks.queries, [0, 0.5, 1, 2])
    with pytest.raises(TracksFileError, match="CoTracker's layout is of numbers; got <U"):
        from_cotracker(xy, visibility, tracks.queries, ["a", "b", "c", "d"])
    with pytest.raises(TracksFileError, match="not all rows of one are equally long"):
        from_cotracker([[1, 2], [3]], visibility, tracks.queries)
    answer = to_tapvid(tracks, width=64, height=32)
    with pytest.raises(TracksFileError, match=r"TAP-Vid's layout is .* got \[2, 3\], \[3, 4, 2\] and \[3, 4\]"):
        from_tapvid(replace(answer, query_points=answer.query_points[:2]), width=64, height=32)


def test_tapvid():
    """A pixel's centre is half a unit inside TAP-Vid's raster; here a pixel is 4 units wide and 8 high."""
    tracks = some_tracks()
    answer = to_tapvid(tracks, width=64, height=32)
    t, x, y = tracks.queries[1]
    np.testing.assert_allclose(answer.query_points[1], [t, (y + 0.5) * 8, (x + 0.5) * 4], rtol=1e-6)
    np.testing.assert_allclose(answer.tracks[2, 3], (tracks.xy[2, 3] + 0.5) * [4, 8], rtol=1e-6)
    assert_same(from_tapvid(answer, width=64, height=32), tracks)
