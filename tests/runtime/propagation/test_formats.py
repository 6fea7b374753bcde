"""Files of annotations, read and written: what their tools read back, and what is refused."""

from __future__ import annotations

import contextlib
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from PIL import Image

from consumers import consumer
from decomo_runtime import AnnotationError, Tracker, propagate_files
from decomo_runtime.propagation.cli import main
from decomo_runtime.propagation.formats import registry
from decomo_runtime.propagation.formats.asked import ClipFacts
from decomo_runtime.propagation.shapes import Annotation, Kind, Shape
from decomotion.windows import FILE_NAME, Windows, split
from tiny_fit import FRAMES, HEIGHT, WIDTH, sliding_square, write_frames
from tiny_model import write_tiny_model
from true_tracker import TrueTracker, square_mask

FILES = [f"{frame:05d}.jpg" for frame in range(FRAMES)]
CLIP = ClipFacts((HEIGHT, WIDTH), FRAMES, "sliding", FILES)
SQUARE = [[2, 10], [14, 10], [14, 22], [2, 22]]
"""Of frame 0, from pixel border to pixel border."""


def read(path: Path, frame: int | None = None, clip: ClipFacts = CLIP) -> Annotation:
    return registry.read([(path, frame)], clip)[0]


def written(path: Path, folder: Path, *others: Path, frame: int | None = None) -> Path:
    """A file's annotation, each shape in its own frame, written again."""
    annotation, form = registry.read([(each, frame) for each in (path, *others)], CLIP)
    folder.mkdir()
    frames = ((at, [each for each in annotation.shapes if each.frame == at]) for at in range(FRAMES))
    form.write(folder, annotation, frames, CLIP)
    return folder


def save(path: Path, content: Any) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def same(one: Annotation, other: Annotation) -> bool:
    def key(annotation: Annotation, shape: Shape) -> tuple[Any, ...]:
        region = shape.mask.tobytes() if shape.mask is not None else np.round(shape.xy, 1).tolist()
        return annotation.things[shape.thing].id, shape.frame, shape.kind, str(region)

    keys = [sorted(key(each, shape) for shape in each.shapes) for each in (one, other)]
    return keys[0] == keys[1]


def coco(**changes: Any) -> dict[str, Any]:
    images = [{"id": 7, "file_name": "00000.jpg", "width": WIDTH, "height": HEIGHT, "frame_id": 0}]
    polygon = {
        "id": 1,
        "image_id": 7,
        "category_id": 3,
        "track_id": 9,
        "segmentation": [[each for corner in SQUARE for each in corner]],
    }
    counts = [2, 3, HEIGHT * WIDTH - 5]
    run = {"id": 2, "image_id": 7, "category_id": 3, "track_id": 10}
    run["segmentation"] = {"size": [HEIGHT, WIDTH], "counts": counts}
    box = {"id": 3, "image_id": 7, "category_id": 3, "track_id": 11, "bbox": [20, 3, 8, 6]}
    points = {"id": 4, "image_id": 7, "category_id": 4, "track_id": 1, "keypoints": [5, 12, 2, 30, 3, 1, 0, 0, 0]}
    categories = [{"id": 3, "name": "square"}, {"id": 4, "name": "pose", "keypoints": ["a", "b", "c"]}]
    return {"images": images, "categories": categories, "annotations": [polygon, run, box, points]} | changes


def labelme(**changes: Any) -> dict[str, Any]:
    shapes = [
        {"label": "square", "points": SQUARE, "group_id": None, "shape_type": "polygon", "flags": {"good": True}},
        {"label": "box", "points": [[20, 3], [28, 9]], "group_id": 2, "shape_type": "rectangle", "flags": {}},
        {"label": "nose", "points": [[5.5, 12.5]], "group_id": None, "shape_type": "point", "flags": {}},
    ]
    about = {"imagePath": "00000.jpg", "imageData": None, "imageHeight": HEIGHT, "imageWidth": WIDTH}
    return {"version": "5.5.0", "flags": {}, "shapes": shapes} | about | changes


CVAT = f"""<?xml version="1.0" encoding="utf-8"?>
<annotations><version>1.1</version>
<meta><task><original_size><width>{WIDTH}</width><height>{HEIGHT}</height></original_size></task></meta>
<track id="4" label="square" source="manual">
<polygon frame="0" keyframe="1" outside="0" occluded="0" points="2,10;14,10;14,22;2,22" z_order="0"></polygon>
<polygon frame="1" keyframe="0" outside="0" occluded="0" points="3,10;15,10;15,22;3,22" z_order="0"></polygon>
</track>
<track id="5" label="box"><box frame="2" keyframe="1" outside="0" occluded="0" xtl="20" ytl="3" xbr="28" ybr="9"/>
<box frame="3" keyframe="1" outside="1" occluded="0" xtl="20" ytl="3" xbr="28" ybr="9"/></track>
<track id="6" label="nose"><points frame="0" keyframe="1" outside="0" occluded="0" points="5.5,12.5"/></track>
<track id="7" label="patch">
<mask frame="0" keyframe="1" outside="0" occluded="0" rle="1, 2, 3" left="30" top="2" width="3" height="2"/>
</track></annotations>"""


def label_studio(kind: str = "image") -> list[dict[str, Any]]:
    size = {"original_width": WIDTH, "original_height": HEIGHT, "from_name": "label", "to_name": kind}
    percent = [[100 * x / WIDTH, 100 * y / HEIGHT] for x, y in SQUARE]
    box = {"x": 50.0, "y": 25.0, "width": 20.0, "height": 25.0, "rotation": 0}
    if kind == "video":
        value = {"sequence": [{"frame": 3, "enabled": True, **box}], "labels": ["box"]}
        results = [{"id": "b", "type": "videorectangle", "value": value} | size]
    else:
        results = [
            {"id": "a", "type": "polygonlabels", "value": {"points": percent, "polygonlabels": ["square"]}} | size,
            {"id": "b", "type": "rectanglelabels", "value": box | {"rectanglelabels": ["box"]}} | size,
            {"id": "c", "type": "keypointlabels", "value": {"x": 12.5, "y": 50.0, "keypointlabels": ["nose"]}} | size,
        ]
    return [{"id": 1, "data": {kind: f"/data/{kind}s/00000.jpg"}, "annotations": [{"result": results}]}]


SAMPLES = {"coco.json": coco(), "labelme.json": labelme(), "a.xml": CVAT, "images.json": label_studio()}
SAMPLES["video.json"] = label_studio("video")


@pytest.mark.parametrize("name", SAMPLES)
def test_what_is_written_is_what_was_read(name: str, tmp_path: Path):
    path = save(tmp_path / name, SAMPLES[name])
    folder = written(path, tmp_path / "out")
    (first, *_) = sorted(folder.iterdir())
    assert same(read(first), read(path))


@pytest.mark.parametrize("name", ["coco.json", "labelme.json", "a.xml", "images.json"])
def test_pixels_are_where_their_tool_has_them(name: str, tmp_path: Path):
    annotation = read(save(tmp_path / name, SAMPLES[name]))
    shapes = {(annotation.things[each.thing].name, each.kind): each for each in annotation.shapes}
    np.testing.assert_array_equal(shapes["square", Kind.POLYGON].mask, square_mask(0))
    points = shapes["pose" if name == "coco.json" else "nose", Kind.POINTS]
    np.testing.assert_allclose(points.xy[0], (5, 12) if name != "images.json" else (4.5, 13.5))
    box = next(each for each in annotation.shapes if each.kind == Kind.BOX)
    np.testing.assert_allclose(
        box.xy, [[19.5, 2.5], [27.5, 8.5]] if name != "images.json" else [[19.5, 6.5], [27.5, 13.5]]
    )


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_pycocotools_reads_masks_as_we_do(tmp_path: Path):
    tool = consumer("pycocotools.coco")
    folder = written(save(tmp_path / "coco.json", coco()), tmp_path / "out")
    with contextlib.redirect_stdout(io.StringIO()):
        opened = tool.COCO(str(folder / "annotations.json"))
    polygon, run, box, points = opened.loadAnns(opened.getAnnIds())
    np.testing.assert_array_equal(opened.annToMask(polygon), square_mask(0))
    assert opened.annToMask(run).T.ravel()[:6].tolist() == [0, 0, 1, 1, 1, 0]
    assert [each["track_id"] for each in (polygon, run, box, points)] == [9, 10, 11, 1]
    assert box["bbox"] == [20, 3, 8, 6]
    assert points["keypoints"] == [5, 12, 2, 30, 3, 1, 0, 0, 0]


def test_categories_of_all_files_are_kept(tmp_path: Path):
    one, other = coco(), coco(categories=[{"id": 8, "name": "other"}])
    other["images"][0] |= {"frame_id": 1, "file_name": "00001.jpg"}
    attributes = {"attributes": {"colour": "red"}, "iscrowd": 1}
    other["annotations"] = [one["annotations"][1] | attributes | {"category_id": 8, "track_id": 1}]
    folder = written(save(tmp_path / "a.json", one), tmp_path / "out", save(tmp_path / "b.json", other))
    top = json.loads((folder / "annotations.json").read_text())
    assert [each["id"] for each in top["categories"]] == [3, 4, 8]
    last = top["annotations"][-1]
    assert last["segmentation"]["counts"] == [2, 3, HEIGHT * WIDTH - 5]
    assert {name: last[name] for name in attributes} == attributes


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_run_lengths_in_a_string_are_read(tmp_path: Path):
    tool = consumer("pycocotools.mask")
    packed = tool.encode(np.asfortranarray(square_mask(4).astype(np.uint8)))
    content = coco()
    content["annotations"] = [
        content["annotations"][1] | {"segmentation": {**packed, "counts": packed["counts"].decode()}}
    ]
    (shape,) = read(save(tmp_path / "coco.json", content)).shapes
    np.testing.assert_array_equal(shape.mask, square_mask(4))


def test_cvat_s_interpolation_is_not_read(tmp_path: Path):
    annotation = read(save(tmp_path / "a.xml", CVAT))
    assert sorted((annotation.things[each.thing].id, each.frame) for each in annotation.shapes) == [
        ("4", 0),
        ("5", 2),
        ("6", 0),
        ("7", 0),
    ]


def test_cvat_is_told_where_an_object_is_gone(tmp_path: Path):
    folder = written(save(tmp_path / "a.xml", CVAT), tmp_path / "out")
    tracks = {each.get("id"): list(each) for each in ElementTree.parse(folder / "annotations.xml").iter("track")}
    assert [(each.get("frame"), each.get("outside")) for each in tracks["5"]] == [("2", "0"), ("3", "1")]


def test_cvat_s_points_are_all_there_or_outside(tmp_path: Path):
    text = CVAT.replace('points="5.5,12.5"', 'points="5.5,12.5;2.5,3.5"')
    propagate_files(TrueTracker(), [save(tmp_path / "a.xml", text)], tmp_path / "out")  # type: ignore[arg-type]
    tracks = {
        each.get("id"): list(each) for each in ElementTree.parse(tmp_path / "out" / "annotations.xml").iter("track")
    }
    assert [each.get("outside") for each in tracks["6"]] == ["0", "0", "0", "1"]
    assert tracks["6"][2].get("points") == "9.50,12.50;0.50,3.50"


def test_a_label_studio_video_counts_from_one(tmp_path: Path):
    path = save(tmp_path / "video.json", label_studio("video"))
    assert read(path).frames == [2]
    top = json.loads((written(path, tmp_path / "out") / "tasks.json").read_text())
    (item,) = top[0]["predictions"][0]["result"][0]["value"]["sequence"]
    assert (item["frame"], item["enabled"]) == (3, False)


@pytest.mark.parametrize(
    ("image", "written_as"),
    [
        ("/data/local-files/?d=clips/a/00002.jpg", "/data/local-files/?d=clips/a/00001.jpg"),
        ("/data/local-files/?d=clips%2Fa%2F00002.jpg&x=1", "/data/local-files/?d=clips%2Fa%2F00001.jpg&x=1"),
        ("s3://bucket/a/00002.jpg", "s3://bucket/a/00001.jpg"),
        ("https://host:80/a%20b/00002.jpg?token=3/4", "https://host:80/a%20b/00001.jpg?token=3/4"),
        ("/data/upload/7/1a2b3c4d-00002.jpg", "/data/upload/7/00001.jpg"),
        ("00002.jpg", "00001.jpg"),
    ],
)
def test_label_studio_s_images_are_told_by_their_address(image: str, written_as: str, tmp_path: Path):
    tasks = label_studio()
    tasks[0]["data"]["image"] = image
    path = save(tmp_path / "images.json", tasks)
    assert read(path).frames == [2]
    top = json.loads((written(path, tmp_path / "out") / "tasks.json").read_text())
    assert top[1]["data"]["image"] == written_as


def test_label_studio_s_results_without_a_place_are_left_alone(tmp_path: Path):
    tasks = label_studio()
    tasks[0]["annotations"][0]["result"] += [
        {"type": "relation", "from_id": "a", "to_id": "b", "direction": "right"},
        {"type": "rating", "value": {"rating": 3}, "from_name": "quality", "to_name": "image"},
    ]
    tasks[0]["annotations"].append({"result": [], "was_cancelled": True})
    assert len(read(save(tmp_path / "images.json", tasks)).shapes) == 3


def test_null_attributes_are_none(tmp_path: Path):
    content = coco()
    content["annotations"] = [content["annotations"][0] | {"attributes": None}]
    assert len(read(save(tmp_path / "coco.json", content)).shapes) == 1


def turned_coco() -> dict[str, Any]:
    content = coco()
    content["annotations"][2]["attributes"] = {"rotation": 30.0}
    return content


def turned_image() -> list[dict[str, Any]]:
    tasks = label_studio()
    tasks[0]["annotations"][0]["result"][0]["image_rotation"] = 90
    return tasks


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.xml", CVAT.replace('ybr="9"', 'ybr="9" rotation="30.0"')),
        ("coco.json", turned_coco()),
        ("images.json", turned_image()),
    ],
)
def test_what_is_turned_is_refused(name: str, content: Any, tmp_path: Path):
    with pytest.raises(AnnotationError, match=r"turned.*, which is not carried; draw"):
        read(save(tmp_path / name, content))


@pytest.mark.parametrize("bits", [8, 16])
def test_grey_labels_keep_values_and_depth(bits: int, tmp_path: Path):
    value = 255 if bits == 8 else 40_000
    labels = np.where(square_mask(0), value, 0).astype(f"uint{bits}")
    cv2.imwrite(str(tmp_path / "a.png"), labels)
    folder = written(tmp_path / "a.png", tmp_path / "out", frame=0)
    again = cv2.imread(str(folder / "00000.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(again, labels)
    assert again.dtype == labels.dtype


def test_what_is_transparent_is_no_object(tmp_path: Path):
    Image.merge("LA", [Image.new("L", (WIDTH, HEIGHT), 255), Image.fromarray(square_mask(0)).convert("L")]).save(
        tmp_path / "a.png"
    )
    (shape,) = read(tmp_path / "a.png", 0).shapes
    np.testing.assert_array_equal(shape.mask, square_mask(0))


@pytest.mark.parametrize(
    ("mode", "transparent", "left"),
    [("L", 4, [9]), ("I;16", 400, [900]), ("1", 255, []), ("RGB", (4, 4, 4), [9]), ("P", 4, [9]), ("L", 5, [4, 9])],
)
def test_a_transparent_value_is_no_object_in_whatever_kind_of_png(
    mode: str, transparent: int | tuple[int, ...], left: list[int], tmp_path: Path
):
    """PNG's chunk tRNS: one grey, one colour, or entries of the palette."""
    scale = 100 if mode == "I;16" else 1
    labels = np.zeros((HEIGHT, WIDTH), np.uint16 if mode == "I;16" else np.uint8)
    labels[2:5, 3:9], labels[9:12, 1:20] = 4 * scale, 9 * scale
    image = Image.fromarray(np.where(labels > 0, 255, 0).astype(np.uint8) if mode == "1" else labels)
    if mode == "P":
        image = Image.fromarray(labels, "P")
        image.putpalette([value for entry in range(10) for value in (entry, 90, 0)])
    elif mode in ("1", "RGB"):
        image = image.convert(mode)
    image.save(tmp_path / "a.png", transparency=transparent)
    assert b"tRNS" in (tmp_path / "a.png").read_bytes()
    if not left:
        with pytest.raises(AnnotationError, match="black: no pixel of it is an object's"):
            read(tmp_path / "a.png", 0)
        return
    assert [thing.id for thing in read(tmp_path / "a.png", 0).things] == left


@pytest.mark.parametrize("deep", [2, 8])
def test_a_palette_is_kept(deep: int, tmp_path: Path):
    labels = np.where(square_mask(0), 3, 0).astype(np.uint8)
    labels[:2, :5] = 1
    image = Image.fromarray(labels, "P")
    image.putpalette([0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0])
    image.save(tmp_path / "a.png", bits=deep)
    assert [each.id for each in read(tmp_path / "a.png", 0).things] == [1, 3]
    again = Image.open(written(tmp_path / "a.png", tmp_path / "out", frame=0) / "00000.png")
    assert again.mode == "P"
    np.testing.assert_array_equal(np.asarray(again), labels)
    assert again.getpalette()[:12] == [0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0]


def with_shape(**changes: Any) -> dict[str, Any]:
    return labelme(shapes=[labelme()["shapes"][0] | changes])


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.json", labelme(imageWidth=WIDTH + 1), "image of 41x28 but the clip is 40x28"),
        ("a.json", labelme(imagePath="other.jpg"), "is drawn on other.jpg, and which frame that is is not told"),
        ("a.json", with_shape(points=[[90, 90], [99, 90], [99, 99]]), "polygon in frame 0 that lies outside"),
        ("a.json", with_shape(shape_type="point", points=[[90, 90]]), "a point in frame 0 that lies outside"),
        ("a.json", with_shape(shape_type="rectangle", points=[[50, 5], [60, 9]]), "a box in frame 0 that lies outside"),
        ("a.json", with_shape(points=[[1, 2], [3, 4]]), "3 or more corners"),
        ("a.json", with_shape(points=[[1, 2], [1e30, 4], [3, 3]]), "3 or more corners"),
        ("a.json", with_shape(points=[["x", 2]]), "is not as labelme has it"),
        ("a.json", with_shape(shape_type="circle"), "has a circle, which is not carried"),
        ("a.json", coco(images=[]) | {"images": [{"id": 7, "file_name": "x.jpg"}]}, "do not tell which frames"),
        ("a.json", {"a": 1}, "neither COCO's nor labelme's nor Label Studio's"),
        ("a.json", "{", "is not JSON"),
        ("a.xml", "<a", "is not XML"),
        ("a.xml", "<!DOCTYPE x [<!ENTITY a 'b'>]><annotations/>", "declares entities"),
        ("a.xml", "<annotations><image/></annotations>", "not of CVAT for video"),
        ("a.png", "no picture", "does not decode as a PNG"),
        ("a.tif", "", "no file of annotations by its ending"),
    ],
)
def test_bad_files_are_told_in_a_sentence(name: str, content: Any, sentence: str, tmp_path: Path):
    with pytest.raises(AnnotationError, match=sentence):
        read(save(tmp_path / name, content), 0 if name == "a.png" else None)


def test_labels_without_frame_of_another_size_empty_or_in_colours_are_refused(tmp_path: Path):
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), square_mask(0).astype(np.uint8))
    with pytest.raises(AnnotationError, match=r"give .*a\.png@T"):
        read(path)
    with pytest.raises(AnnotationError, match="is 40x28 but the clip is 41x28"):
        read(path, 0, replace(CLIP, size=(HEIGHT, WIDTH + 1)))
    cv2.imwrite(str(path), np.zeros((HEIGHT, WIDTH), np.uint8))
    with pytest.raises(AnnotationError, match="is black"):
        read(path, 0)
    cv2.imwrite(str(path), np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8))
    with pytest.raises(AnnotationError, match="colours without a palette"):
        read(path, 0)


def test_shapes_that_nothing_tells_apart_are_refused(tmp_path: Path):
    two = [*labelme()["shapes"][:1] * 2]
    paths = [save(tmp_path / f"{at}.json", labelme(shapes=two, imagePath=FILES[at])) for at in (0, 1)]
    assert len(read(paths[0]).things) == 2
    with pytest.raises(AnnotationError, match="nothing tells apart from frame to frame"):
        registry.read([(path, None) for path in paths], CLIP)
    with pytest.raises(AnnotationError, match="a second time in frame 0"):
        registry.read([(paths[0].with_name(name), None) for name in (one(tmp_path, "a"), one(tmp_path, "b"))], CLIP)
    masked = [{"label": "a", "group_id": 1, "shape_type": "polygon", "points": SQUARE}]
    content = coco()
    content["annotations"] = [entry | {"track_id": 9} for entry in content["annotations"][:1]]
    first = save(tmp_path / "first.json", content)
    content["annotations"] = [coco()["annotations"][1] | {"track_id": 9}]
    second = save(tmp_path / "second.json", content)
    with pytest.raises(AnnotationError, match="a mask in one frame and a polygon in another"):
        registry.read([(first, 0), (second, 1)], CLIP)
    assert len(read(save(tmp_path / "one.json", labelme(shapes=masked * 2))).things) == 1
    with pytest.raises(AnnotationError, match="several formats"):
        registry.read([(paths[0], None), (save(tmp_path / "a.xml", CVAT), None)], CLIP)


def one(folder: Path, name: str) -> str:
    return save(folder / f"{name}.json", labelme()).name


def test_the_command_carries_and_reports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any):
    clip = write_frames(sliding_square(), tmp_path / "sliding")
    for frame in (0, 5):
        shape = square_mask(frame) if frame == 0 else np.roll(square_mask(frame), 3, axis=0)
        cv2.imwrite(str(tmp_path / f"{frame}.png"), shape.astype(np.uint8) * 7)
    monkeypatch.setattr("decomo_runtime.tracker.Tracker", lambda _: TrueTracker())
    given = ["--from", f"{tmp_path}/0.png@0", "--from", f"{tmp_path}/5.png@5", "--clip", str(clip)]
    assert main(["sliding.onnx", *given, "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "1 object of 2 annotated frames in 8 frames of sliding, 0 gaps" in out
    assert "7: annotations of frames 0 and 5 disagree the most in frame" in out
    masks = sorted((tmp_path / "out").glob("*.png"))
    assert len(masks) == FRAMES
    assert np.unique(cv2.imread(str(masks[3]), cv2.IMREAD_UNCHANGED)).tolist() == [0, 7]
    lines = (tmp_path / "out" / "report.csv").read_text().splitlines()
    assert lines[0] == "frame,object,name,kind,state,confidence,in_sight,disagreement,between"
    assert lines[1].startswith("0,7,7,mask,drawn,1.0000,1.0000,")
    assert lines[2].startswith("1,7,7,mask,carried,")


def test_bad_input_leaves_nothing(tmp_path: Path, model_path: Path, capsys: Any):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((40, 48), 3, np.uint8))
    assert main([str(model_path), "--from", f"{tmp_path}/a.png@6", "--out", str(tmp_path / "out")]) == 2
    assert "is of frame 6 but the clip has frames 0 to 5" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_clips_of_several_windows(tmp_path: Path):
    windows = split(10, [], 6)
    for window in windows:
        write_tiny_model(tmp_path / "models" / f"{window.name}.onnx", num_frames=len(window), height=30, width=44)
    Windows("walk", 10, 30, 44, 25.0, windows).save(tmp_path / "models" / FILE_NAME)
    shapes = [{"label": "nose", "points": [[10.5, 20.5]], "shape_type": "point"}]
    shapes.append({"label": "body", "points": [[5, 15], [20, 15], [20, 25]], "shape_type": "polygon"})
    path = save(tmp_path / "a.json", labelme(shapes=shapes, imageHeight=30, imageWidth=44))
    assert main([str(tmp_path / "models"), "--from", f"{path}@0", "--out", str(tmp_path / "out")]) == 0
    files = sorted((tmp_path / "out").glob("*.json"))
    assert len(files) == 10
    found = {entry["label"]: entry for entry in json.loads(files[9].read_text())["shapes"]}
    asked = Tracker(tmp_path / "models").track([(0, 10, 20)], [9])
    np.testing.assert_allclose(found["nose"]["points"], asked.xy[0] + 0.5, atol=0.01)
    assert len((tmp_path / "out" / "report.csv").read_text().splitlines()) == 1 + 2 * 10


def test_python_does_what_the_command_does(tmp_path: Path):
    path = save(tmp_path / "labelme.json", labelme())
    report = propagate_files(TrueTracker(), [(path, 0)], tmp_path / "out")  # type: ignore[arg-type]
    assert len(report.findings) == 3 * FRAMES
    top = json.loads((tmp_path / "out" / "00002.json").read_text())
    square, box, point = top["shapes"]
    assert (square["label"], square["flags"], box["group_id"]) == ("square", {"good": True}, 2)
    assert point["points"] == [[9.5, 12.5]]
    assert 0 < square["score"] <= 1
