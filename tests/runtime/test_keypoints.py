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
from decomo_runtime.formats.corrections import convert_keypoints, corrections_of
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


def test_files_as_other_programs_write_them(tmp_path: Path):
    """With a mark of their encoding; CVAT's tracks are attributes, of which there may be none."""
    content = coco()
    content["annotations"] += [content["annotations"][0] | {"id": 3}]
    attributes = ({"track_id": 1}, None, {"track_id": 2})
    content["annotations"] = [
        each | {"attributes": given} for each, given in zip(content["annotations"], attributes, strict=True)
    ]
    (tmp_path / "a.json").write_text(json.dumps(content), encoding="utf-8-sig")
    keypoints = read_keypoints(tmp_path / "a.json")
    assert keypoints.names == tuple(f"mouse{track}.{part}" for track in (1, "", 2) for part in ("nose", "tail"))


def test_crowds_and_what_has_no_keypoint_are_no_objects(tmp_path: Path):
    """COCO has all its boxes in one list."""
    content = coco()
    others = ({"iscrowd": 1}, {"keypoints": [0] * 6}, {"keypoints": []})
    expected = read_keypoints(written(tmp_path, content, "a.json"))
    content["annotations"] += [content["annotations"][0] | other for other in others]
    content["images"].append({"id": 9, "file_name": "none", "frame_id": 77})
    content["annotations"].append(content["annotations"][0] | {"image_id": 9, "keypoints": [0] * 6})
    found = read_keypoints(written(tmp_path, content, "b.json"))
    assert found.names == expected.names
    np.testing.assert_array_equal(found.frames, expected.frames)
    np.testing.assert_array_equal(found.xy, expected.xy)


def test_the_last_number_of_a_name_is_its_frame_s(tmp_path: Path):
    named = written(tmp_path, coco(images=images("cam2_0012_left.png", "cam2_0010_left.png")), "a.json")
    np.testing.assert_array_equal(read_keypoints(named, first=9).frames, [1, 3])
    from_1 = written(tmp_path, coco(images=images("f_0002.jpg", "f_0001.jpg")), "b.json")
    with pytest.raises(QueryError, match="do not tell which frames of the clip"):
        read_keypoints(from_1)


def test_empty_cells_and_lines_of_deeplabcut(tmp_path: Path):
    """As spreadsheets leave them. A place without a likelihood is not sure."""
    cells = PREDICTIONS.replace("0.7,,,", "0.7, , ,") + ",,,,,,\n\n"
    expected, found = (read_keypoints(written(tmp_path, text)) for text in (PREDICTIONS, cells))
    for name in ("frames", "xy", "score"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    unsure = read_keypoints(written(tmp_path, PREDICTIONS.replace("180.5,0.2", "180.5,")))
    np.testing.assert_array_equal(unsure.score[1], [0, 0, 0.61])
    np.testing.assert_array_equal(unsure.xy[1, 1], [300, 180.5])


def test_an_h5_that_says_to_be_huge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    h5py = consumer("h5py")
    monkeypatch.setattr("decomo_runtime.formats.deeplabcut.MOST_BYTES", 2**20)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"], group.attrs["nblocks"] = "frame", 1
        for level, names in enumerate(((b"net",), (b"nose",), (b"x", b"y"))):
            group[f"axis0_level{level}"] = list(names)
            group[f"axis0_label{level}"] = [0, 1] if len(names) > 1 else [0, 0]
        group.create_dataset("block0_values", (2**16 + 1, 2), "f8", chunks=(2**12, 2))  # with nothing in it
    with pytest.raises(QueryError, match=r"a\.h5 is not a table of DeepLabCut \(it has more than "):
        read_keypoints(tmp_path / "a.h5")


def test_half_a_place_is_none():
    keypoints = Keypoints(("ear",), np.array([2, 5]), np.array([[[NAN, 3], [4, 5]]]), np.array([[1.0, 0.7]]))
    np.testing.assert_array_equal(keypoints.queries()[0], [[5, 4, 5]])


@pytest.mark.parametrize(("count", "said"), [(5, "frames 0, 1, 2, 3, 4$"), (6, r"frames 0, 1, 2, 3, 4, \.\.\.$")])
def test_some_frames_are_named(count: int, said: str):
    keypoints = Keypoints(("ear",), np.arange(count), np.zeros((1, count, 2)), np.ones((1, count)))
    with pytest.raises(QueryError, match=said):
        keypoints.queries(frame=77)


def test_places_are_written_in_full_and_what_is_just_sure_is_in_sight():
    xy = np.array([[[100, 0], [20.5, 0.125], [3, 40]]])
    keypoints = Keypoints(("ear",), np.array([0, 3, 4]), xy, np.array([[0.6, 0.6, 0.59]]))
    assert corrections_of(keypoints) == [(0, "100", "0", 3, "20.5", "0.125", "ear")]


def test_corrections_of_images_by_the_clip_s_files(tmp_path: Path):
    named = coco(images=images("f_0012.jpg", "f_0010.jpg"))
    named["annotations"][1]["keypoints"] = [11, 21, 2, 301, 181, 2]
    files = [f"f_{number:04}.jpg" for number in range(9, 14)]
    assert convert_keypoints(written(tmp_path, named, "a.json"), tmp_path / "out.csv", files) == (2, 2)
    assert (tmp_path / "out.csv").read_text().splitlines()[1:] == ["1,11,21,3,10.5,20,nose", "1,301,181,3,,,tail"]
