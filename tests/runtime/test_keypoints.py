"""Keypoints of DeepLabCut and COCO as points to follow."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from consumers import consumer
from decomo_runtime import QueryError
from decomo_runtime.convert_cli import main as convert
from decomo_runtime.formats.corrections import corrections_of
from decomo_runtime.formats.keypoints import Keypoints
from decomo_runtime.keypoints import read_keypoints
from decomotion.clip import Clip
from decomotion.corrections.file import read_corrections

NAN = np.nan

PREDICTIONS = """\
scorer,net,net,net,net,net,net
bodyparts,nose,nose,nose,tail,tail,tail
coords,x,y,likelihood,x,y,likelihood
0,10.5,20.25,0.7,,,
1,11.5,21.25,0.95,300.0,180.5,0.2
2,12.5,22.25,0.95,301.0,181.5,0.61
"""
LABELS = """\
scorer,,,Me,Me,Me,Me
bodyparts,,,nose,nose,tail,tail
coords,,,x,y,x,y
labeled-data,mouse,img0012.png,12.5,22.25,,
labeled-data,mouse,img0003.png,10.5,20.25,300.0,180.5
"""
ANIMALS = """\
scorer,net,net,net,net,net,net
individuals,a,a,a,b,b,b
bodyparts,nose,nose,nose,nose,nose,nose
coords,x,y,likelihood,x,y,likelihood
0,10.5,20.25,0.9,30.0,40.0,0.8
"""


def written(tmp_path: Path, content: str | dict[str, Any], name: str = "keypoints.csv") -> Path:
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_predictions_of_deeplabcut(tmp_path: Path):
    keypoints = read_keypoints(written(tmp_path, PREDICTIONS))
    assert keypoints.names == ("nose", "tail")
    np.testing.assert_array_equal(keypoints.frames, [0, 1, 2])
    np.testing.assert_array_equal(keypoints.xy[1], [[NAN, NAN], [300, 180.5], [301, 181.5]])
    np.testing.assert_array_equal(keypoints.score, [[0.7, 0.95, 0.95], [0, 0.2, 0.61]])


def test_each_point_is_taken_where_it_is_surest(tmp_path: Path):
    keypoints = read_keypoints(written(tmp_path, PREDICTIONS))
    queries, names = keypoints.queries()
    np.testing.assert_array_equal(queries, [[1, 11.5, 21.25], [2, 301, 181.5]])
    assert names == ("nose", "tail")
    queries, names = keypoints.queries(frame=1)  # the tail is not sure there
    np.testing.assert_array_equal(queries, [[1, 11.5, 21.25]])
    assert names == ("nose",)
    assert len(keypoints.queries(frame=1, least=0.2)[0]) == 2


def test_what_no_point_is_taken_from_is_refused(tmp_path: Path):
    keypoints = read_keypoints(written(tmp_path, PREDICTIONS))
    with pytest.raises(QueryError, match=r"no keypoints in frame 7; they are in frames 0, 1, 2"):
        keypoints.queries(frame=7)
    with pytest.raises(QueryError, match=r"no keypoint is there in frame 0 with a score of 0\.9 or more"):
        keypoints.queries(frame=0, least=0.9)
    nothing = Keypoints((), np.empty(0, np.int64), np.empty((0, 0, 2)), np.empty((0, 0)))
    with pytest.raises(QueryError, match=r"no keypoint is there"):
        nothing.queries()


def test_labels_of_deeplabcut(tmp_path: Path):
    keypoints = read_keypoints(written(tmp_path, LABELS))
    np.testing.assert_array_equal(keypoints.frames, [3, 12])
    np.testing.assert_array_equal(keypoints.xy[0], [[10.5, 20.25], [12.5, 22.25]])
    np.testing.assert_array_equal(keypoints.score, [[1, 1], [1, 0]])
    one_index = LABELS.replace(",,,", ",").replace("labeled-data,mouse,", "labeled-data/mouse/")
    again = read_keypoints(written(tmp_path, one_index))
    np.testing.assert_array_equal(again.frames, [3, 12])
    np.testing.assert_array_equal(again.xy, keypoints.xy)


def test_several_animals_of_deeplabcut(tmp_path: Path):
    keypoints = read_keypoints(written(tmp_path, ANIMALS))
    assert keypoints.names == ("a.nose", "b.nose")
    np.testing.assert_array_equal(keypoints.xy[:, 0], [[10.5, 20.25], [30, 40]])
    alone = ANIMALS.replace("individuals,a,a,a,b,b,b", "individuals,a,a,a,a,a,a").replace("nose,nose\n", "tail,tail\n")
    assert read_keypoints(written(tmp_path, alone.replace("nose,tail,tail", "tail,tail,tail"))).names == (
        "nose",
        "tail",
    )


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("", "does not begin with 'scorer'"),
        ("t,x,y\n0,1,2\n", "does not begin with 'scorer'"),
        ("scorer,a\nbodyparts,b\n", "its header is not scorer, bodyparts, coords"),
        (PREDICTIONS.replace("coords,x", "coords,z"), "its coords are not x, y and likelihood"),
        (PREDICTIONS.replace("tail,tail,tail", "nose,nose,nose"), "'nose' is there twice"),
        (PREDICTIONS.replace("\n2,", "\n1,"), "a frame is there twice"),
        (PREDICTIONS.replace("12.5", "here"), "could not convert string to float"),
        (PREDICTIONS + "3,1.0\n", "its lines are not equally long"),
        (LABELS.replace("img0012.png", "nose.png"), "the row 'nose.png' does not tell its frame"),
    ],
)
def test_what_deeplabcut_did_not_write_is_refused(tmp_path: Path, content: str, why: str):
    with pytest.raises(QueryError, match=why) as caught:
        read_keypoints(written(tmp_path, content))
    assert "keypoints.csv" in str(caught.value)
    assert "give one that DeepLabCut wrote" in str(caught.value)


def test_other_files_are_refused(tmp_path: Path):
    with pytest.raises(QueryError, match=r"is no file of keypoints by its ending; give DeepLabCut's \.csv or \.h5"):
        read_keypoints(tmp_path / "keypoints.xml")
    for name in ("none.csv", "none.json"):
        with pytest.raises(QueryError, match=r"cannot be read \(No such file"):
            read_keypoints(tmp_path / name)


@pytest.mark.parametrize("format", ["table", "fixed"])
@pytest.mark.parametrize("content", [PREDICTIONS, LABELS, ANIMALS])
def test_h5_of_deeplabcut(tmp_path: Path, content: str, format: str):
    pandas, _, _ = consumer("pandas"), consumer("tables"), consumer("h5py")
    path = written(tmp_path, content)
    frame = pandas.read_csv(path, header=[0, 1, 2, 3] if content is ANIMALS else [0, 1, 2], index_col=[0, 1, 2])
    if content is not LABELS:
        frame = pandas.read_csv(path, header=list(range(content.count("\n0,") * (4 if content is ANIMALS else 3))))
        frame = frame.set_index(frame.columns[0])
        frame.index.name = None
    elif format == "table":
        return  # DeepLabCut writes labels as fixed alone
    frame.to_hdf(tmp_path / "keypoints.h5", key="df_with_missing", format=format)
    told, expected = read_keypoints(tmp_path / "keypoints.h5"), read_keypoints(path)
    assert told.names == expected.names
    np.testing.assert_array_equal(told.frames, expected.frames)
    np.testing.assert_array_equal(told.xy, expected.xy)
    np.testing.assert_array_equal(told.score, expected.score)


class Harmful:
    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("harmed"),)


def test_h5_runs_no_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    h5py = consumer("h5py")
    monkeypatch.chdir(tmp_path)
    with h5py.File("harmful.h5", "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"] = "frame_table"
        group.attrs["non_index_axes"] = np.void(pickle.dumps([(1, [Harmful()])]))
        group["table"] = np.zeros(1, [("index", "i8"), ("values_block_0", "f8", (3,))])
    with pytest.raises(QueryError, match=r"its names are made by .*, which is not run"):
        read_keypoints("harmful.h5")
    assert not Path("harmed").exists()


def coco(**changes: Any) -> dict[str, Any]:
    names = ["nose", "tail"]
    return {
        "images": [{"id": 7, "file_name": "b.png", "frame_id": 4}, {"id": 8, "file_name": "a.png", "frame_id": 2}],
        "annotations": [
            {"id": 1, "image_id": 7, "category_id": 3, "keypoints": [10.5, 20, 2, 300, 180, 1]},
            {"id": 2, "image_id": 8, "category_id": 3, "keypoints": [0, 0, 0, 301, 181, 2]},
        ],
        "categories": [{"id": 3, "name": "mouse", "keypoints": names}],
        **changes,
    }


def test_coco_keypoints(tmp_path: Path):
    keypoints = read_keypoints(written(tmp_path, coco(), "a.json"))
    assert keypoints.names == ("nose", "tail")
    np.testing.assert_array_equal(keypoints.frames, [2, 4])
    np.testing.assert_array_equal(keypoints.xy, [[[NAN, NAN], [10.5, 20]], [[301, 181], [300, 180]]])
    np.testing.assert_array_equal(keypoints.score, [[0, 1], [1, 0]])
    np.testing.assert_array_equal(keypoints.queries()[0], [[4, 10.5, 20], [2, 301, 181]])


def images(*names: str) -> list[dict[str, Any]]:
    return [{"id": number, "file_name": name} for number, name in zip((7, 8), names, strict=True)]


def test_frames_of_coco_by_the_clip_s_files_or_their_numbers(tmp_path: Path):
    named = written(tmp_path, coco(images=images("shots/f_0012.jpg", "shots/f_0010.jpg")), "a.json")
    files = [f"f_{number:04}.jpg" for number in range(9, 14)]
    np.testing.assert_array_equal(read_keypoints(named, files).frames, [1, 3])
    np.testing.assert_array_equal(read_keypoints(named, first=1).frames, [9, 11])
    with pytest.raises(QueryError, match=r"the images \('f_0012\.jpg', \.\.\.\) do not tell which frames of the clip"):
        read_keypoints(named)
    from_0 = written(tmp_path, coco(images=images("f_0012.jpg", "f_0000.jpg")), "b.json")
    np.testing.assert_array_equal(read_keypoints(from_0).frames, [0, 12])


def test_coco_says_the_size_of_its_images(tmp_path: Path):
    content = coco()
    content["images"][0] |= {"width": 640, "height": 360}
    assert read_keypoints(written(tmp_path, content, "a.json")).size == (360, 640)
    content["images"][1] |= {"width": 360, "height": 640}
    with pytest.raises(QueryError, match=r"a\.json has images of 640x360 and 360x640, which are not of one clip"):
        read_keypoints(written(tmp_path, content, "a.json"))


def test_several_objects_of_coco(tmp_path: Path):
    both = coco()
    for annotation in both["annotations"]:
        annotation["image_id"] = 7
    assert read_keypoints(written(tmp_path, both, "a.json")).names == (
        "mouse1.nose",
        "mouse1.tail",
        "mouse2.nose",
        "mouse2.tail",
    )
    both["annotations"].append(both["annotations"][0] | {"image_id": 8})
    with pytest.raises(QueryError, match=r"an image has several objects and no track_id tells them apart"):
        read_keypoints(written(tmp_path, both, "a.json"))
    for annotation, track in zip(both["annotations"], (5, 6, 5), strict=True):
        annotation["track_id"] = track
    keypoints = read_keypoints(written(tmp_path, both, "a.json"))
    assert keypoints.names == ("mouse5.nose", "mouse5.tail", "mouse6.nose", "mouse6.tail")
    np.testing.assert_array_equal(keypoints.score[0], [1, 1])


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("[", "does not hold COCO keypoints"),
        ([1], "does not hold COCO keypoints"),
        ({"images": []}, "does not hold COCO keypoints"),
        (coco(annotations=[]), "holds no keypoints"),
        (coco(categories=[]), "does not hold COCO keypoints"),
        (coco(images=[{"id": 7, "frame_id": 1e400}, {"id": 8, "frame_id": 0}]), "does not hold COCO keypoints"),
    ],
)
def test_what_is_not_coco_is_refused(tmp_path: Path, content: Any, why: str):
    with pytest.raises(QueryError, match=why):
        read_keypoints(written(tmp_path, content, "a.json"))


def test_keypoints_become_corrections(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "labels.csv").write_text(PREDICTIONS)
    out = tmp_path / "corrections.csv"
    assert convert([str(tmp_path / "labels.csv"), str(out), "--to", "corrections"]) == 0
    assert capsys.readouterr().out == f"2 corrections of 1 point\nwrote {out}\n"
    nose = "0,10.5,20.25,1,11.5,21.25,nose\n0,10.5,20.25,2,12.5,22.25,nose\n"  # the tail is sure in one frame alone
    assert out.read_text() == f"t,x,y,target_t,target_x,target_y,name\n{nose}"
    clip = Clip("blank", np.zeros((3, 30, 40, 3), np.uint8))
    (point,) = read_corrections(out, clip)
    assert point.xy.tolist() == [[10.5, 20.25], [11.5, 21.25], [12.5, 22.25]]


def test_hidden_keypoints_become_hidden_corrections():
    frames = np.array([2, 5, 7, 9])
    xy = np.array([[[1, 2], [3.5, 4], [5, 6], [NAN, NAN]]])
    keypoints = Keypoints(("ear",), frames, xy, np.array([[0.3, 1, 0, 0]]))
    assert corrections_of(keypoints) == [(5, "3.5", "4", 7, "", "", "ear")]


def test_keypoints_of_one_frame_correct_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "labels.csv").write_text("\n".join(PREDICTIONS.splitlines()[:4]))
    assert convert([str(tmp_path / "labels.csv"), str(tmp_path / "out.csv"), "--to", "corrections"]) == 2
    assert "label more frames" in capsys.readouterr().err
    assert not (tmp_path / "out.csv").exists()
