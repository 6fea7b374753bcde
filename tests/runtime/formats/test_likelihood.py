"""How far off a place may be, in the formats that can say it, as their tools read it.

The known point "corner" is in sight in frame 0 with 0.75 only, and its place in frame 1 may be far off.
"""

from __future__ import annotations

import contextlib
import copy
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from consumers import consumer
from decomo_runtime import About, Tracks, TracksFileError
from decomo_runtime.formats.frames import likelihood
from known_tracks import known_tracks

NEAR = 10.0
"""Pixels of 640x360 that are four units: of places that may be as far off, four of five are."""
LIKELY = [0.75, 0.8, 0.0, 1.0, 1.0]
"""Of "corner" by frame: perhaps hidden, perhaps far off, hidden, and twice as sure as can be."""
MICE = About(points=("a.nose", "b.nose", "a.tail"))


def unsure_tracks(*, sized: bool = True) -> Tracks:
    """The known ones; "late" is exact, the point that is never in sight may be anywhere."""
    tracks = known_tracks(sized=sized)
    occlusion, error = tracks.occlusion.copy(), np.zeros_like(tracks.occlusion)
    occlusion[0, 0], error[0, 1], error[2] = 0.25, NEAR, 1000
    return replace(tracks, occlusion=occlusion, error=error)


def test_the_rule():
    tracks = unsure_tracks()
    told = likelihood(tracks, About(size=tracks.size))
    np.testing.assert_allclose(told, [LIKELY, [0, 0, 0, 1, 1], [0] * 5], atol=1e-7)
    np.testing.assert_allclose(likelihood(replace(tracks, error=None), About())[0], [0.75, 1, 0, 1, 1])


def test_frames_that_are_put_in_order_keep_theirs(tmp_path: Path):
    tracks = unsure_tracks()
    turned = {name: getattr(tracks, name)[:, ::-1] for name in ("xy", "occluded", "occlusion", "error")}
    replace(tracks, **turned, frames=tracks.frames[::-1], times=None).save(tmp_path / "a.csv", "deeplabcut")
    tracks.save(tmp_path / "b.csv", "deeplabcut")
    assert (tmp_path / "a.csv").read_text() == (tmp_path / "b.csv").read_text()


@pytest.mark.parametrize("ending", [".csv", ".h5"])
def test_deeplabcut(tmp_path: Path, ending: str):
    load = consumer("movement.io.load_poses")
    path = tmp_path / f"a{ending}"
    unsure_tracks().save(path, "deeplabcut")
    confidence = load.from_dlc_file(path).confidence.sel(keypoints="point_00").values[:, 0]
    np.testing.assert_allclose(confidence, LIKELY, atol=1e-7)


def test_the_size_is_asked_for(tmp_path: Path):
    """A likelihood is a chance to be within a share of the frame."""
    with pytest.raises(TracksFileError, match="do not say the clip's size; give --size"):
        unsure_tracks(sized=False).save(tmp_path / "a.csv", "deeplabcut")
    assert not list(tmp_path.iterdir())
    unsure_tracks(sized=False).save(tmp_path / "a.csv", "deeplabcut", about=About(size=(360, 640)))


def test_sleap(tmp_path: Path):
    sio = consumer("sleap_io")
    unsure_tracks().save(tmp_path / "a.slp", about=MICE)
    labels = sio.load_slp(str(tmp_path / "a.slp"), open_videos=False)
    noses = [frame.instances[0]["nose"]["score"] for frame in labels]
    np.testing.assert_allclose(noses, LIKELY, atol=1e-7)
    np.testing.assert_allclose([frame.instances[0].score for frame in labels], np.divide(LIKELY, 2), atol=1e-7)
    assert [frame.instances[1].score for frame in labels] == [0, 0, 0, 1, 1]  # it has no tail, which counts as nothing


def test_coco(tmp_path: Path):
    coco = consumer("pycocotools.coco")
    unsure_tracks().save(tmp_path / "a.json", "coco", about=MICE)
    with contextlib.redirect_stdout(io.StringIO()):
        truth = coco.COCO(str(tmp_path / "a.json"))
        results = truth.loadRes(copy.deepcopy(truth.loadAnns(truth.getAnnIds())))
    scores = {(each["image_id"], each["track_id"]): each["score"] for each in results.loadAnns(results.getAnnIds())}
    assert [scores[frame, 1] for frame in range(1, 6)] == [0.375, 0.4, 0, 0.5, 0.5]
    assert [scores[frame, 2] for frame in range(1, 6)] == [0, 0, 0, 1, 1]


def test_rerun(tmp_path: Path):
    chunks = consumer("rerun.chunk")
    unsure_tracks().save(tmp_path / "a.rrd")
    rows: dict[int, Any] = {}
    for chunk in chunks.RrdReader(tmp_path / "a.rrd").stream():
        if chunk.entity_path == "/clip/error":
            rows |= {row["frame"]: row for row in chunk.to_record_batch().to_pylist()}
    assert {frame: row["Ellipses2D:half_sizes"] for frame, row in sorted(rows.items())} == {
        0: [[0, 0]],
        1: [[NEAR, NEAR]],
        2: [],
        3: [[0, 0], [0, 0]],
        4: [[0, 0], [0, 0]],
    }
    assert rows[1]["Ellipses2D:centers"] == [[639.5, 359.5]]


def test_pftrack(tmp_path: Path):
    unsure_tracks().save(tmp_path / "a.txt", "pftrack")
    lines = (tmp_path / "a.txt").read_text().splitlines()
    assert lines[8:12] == [
        "1 0.000000 359.000000 0.750000",
        "2 639.000000 0.000000 0.800000",
        "4 319.500000 179.500000 1.000000",
        "5 10.250000 338.500000 1.000000",
    ]
