"""COCO keypoints and MOT boxes, as `pycocotools` and `motmetrics` read them."""

from __future__ import annotations

import contextlib
import io
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from consumers import consumer
from decomo_runtime import About, Tracks, TracksFileError
from decomo_runtime.keypoints import read_keypoints
from known_tracks import HEIGHT, WIDTH, known_tracks, wandering_tracks


def far_tracks() -> Tracks:
    """The known ones, "late" out of the frame in frame 2, where nothing is in sight, and the never seen one nowhere."""
    tracks = known_tracks()
    xy = tracks.xy.copy()
    xy[1, 2], xy[2, 2] = (700, 100), np.nan
    return replace(tracks, xy=xy)


class TestCoco:
    def opened(self, tmp_path: Path, tracks: Tracks | None = None, **about: Any) -> Any:
        coco = consumer("pycocotools.coco")
        (tracks or far_tracks()).save(tmp_path / "a.json", "coco", about=About(**about))
        with contextlib.redirect_stdout(io.StringIO()):
            return coco.COCO(str(tmp_path / "a.json"))

    def test_pycocotools_reads_it(self, tmp_path: Path):
        coco = self.opened(tmp_path, name="goat")
        (category,) = coco.loadCats(coco.getCatIds())
        assert category["name"] == "goat"
        assert category["keypoints"] == ["point_00", "point_01", "point_02"]
        images = coco.loadImgs(coco.getImgIds())
        assert [image["file_name"] for image in images] == [f"0000{number}.png" for number in range(1, 6)]
        assert [image["frame_id"] for image in images] == [0, 1, 2, 3, 4]
        assert {(image["width"], image["height"]) for image in images} == {(640, 360)}
        keypoints = {each["image_id"] - 1: each["keypoints"] for each in coco.loadAnns(coco.getAnnIds())}
        assert keypoints == {
            0: [0, 0, 2, 100, 100, 1, 100, 100, 1],
            1: [639, 359, 2, 100, 100, 1, 100, 100, 1],
            2: [100, 100, 1, 0, 0, 0, 0, 0, 0],  # one is out of the frame, one is nowhere
            3: [319.5, 179.5, 2, 1, 2, 2, 100, 100, 1],
            4: [10.25, 20.5, 2, 3, 4.5, 2, 100, 100, 1],
        }

    def test_boxes_hold_the_pixels_of_the_points(self, tmp_path: Path):
        coco = self.opened(tmp_path)
        boxes = [each["bbox"] for each in coco.loadAnns(coco.getAnnIds())]
        assert boxes[0] == [0, 0, 101, 101]
        assert boxes[1] == [100, 100, 540, 260]  # to the right and lower edge of the frame
        assert boxes[2] == [100, 100, 1, 1]
        areas = [each["area"] for each in coco.loadAnns(coco.getAnnIds())]
        assert areas[:3] == [101 * 101, 540 * 260, 1]
        assert [each["num_keypoints"] for each in coco.loadAnns(coco.getAnnIds())] == [3, 3, 1, 3, 3]

    def test_pycocotools_scores_it_as_right(self, tmp_path: Path):
        evaluation = consumer("pycocotools.cocoeval")
        coco = self.opened(tmp_path, wandering_tracks())
        results = [{**each, "score": 1.0} for each in coco.loadAnns(coco.getAnnIds())]
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scored = evaluation.COCOeval(coco, coco.loadRes(results), "keypoints")
            scored.params.kpt_oks_sigmas = np.full(7, 0.05)
            scored.evaluate()
            scored.accumulate()
            scored.summarize()
        assert scored.stats[0] == 1

    def test_points_to_follow_come_back(self, tmp_path: Path):
        self.opened(tmp_path)
        queries, names = read_keypoints(tmp_path / "a.json").queries()
        np.testing.assert_array_equal(queries, [[0, 0, 0], [3, 1, 2]])
        assert names == ("point_00", "point_01")

    def test_images_of_a_folder(self, tmp_path: Path):
        clip = tmp_path / "clip"
        clip.mkdir()
        for number in range(5):
            cv2.imwrite(str(clip / f"{number + 8}.jpg"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
        coco = self.opened(tmp_path, clip=clip)
        assert [image["file_name"] for image in coco.loadImgs(coco.getImgIds())] == [f"{n}.jpg" for n in range(8, 13)]
        with pytest.raises(TracksFileError, match="has frames 0 to 4, but there are tracks in 5"):
            wandering_tracks().save(tmp_path / "b.json", "coco", about=About(clip=clip))
        coco = self.opened(tmp_path, first_frame=0)
        assert coco.loadImgs(1)[0]["file_name"] == "00000.png"

    def test_without_a_place_there_is_no_annotation(self, tmp_path: Path):
        tracks = known_tracks()
        nowhere = replace(tracks, xy=np.full_like(tracks.xy, np.inf), occluded=np.ones_like(tracks.occluded))
        nowhere.save(tmp_path / "a.json", "coco")
        content = json.loads((tmp_path / "a.json").read_text())
        assert len(content["images"]) == 5
        assert content["annotations"] == []

    def test_size_is_asked_for(self, tmp_path: Path):
        with pytest.raises(TracksFileError, match="do not say the clip's size"):
            known_tracks(sized=False).save(tmp_path / "a.json", "coco")
        assert not list(tmp_path.iterdir())


class TestMot:
    LINES = """\
1,1,1.00,1.00,101.00,101.00,1,1,0.3333
2,1,101.00,101.00,540.00,260.00,1,1,0.3333
3,1,101.00,101.00,601.00,1.00,1,1,0.0000
4,1,2.00,3.00,319.50,178.50,1,1,0.6667
5,1,4.00,5.50,98.00,96.50,1,1,0.6667
"""

    def test_its_lines(self, tmp_path: Path):
        far_tracks().save(tmp_path / "a.txt", "mot")
        assert (tmp_path / "a.txt").read_text() == self.LINES

    def test_motmetrics_reads_it(self, tmp_path: Path):
        motmetrics = consumer("motmetrics")
        far_tracks().save(tmp_path / "gt.txt", "mot")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its own, of pandas
            table = motmetrics.io.loadtxt(tmp_path / "gt.txt", fmt="mot16", min_confidence=1)
        assert table.index.tolist() == [(number, 1) for number in range(1, 6)]
        box = table[["X", "Y", "Width", "Height"]].to_numpy()  # from 0 again: the frame is 0 to 640
        np.testing.assert_allclose(box[:2], [[0, 0, 101, 101], [100, 100, 540, 260]])
        np.testing.assert_allclose(table["Visibility"], [1 / 3, 1 / 3, 0, 2 / 3, 2 / 3], atol=5e-5)
        assert set(table["ClassId"]) == {1}

    def test_first_frame_and_frames_without_a_place(self, tmp_path: Path):
        tracks = known_tracks()
        xy, occluded = tracks.xy.copy(), tracks.occluded.copy()
        xy[:, 1], occluded[:, 1] = np.nan, True
        replace(tracks, xy=xy, occluded=occluded).save(tmp_path / "a.txt", "mot", about=About(first_frame=0))
        frames = [line.split(",")[0] for line in (tmp_path / "a.txt").read_text().splitlines()]
        assert frames == ["0", "2", "3", "4"]

    def test_nothing_is_refused(self, tmp_path: Path):
        empty = {"xy": np.empty((0, 5, 2), np.float32), "queries": np.empty((0, 3), np.float32)}
        none = {name: np.empty((0, 5), kind) for name, kind in (("occluded", bool), ("occlusion", np.float32))}
        with pytest.raises(TracksFileError, match="no points or no frames, so that there is nothing to write"):
            replace(known_tracks(), **empty, **none).save(tmp_path / "a.txt", "mot")
        with pytest.raises(TracksFileError, match=r"point 0 \(counted from 0\) is in sight at no finite place"):
            replace(known_tracks(), xy=known_tracks().xy * np.nan).save(tmp_path / "a.txt", "mot")
        assert not list(tmp_path.iterdir())
