"""DeepLabCut's and SLEAP's files, as `movement`, pandas and `sleap-io` read them."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from consumers import consumer
from decomo_runtime import About, Tracks, TracksFileError
from decomo_runtime.formats.deeplabcut import check
from decomo_runtime.keypoints import read_keypoints
from known_tracks import HEIGHT, HIDDEN, NUM_FRAMES, PLACES, WIDTH, known_tracks, wandering_tracks

FIELDS = ("xy", "occluded", "occlusion", "queries")
FIRST = """\
scorer,decomotion,decomotion,decomotion,decomotion,decomotion,decomotion,decomotion,decomotion,decomotion
bodyparts,point_00,point_00,point_00,point_01,point_01,point_01,point_02,point_02,point_02
coords,x,y,likelihood,x,y,likelihood,x,y,likelihood
0,0.0000,0.0000,0.7500,100.0000,100.0000,0.0000,100.0000,100.0000,0.0000
"""


def scored_tracks() -> Tracks:
    """The known ones; "corner" is not quite sure in frame 0."""
    tracks = known_tracks()
    occlusion = tracks.occlusion.copy()
    occlusion[0, 0] = 0.25
    return replace(tracks, occlusion=occlusion)


def late_tracks() -> Tracks:
    """The known ones from frame 3 on, the last first."""
    tracks = scored_tracks()
    columns = [4, 3]
    cut = {name: getattr(tracks, name)[:, columns] for name in ("xy", "occluded", "occlusion")}
    return replace(tracks, **cut, frames=np.array(columns), times=None)


def places_of_corner() -> list[tuple[float, float]]:
    return [PLACES["corner"].get(frame, HIDDEN) for frame in range(NUM_FRAMES)]


class TestDeepLabCut:
    @pytest.mark.parametrize("ending", [".csv", ".h5"])
    def test_movement_reads_it(self, tmp_path: Path, ending: str):
        load = consumer("movement.io.load_poses")
        path = tmp_path / f"a{ending}"
        scored_tracks().save(path, "deeplabcut")
        poses = load.from_dlc_file(path, fps=25)
        assert poses.keypoints.values.tolist() == ["point_00", "point_01", "point_02"]
        np.testing.assert_array_equal(poses.position.sel(keypoints="point_00").values[..., 0], places_of_corner())
        np.testing.assert_array_equal(poses.confidence.sel(keypoints="point_00").values[:, 0], [0.75, 1, 0, 1, 1])
        np.testing.assert_allclose(poses.time.values, np.arange(5) / 25)

    def test_pandas_reads_h5(self, tmp_path: Path):
        pandas, _ = consumer("pandas"), consumer("tables")
        scored_tracks().save(tmp_path / "a.h5", about=About(first_frame=10))
        table = pandas.read_hdf(tmp_path / "a.h5", "df_with_missing")
        assert table.columns.names == ["scorer", "bodyparts", "coords"]
        assert table.index.tolist() == [10, 11, 12, 13, 14]
        corner = table["decomotion"]["point_00"]
        np.testing.assert_array_equal(corner[["x", "y"]], places_of_corner())
        np.testing.assert_array_equal(corner["likelihood"], [0.75, 1, 0, 1, 1])

    def test_its_first_lines(self, tmp_path: Path):
        scored_tracks().save(tmp_path / "a.csv", "deeplabcut")
        assert (tmp_path / "a.csv").read_text().startswith(FIRST)

    @pytest.mark.parametrize("ending", [".csv", ".h5"])
    def test_frames_before_and_after_the_tracks_have_empty_rows(self, tmp_path: Path, ending: str):
        load = consumer("movement.io.load_poses")
        path = tmp_path / f"a{ending}"
        late_tracks().save(path, "deeplabcut", about=About(length=7))
        x = load.from_dlc_file(path).position.sel(keypoints="point_00", space="x").values[:, 0]
        np.testing.assert_array_equal(x, [np.nan, np.nan, np.nan, 319.5, 10.25, np.nan, np.nan])

    def test_names_and_the_number_of_the_first_frame(self, tmp_path: Path):
        names = ("left ear", "nose, tip", "Left ear")
        scored_tracks().save(tmp_path / "a.csv", "deeplabcut", about=About(points=names, first_frame=100))
        keypoints = read_keypoints(tmp_path / "a.csv")
        assert keypoints.names == ("left ear", "nose, tip", "Left ear_2")
        assert keypoints.frames.tolist() == [100, 101, 102, 103, 104]

    @pytest.mark.parametrize("ending", [".csv", ".h5"])
    def test_points_to_follow_come_back(self, tmp_path: Path, ending: str):
        if ending == ".h5":
            consumer("tables")
        path = tmp_path / f"a{ending}"
        scored_tracks().save(path, "deeplabcut")
        queries, names = read_keypoints(path).queries()
        np.testing.assert_array_equal(queries, [[1, 639, 359], [3, 1, 2]])
        assert names == ("point_00", "point_01")

    def test_places_come_back(self, tmp_path: Path):
        tracks = wandering_tracks()
        tracks.save(tmp_path / "a.csv", "deeplabcut")
        keypoints = read_keypoints(tmp_path / "a.csv")
        np.testing.assert_allclose(keypoints.xy[:, tracks.frames], tracks.xy, atol=6e-5)  # four decimals
        assert np.isnan(keypoints.xy[:, :4]).all()

    def test_what_does_not_fit_is_refused(self, tmp_path: Path):
        many = Tracks(
            *(np.zeros((2000, 2, 2), np.float32), np.zeros((2000, 2), bool), np.zeros((2000, 2), np.float32)),
            *(np.zeros((2000, 3), np.float32), np.arange(2)),
        )
        with pytest.raises(TracksFileError, match=r"an \.h5 of DeepLabCut cannot name 2000 points; write a \.csv"):
            many.save(tmp_path / "a.h5")
        for frames in ([-1, 0], [0, 10**15]):
            far = replace(many, frames=np.array(frames))
            with pytest.raises(TracksFileError, match=rf"there are tracks in frames {frames[0]} to {frames[1]}; mend"):
                far.save(tmp_path / "a.csv", "deeplabcut")
        assert not list(tmp_path.iterdir())
        check(2, np.array([0, 10**6 - 1]), About())
        with pytest.raises(TracksFileError, match="0 to 999999 at most, but there are tracks in frames 7 to 1000000"):
            check(2, np.array([7, 10**6]), About())


@pytest.mark.parametrize("length", [1, 40])
@pytest.mark.parametrize(("ending", "library", "least"), [(".h5", "tables", 300), (".slp", "sleap_io", 600)])
def test_the_most_points_that_can_be_named(tmp_path: Path, ending: str, library: str, least: int, length: int):
    consumer(library)
    one = Tracks(
        *(np.zeros((1, 2, 2), np.float32), np.zeros((1, 2), bool), np.zeros((1, 2), np.float32)),
        *(np.zeros((1, 3), np.float32), np.arange(2)),
    )
    fits, not_any_more = 1, 2000
    while not_any_more - fits > 1:  # the last that is taken is the most, and is written as well
        count = (fits + not_any_more) // 2
        names = tuple(f"{number:0{length}}" for number in range(count))
        tracks = replace(one, **{name: getattr(one, name).repeat(count, axis=0) for name in FIELDS})
        try:
            tracks.save(tmp_path / f"a{ending}", about=About(points=names))
            fits = count
        except TracksFileError:
            not_any_more = count
    assert least < fits < 1999


class TestSleap:
    def written(self, tmp_path: Path, tracks: Tracks | None = None, **about: Any) -> Any:
        sio = consumer("sleap_io")
        (tracks or scored_tracks()).save(tmp_path / "a.slp", about=About(**about))
        return sio.load_slp(str(tmp_path / "a.slp"), open_videos=False)

    def test_sleap_io_reads_it(self, tmp_path: Path):
        labels = self.written(tmp_path, name="goat")
        assert labels.skeleton.node_names == ["point_00", "point_01", "point_02"]
        assert [frame.frame_idx for frame in labels] == [0, 1, 2, 3, 4]
        corner = [frame.instances[0]["point_00"] for frame in labels]
        np.testing.assert_array_equal([point["xy"] for point in corner], places_of_corner())
        assert [point["score"] for point in corner] == [0.75, 1, 0, 1, 1]
        assert [bool(point["visible"]) for point in corner] == [True, True, False, True, True]
        assert labels.video.filename == "goat"
        assert tuple(labels.video.shape) == (5, HEIGHT, WIDTH, 3)
        assert labels.video.backend_metadata["fps"] == 25

    def test_movement_reads_hidden_points_as_gaps(self, tmp_path: Path):
        load = consumer("movement.io.load_poses")
        self.written(tmp_path)
        logging.disable()
        poses = load.from_sleap_file(tmp_path / "a.slp", fps=25)
        logging.disable(logging.NOTSET)
        corner = poses.position.sel(keypoints="point_00").values[..., 0]
        expected = [PLACES["corner"].get(frame, (np.nan, np.nan)) for frame in range(NUM_FRAMES)]
        np.testing.assert_array_equal(corner, expected)
        assert poses.individuals.values.tolist() == ["clip"]

    def test_more_points_than_a_skeleton_names(self, tmp_path: Path):
        many = {name: getattr(known_tracks(), name).repeat(1000, axis=0) for name in FIELDS}
        with pytest.raises(TracksFileError, match="a skeleton of SLEAP cannot have 3000 nodes; follow fewer points"):
            self.written(tmp_path, replace(known_tracks(), **many))
        assert not list(tmp_path.iterdir())

    def test_its_video(self, tmp_path: Path):
        labels = self.written(tmp_path, late_tracks(), clip=Path("shots/goat.mp4"), length=90)
        assert labels.video.filename == "shots/goat.mp4"
        assert tuple(labels.video.shape) == (90, HEIGHT, WIDTH, 3)
        assert [frame.frame_idx for frame in labels] == [3, 4]

    def test_a_part_of_a_video_is_in_the_whole(self, tmp_path: Path):
        labels = self.written(tmp_path, clip=Path("shots/goat.mp4@48:53"), length=5)
        assert labels.video.filename == "shots/goat.mp4"
        assert [frame.frame_idx for frame in labels] == [48, 49, 50, 51, 52]
        assert labels.video.shape[0] == 53

    def test_frames_in_files(self, tmp_path: Path):
        for number in range(7):
            cv2.imwrite(str(tmp_path / f"f{number}.png"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
        labels = self.written(tmp_path, clip=Path(f"{tmp_path}@1:6"), length=5)
        assert [Path(name).name for name in labels.video.filename] == ["f1.png", "f2.png", "f3.png", "f4.png", "f5.png"]
        assert [frame.frame_idx for frame in labels] == [0, 1, 2, 3, 4]
