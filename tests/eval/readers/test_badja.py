"""BADJA: joints by SMAL's numbers, (y, x) in pixels, in the frames that are annotated."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from dataset_files import FRAMES, HEIGHT, WIDTH, write_badja, write_joints
from decomo_eval.dataset import read_dataset
from decomo_eval.errors import DatasetError
from decomo_eval.measure import score
from decomo_eval.predictions import Prediction
from decomo_eval.readers.badja import JOINTS
from decomo_eval.tapvid import sample_queries

ANIMAL = "horsejump-high"
SMAL = [8, 9, 10, 12, 13, 14, 15, 18, 19, 20, 22, 23, 24, 25, 28, 31, 32, 33, 35, 36]
"""The annotated joints in the order of BADJA's own list."""


def test_a_video(tmp_path: Path) -> None:
    truth = write_badja(tmp_path)
    videos = read_dataset(tmp_path)
    assert list(videos) == [ANIMAL]
    video = videos[ANIMAL]
    assert list(JOINTS) == SMAL
    at = truth["numbers"] - truth["numbers"][0]
    assert video.num_frames == at[-1] + 1 == 9
    seen = truth["visible"][:, SMAL].T
    ever = seen.any(axis=1)
    assert video.judged is not None
    assert np.flatnonzero(video.judged.all(axis=0)).tolist() == at.tolist()
    np.testing.assert_array_equal(~video.occluded[:, at], seen[ever])
    assert (~video.occluded).sum() == seen.sum()
    xy = truth["joints"][:, SMAL, ::-1].swapaxes(0, 1)[ever]
    np.testing.assert_allclose(video.points[:, at] * [WIDTH, HEIGHT], xy)
    first = cv2.imread(str(tmp_path / f"DAVIS/JPEGImages/Full-Resolution/{ANIMAL}/00002.jpg"))
    assert first is not None
    np.testing.assert_array_equal(video.frames()[0], first[..., ::-1])


def test_frames_without_annotation_do_not_count(tmp_path: Path) -> None:
    write_badja(tmp_path)
    video = read_dataset(tmp_path)[ANIMAL]
    queries = sample_queries(video, "first")
    assert queries.judged is not None
    answer = Prediction(queries.tracks + 99 * ~queries.judged[..., None], ~queries.judged ^ True, (WIDTH, HEIGHT))
    answer = Prediction(answer.tracks, queries.occluded & queries.judged, answer.size)
    metrics = score(queries, answer, "first")
    assert metrics["occlusion_accuracy"] == metrics["average_jaccard"] == 1
    assert video.figures is not None
    assert video.figures(answer.tracks, answer.occluded) == {"badja_pck": 1, "badja_pck_3px": 1}


def test_the_threshold_is_of_the_mask_at_512x384(tmp_path: Path) -> None:
    truth = write_badja(tmp_path)
    video = read_dataset(tmp_path)[ANIMAL]
    visible = ~video.occluded
    counted = visible & (np.arange(video.num_frames) > visible.argmax(axis=1)[:, None])
    assert video.figures is not None
    for frame in np.flatnonzero(counted.any(axis=0)):
        mask = truth["masks"][2 + frame]
        limit = 0.2 * np.sqrt((mask > 0).sum() * 512 * 384 / mask.size)  # here scaled up by whole numbers but 12.8
        for off, share in ((limit * 0.97, 1), (limit * 1.03, 0)):
            tracks = video.points * 256
            tracks[:, frame, 1] += off * 256 / 384
            others = counted.sum() - counted[:, frame].sum()
            expected = (others + share * counted[:, frame].sum()) / counted.sum()
            assert video.figures(tracks, video.occluded)["badja_pck"] == pytest.approx(expected)


def test_extra_videos_are_left_out(tmp_path: Path) -> None:
    path = "extra_videos/rs_dog/segments/00000.png"
    write_badja(tmp_path)
    write_joints(tmp_path, "rs_dog.json", [{"image_path": path, "segmentation_path": path}])
    assert list(read_dataset(tmp_path)) == [ANIMAL]
    (tmp_path / "joint_annotations" / f"{ANIMAL}.json").unlink()
    with pytest.raises(DatasetError, match="annotates no clip of DAVIS"):
        read_dataset(tmp_path)


def test_one_animal_twice_is_refused(tmp_path: Path) -> None:
    write_badja(tmp_path)
    folder = tmp_path / "joint_annotations"
    (folder / "again.json").write_bytes((folder / f"{ANIMAL}.json").read_bytes())
    with pytest.raises(DatasetError, match="both annotate horsejump-high"):
        read_dataset(tmp_path)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"joints": [[1, 2]] * 36}, r"must have joints \[37, 2\] and visibility \[37\]"),
        ({"joints": [[1, 2, 3]] * 37}, r"must have joints \[37, 2\]"),
        ({"joints": [[1, 2]] * 36 + [[1]]}, r"must have joints \[37, 2\]"),
        ({"joints": [["a", 2]] * 37}, r"must have joints \[37, 2\]"),
        ({"joints": [[float("nan"), 2]] * 37}, "a visible joint whose position is not finite"),
        ({"visibility": None}, r"visibility \[37\]"),
        ({"segmentation_path": 3}, "a path below its folder as segmentation_path"),
        ({"image_path": "../00002.jpg"}, "a path below its folder as image_path"),
        ({"segmentation_path": f"DAVIS/{ANIMAL}/99999999.png"}, "a frame's file is named by its number"),
        ({"image_path": "DAVIS/JPEGImages/480p/horsejump-high/00002.jpg"}, "the first among them"),
        ({"image_path": f"DAVIS/JPEGImages/Full-Resolution/{ANIMAL}/00002.png"}, "the first among them"),
    ],
)
def test_what_does_not_fit_is_named(changed: dict[str, Any], words: str, tmp_path: Path) -> None:
    write_badja(tmp_path, **changed)
    with pytest.raises(DatasetError, match=words):
        read_dataset(tmp_path)


@pytest.mark.parametrize("content", ["no json", "[" * 100_000, "[]", "[3]", "{}"])
def test_damaged_annotations(content: str, tmp_path: Path) -> None:
    write_badja(tmp_path)
    (tmp_path / "joint_annotations" / "bear.json").write_text(content)
    with pytest.raises(DatasetError, match=r"bear.json (cannot be read as JSON|must be a list of annotated frames)"):
        read_dataset(tmp_path)


def test_files_that_are_missing_are_named(tmp_path: Path) -> None:
    write_badja(tmp_path)
    video = read_dataset(tmp_path)[ANIMAL]
    masks = tmp_path / "DAVIS/Annotations/Full-Resolution" / ANIMAL
    assert video.figures is not None
    for content, words in ((b"no png", "does not decode"), (b"", "does not decode"), (None, "cannot be read")):
        for mask in masks.iterdir():
            mask.unlink() if content is None else mask.write_bytes(content)
        with pytest.raises(DatasetError, match=words):
            video.figures(video.points, video.occluded)
    (tmp_path / f"DAVIS/JPEGImages/Full-Resolution/{ANIMAL}/00005.jpg").unlink()
    with pytest.raises(DatasetError, match=rf"00005.jpg, which is missing \(1 of {FRAMES - 4}\)"):
        read_dataset(tmp_path)[ANIMAL]


def test_only_red_of_a_mask_is_the_animal(tmp_path: Path) -> None:
    """Blue ones beside it do not make the threshold larger."""
    write_badja(tmp_path)
    video = read_dataset(tmp_path)[ANIMAL]
    tracks = video.points * 256
    tracks[..., 1] += 70 * 256 / 384  # of 512x384, about twice what the mask allows
    assert video.figures is not None
    before = video.figures(tracks, video.occluded)
    for file in (tmp_path / "DAVIS/Annotations/Full-Resolution" / ANIMAL).iterdir():
        mask = cv2.imread(str(file))
        assert mask is not None
        mask[..., 0] = 255
        mask[..., 1] = 0
        cv2.imwrite(str(file), mask)
    assert video.figures(tracks, video.occluded) == before
    assert before["badja_pck"] < 1


def test_a_video_is_what_lies_between_its_first_and_last_line_in_its_own_clip(tmp_path: Path) -> None:
    """Lines of frames before, behind and of another animal are not read."""
    truth = write_badja(tmp_path)
    expected = read_dataset(tmp_path)[ANIMAL]
    file = tmp_path / "joint_annotations" / f"{ANIMAL}.json"
    entries = json.loads(file.read_text())
    strange = {**entries[1], "joints": [[1, 1]] * 37, "visibility": [True] * 37}
    others = [f"{ANIMAL}/00000.jpg", f"{ANIMAL}/00012.jpg", "bear/00007.jpg"]
    for number, other in enumerate(others, 1):
        entries.insert(number, {**strange, "image_path": f"DAVIS/JPEGImages/Full-Resolution/{other}"})
    write_joints(tmp_path, file.name, entries)
    video = read_dataset(tmp_path)[ANIMAL]
    np.testing.assert_array_equal(video.points, expected.points)
    np.testing.assert_array_equal(video.occluded, expected.occluded)
    assert truth["numbers"].tolist() == [2, 6, 10]
