"""Drawing on the page: in Chromium, with a model whose every answer can be worked out by hand."""

from __future__ import annotations

import json
import os
import re
import shlex
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import av
import cv2
import numpy as np
import pytest

from decomo_runtime import Edit, Tracker, Tracks, draw_edits, propagate_files
from decomo_runtime.options import STATIC
from decomo_runtime.render_cli import main as render_main
from tiny_model import VELOCITY, write_tiny_model

pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
from playwright.sync_api import expect

from view_page import HOLD_READING, ViewPage, opened, write_grey_clip

if TYPE_CHECKING:
    from playwright.sync_api import Browser

NUM_FRAMES, HEIGHT, WIDTH = 8, 36, 52
GREY = 90
RED, BLUE = (255, 0, 0), (0, 0, 255)

pytestmark = pytest.mark.slow


def moved(x: float, y: float, frames: int) -> tuple[float, float]:
    """Where the model says that the point is so many frames later."""
    return x + frames * VELOCITY[0], y + frames * VELOCITY[1]


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What is drawn fades from the third frame before or after on, and is hidden from the sixth on."""
    path = tmp_path_factory.mktemp("model") / "slide.onnx"
    return write_tiny_model(path, num_frames=NUM_FRAMES, height=HEIGHT, width=WIDTH, clip_name="slide")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_grey_clip(tmp_path_factory.mktemp("clips"), HEIGHT, WIDTH, [GREY] * NUM_FRAMES)


@pytest.fixture(scope="module")
def shared_view(chromium: Browser, model: Path, clip: Path, tmp_path_factory: pytest.TempPathFactory):
    with opened(chromium, tmp_path_factory.mktemp("site"), model, clip) as view:
        yield view


@pytest.fixture
def view(shared_view: ViewPage) -> ViewPage:
    """The page as it is when opened, with the clip."""
    shared_view.page.reload()
    shared_view.wait_until_open()
    expect_colour(shared_view, 2, 2, (GREY,) * 3)
    return shared_view


def choose(view: ViewPage, tool: str, colour: tuple[int, int, int] | None = None, size: int | None = None) -> None:
    view.page.locator(f"#tools input[value={tool}]").check(force=True)
    if colour is not None:
        view.page.locator("#draw-colour").fill("#{:02x}{:02x}{:02x}".format(*colour))
    if size is not None:
        view.page.locator("#draw-size").fill(str(size))


def press(view: ViewPage, x: float, y: float) -> None:
    """Clicks there with a drawing tool."""
    view.wait_until_drawn()
    across, down = view.on_stage(x, y)
    view.stage.click(position={"x": across, "y": down})


def expect_colour(view: ViewPage, x: float, y: float, colour: tuple[float, ...], apart: int = 20) -> None:
    """At a place of the clip, once the model has answered."""
    view.expect_colour(x, y, colour, apart=apart)


def layers(view: ViewPage):
    return view.page.locator("#drawings li")


def in_zip(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def decoded(content: bytes) -> np.ndarray:
    """As OpenCV has it."""
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    return picture


def rgba(content: bytes) -> np.ndarray:
    return decoded(content)[..., [2, 1, 0, 3]]


def pictures(folder: Path) -> list[np.ndarray]:
    return [decoded(path.read_bytes()) for path in sorted(folder.glob("*.png"))]


def test_a_stroke_moves_with_what_it_is_drawn_on_and_is_hidden_where_that_is(view: ViewPage):
    view.seek(1)
    choose(view, "brush", RED, 6)
    view.drag((8, 20), (30, 20))
    expect(layers(view)).to_have_count(1)
    expect(view.rows).to_have_count(0)
    expect_colour(view, 20, 20, RED)
    for frame in (2, 3, 4):
        view.seek(frame)
        for x in (10, 20, 29):
            expect_colour(view, *moved(x, 20, frame - 1), RED)
        for x, y in ((20, 14), (20, 26), (3, 20)):
            expect_colour(view, *moved(x, y, frame - 1), (GREY,) * 3)
    view.seek(7)  # hidden: six frames away
    expect_colour(view, *moved(20, 20, 6), (GREY,) * 3)


def test_tools_and_undo(view: ViewPage):
    choose(view, "box", RED)
    view.drag((10, 8), (40, 28))
    expect_colour(view, 25, 18, RED)
    choose(view, "eraser", size=6)
    view.drag((10, 18), (40, 18))
    expect_colour(view, 25, 18, (GREY,) * 3)
    expect_colour(view, 25, 25, RED)
    choose(view, "polygon", BLUE)
    for place in ((12, 9), (38, 9), (38, 14), (12, 14)):
        press(view, *place)
    press(view, 12, 9)
    expect_colour(view, 25, 12, BLUE)
    choose(view, "text", BLUE, 12)
    view.page.locator("#draw-text").fill("HHH")
    press(view, 25, 25)
    expect(layers(view)).to_have_count(1)
    view.seek(2)
    expect_colour(view, *moved(25, 12, 2), BLUE)
    view.seek(0)
    for place, colour in (((25, 25), RED), ((25, 12), RED), ((25, 18), RED)):
        view.page.locator("#undo").click()
        expect_colour(view, *place, colour)
    view.page.locator("#undo").click()
    expect(layers(view)).to_have_count(0)
    expect_colour(view, 25, 25, (GREY,) * 3)
    view.page.keyboard.press("Control+Shift+z")
    expect_colour(view, 25, 25, RED)


def test_layers_are_shown_ordered_named_and_deleted(view: ViewPage):
    choose(view, "box", RED)
    view.drag((5, 5), (30, 25))
    view.page.locator("#new-layer").click()
    choose(view, "box", BLUE)
    view.drag((15, 10), (45, 30))
    expect(layers(view)).to_have_count(2)
    expect_colour(view, 20, 15, BLUE)
    layers(view).nth(1).get_by_title("Up").click()
    expect_colour(view, 20, 15, RED)
    layers(view).nth(0).get_by_title("Shown").uncheck()
    expect_colour(view, 20, 15, BLUE)
    expect_colour(view, 7, 7, (GREY,) * 3)
    name = layers(view).nth(0).locator("input[type=text]")
    name.fill("a sign")
    name.press("Enter")
    view.page.locator("#undo").click()
    expect(layers(view).nth(0).locator("input[type=text]")).to_have_value("Layer 1")
    layers(view).nth(1).get_by_title("Delete").click()
    expect(layers(view)).to_have_count(1)
    expect_colour(view, 40, 28, (GREY,) * 3)
    view.drag((15, 10), (45, 30))
    expect_colour(view, 40, 28, BLUE)


def test_what_is_of_the_objects_is_only_on_them(view: ViewPage):
    """The model says that 1 - t / 8 of each pixel of frame t moves: all, half and none is an object's in 2, 4 and 6."""
    half = tuple(0.5 * (np.array(RED) + GREY))
    view.seek(4)
    choose(view, "box", RED)
    view.page.locator("#draw-on").select_option("dynamic")
    view.drag((10, 8), (40, 28))
    for owner, colours in (("dynamic", (RED, half, (GREY,) * 3)), ("static", ((GREY,) * 3, half, RED))):
        layers(view).get_by_label("Layer 1 is on").select_option(owner)
        for frame, colour in zip((2, 4, 6), colours, strict=True):
            view.seek(frame)
            expect_colour(view, *moved(25, 18, frame - 4), colour)


OBJECT_SIDE = 20
BEHIND = {
    "displacement = Mul(elapsed_xy, velocity)": f"""
    two = Constant <value = int64[1] {{2}}> ()
    side = Constant <value = float {{{OBJECT_SIDE}.0}}> ()
    x = Slice(queries, middle, two, middle)
    on_object = Less(x, side)
    on_scene = Not(on_object)
    scene = Cast<to = 1>(on_scene)
    scene_xy = Unsqueeze(scene, last)
    if_scene = Mul(elapsed_xy, velocity)
    displacement = Mul(if_scene, scene_xy)""",
    "occlusion = Div(distance, num_frames)": """
    target_x = Slice(tracks, first, middle, two)
    target = Squeeze(target_x, last)
    behind = Less(target, side)
    hidden = And(behind, on_scene)
    occlusion = Cast<to = 1>(hidden)""",
    "static_confidence = Div(time, num_frames)": "static_confidence = Squeeze(scene, last)",
}
"""Of the tiny model: an object stands still left of x = 20, and the scene moves by behind it."""


def test_what_is_on_the_scene_goes_on_behind_objects_as_the_command_has_it(
    chromium: Browser, clip: Path, tmp_path: Path
):
    path = tmp_path / "slide.onnx"
    model = write_tiny_model(path, num_frames=NUM_FRAMES, height=HEIGHT, width=WIDTH, clip_name="slide", rename=BEHIND)
    box, later = ((8, 8), (32, 28)), 6
    with opened(chromium, tmp_path / "site", model, clip) as view:
        view.seek(1)
        choose(view, "box", RED)
        view.page.locator("#draw-on").select_option("static")
        view.drag(*box)
        for frame in (1, 1 + later):
            view.seek(frame)
            expect_colour(view, 30, 18, RED)
            expect_colour(view, 14, 18, (GREY,) * 3)  # the object is in front
        expect_colour(view, OBJECT_SIDE + 3, 18, RED)  # when it was drawn, the object stood before it
        expect_colour(view, *moved(34, 18, later), (GREY,) * 3)
        zipped = in_zip(view.save("drawings.zip", tmp_path))
    edit = next(Edit(rgba(content), 1, STATIC) for name, content in zipped.items() if name.startswith("edits/"))
    tracker, blank = Tracker(model, threads=1), np.zeros((NUM_FRAMES, HEIGHT, WIDTH, 3), np.uint8)
    for frame, of_command in enumerate(draw_edits(tracker, blank, [edit], range(NUM_FRAMES), alone=True)):
        here, there = (picture[..., 3] > 127 for picture in (rgba(zipped[f"frames/{frame:05d}.png"]), of_command))
        assert (here & there).sum() / (here | there).sum() > 0.85, frame


def test_saved_layers_are_opened_again_and_drawn_by_decomo_render(
    view: ViewPage, model: Path, clip: Path, tmp_path: Path
):
    view.seek(2)
    choose(view, "box", RED)
    view.drag((10, 8), (30, 28))
    zipped = in_zip(view.save("drawings.zip", tmp_path))
    frames = [rgba(zipped[f"frames/{frame:05d}.png"]) for frame in range(NUM_FRAMES)]
    assert {frame.shape for frame in frames} == {(HEIGHT, WIDTH, 4)}
    for frame in (0, 2, 4):
        x, y = (round(each) for each in moved(20, 18, frame - 2))
        assert frames[frame][y, x].tolist() == [*RED, 255]
        assert frames[frame][33, 45, 3] == 0
    (edit,) = (name for name in zipped if name.startswith("edits/"))
    (tmp_path / "edits").mkdir()
    (tmp_path / edit).write_bytes(zipped[edit])
    command = zipped["README.txt"].decode().split("decomo-render ")[1].splitlines()[0]
    named = {"MODEL": model, "CLIP": clip, "edited.mp4": tmp_path / "out", f"{edit}@2": tmp_path / f"{edit}@2"}
    args = [str(named.get(each, each)) for each in shlex.split(command)]
    assert render_main(args) == 0
    drawn = pictures(tmp_path / "out")
    for frame in (0, 2, 4):
        red = np.abs(drawn[frame][..., ::-1].astype(int) - RED).max(axis=2) < 60
        here = frames[frame][..., 3] > 127
        assert (red & here).sum() / (red | here).sum() > 0.9
    project = view.save("project.json", tmp_path)
    layers(view).get_by_title("Delete").click()
    expect(layers(view)).to_have_count(0)
    view.open(project)
    expect(layers(view)).to_have_count(1)
    expect_colour(view, 20, 18, RED)
    view.seek(4)
    expect_colour(view, *moved(20, 18, 2), RED)


def test_video_with_alpha(view: ViewPage, tmp_path: Path):
    choose(view, "box", RED)
    view.drag((10, 8), (30, 28))
    path = view.save("drawings", tmp_path)
    assert path.suffix == ".webm"
    with av.open(str(path)) as video:
        stream = video.streams.video[0]
        assert stream.metadata.get("alpha_mode", stream.metadata.get("ALPHA_MODE")) == "1"
        decoder = av.CodecContext.create("libvpx", "r")
        frames = [frame for packet in video.demux(stream) if packet.size for frame in decoder.decode(packet)]
    assert len(frames) >= NUM_FRAMES - 1
    first = frames[0].to_ndarray(format="rgba")
    across, down = first.shape[1] / WIDTH, first.shape[0] / HEIGHT
    inside, outside = (first[int((y + 0.5) * down), int((x + 0.5) * across)] for x, y in ((20, 18), (45, 33)))
    assert inside[3] > 240
    assert np.abs(inside[:3].astype(int) - RED).max() < 40
    assert outside[3] < 15


def test_a_mask_is_followed_corrected_and_taken_by_decomo_propagate(view: ViewPage, model: Path, tmp_path: Path):
    view.seek(1)
    view.page.locator("#new-mask").click()
    choose(view, "box")
    view.drag((9.5, 7.5), (29.5, 27.5))
    for field in ("#draw-colour-field", "#draw-on-field"):  # a mask has its own colour
        expect(view.page.locator(field)).to_be_hidden()
    view.seek(4)
    colour = view.page.locator("#drawings input[type=color]").input_value()
    tinted = tuple(0.55 * int(colour[at : at + 2], 16) + 0.45 * GREY for at in (1, 3, 5))
    expect_colour(view, *moved(20, 18, 3), tinted)
    view.wait_until_answered()  # whose the pixels are, too, before a mask is gone on with
    choose(view, "box")
    view.drag((33.5, 20.5), (43.5, 30.5))
    expect_colour(view, *moved(20, 18, 3), tinted)  # goes on from how it was carried
    expect_colour(view, 40, 28, tinted)
    expect(layers(view).locator(".go")).to_have_count(2)
    zipped = in_zip(view.save("masks.zip", tmp_path))
    command = zipped.pop("README.txt").decode()
    assert re.findall(r"--from (\S+)", command) == ["00001.png@1", "00004.png@4"]
    labels = {}
    for name, content in zipped.items():
        (tmp_path / name).write_bytes(content)
        labels[name] = decoded(content)
    expected = np.zeros((HEIGHT, WIDTH), np.uint8)
    expected[8:28, 10:30] = 1
    np.testing.assert_array_equal(labels["00001.png"], expected)
    assert labels["00004.png"][18 - 1, 20 + 4] == labels["00004.png"][28, 40] == 1
    tracker = Tracker(model)
    propagate_files(tracker, [(tmp_path / "00001.png", 1)], tmp_path / "carried")
    carried = pictures(tmp_path / "carried")
    np.testing.assert_array_equal(carried[1], expected)
    view.page.locator("#undo").click()
    for frame in (0, 2, 3):
        view.seek(frame)
        expect_colour(view, *moved(20, 18, frame - 1), tinted)
        view.wait_until_answered()
        shown = np.abs(view.pixels() * 1.0 - tinted).max(axis=2) < 30
        shown = cv2.resize(shown.astype(np.uint8), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) > 0
        assert (shown & (carried[frame] > 0)).sum() / (shown | (carried[frame] > 0)).sum() > 0.85


def test_a_mask_is_loaded_with_the_numbers_of_its_objects(view: ViewPage, tmp_path: Path):
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[4:14, 6:20], labels[20:30, 30:44] = 3, 7
    cv2.imwrite(str(tmp_path / "mask.png"), labels)
    cv2.imwrite(str(tmp_path / "small.png"), labels[1:])
    view.seek(2)
    view.page.locator("#mask-file").set_input_files(str(tmp_path / "small.png"))
    view.expect_alert(f"small.png is {WIDTH}x{HEIGHT - 1} but the clip is {WIDTH}x{HEIGHT}")
    view.page.locator("#mask-file").set_input_files(str(tmp_path / "mask.png"))
    expect(layers(view)).to_have_count(2)
    zipped = in_zip(view.save("masks.zip", tmp_path))
    np.testing.assert_array_equal(decoded(zipped["00002.png"]), labels)


def test_a_mask_is_loaded_over_the_frame_that_its_name_tells(view: ViewPage, tmp_path: Path):
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[4:14, 6:20] = 1
    _, content = cv2.imencode(".png", labels)
    dialog, frames = view.page.locator("#mask-frame"), layers(view).locator(".go")

    def load(name: str) -> None:
        (tmp_path / name).write_bytes(content.tobytes())
        with view.page.expect_file_chooser() as chooser:
            view.page.locator("#load-mask").click()
        chooser.value.set_files(str(tmp_path / name))

    def undo() -> None:
        view.page.locator("#undo").click()
        expect(layers(view)).to_have_count(0)

    view.seek(2)
    load(f"cat@{NUM_FRAMES}.png")
    view.expect_alert(f"cat@{NUM_FRAMES}.png is of frame {NUM_FRAMES}, as its name says, but the clip has")
    load("cat@5.png")
    expect(frames).to_have_text("frame 5")
    view.expect_frame(5)
    expect(view.page.locator("#status")).to_have_text("cat@5.png: a mask over frame 5.")
    undo()
    load("00005.png")  # the frame shown
    expect(frames).to_have_text("frame 5")
    undo()
    for answer, frame in (("Frame 3, by its name", 3), ("Frame 5, shown now", 5)):
        view.seek(5)
        load("00003.png")
        dialog.get_by_text(answer).click()
        expect(frames).to_have_text(f"frame {frame}")
        view.expect_frame(frame)
        undo()
    load("cat@5.png")
    expect(frames).to_have_text("frame 5")  # a file that is written anew while it is read cannot be read
    load("cat@5.png")
    expect(view.page.locator("#status")).to_contain_text("in place of what was drawn there of Object 1; Undo")
    view.page.locator("#undo").click()
    expect(frames).to_have_text("frame 5")
    undo()
    load("00003.png")
    expect(dialog).to_be_visible()
    view.page.keyboard.press("Escape")
    expect(dialog).to_be_hidden()
    expect(layers(view)).to_have_count(0)
    view.page.locator("#play").click()
    load("mask.png")  # the picture stands still meanwhile
    expect(view.page.locator("#play")).to_have_attribute("aria-pressed", "false")
    shown = view.page.locator("#scrub").input_value()
    expect(frames).to_have_text(f"frame {shown}")


def test_masks_are_put_in_the_order_in_which_they_were_chosen_over_the_frame_that_was_shown(
    view: ViewPage, tmp_path: Path
):
    """However long each is read; what is done meanwhile stays, and Undo takes back what is on its way."""
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    for name in ("first.png", "second.png"):
        labels[4:14, 6:20] = 1
        cv2.imwrite(str(tmp_path / name), labels)
        labels = np.roll(labels, 10, axis=1)
    file, undo = view.page.locator("#mask-file"), view.page.locator("#undo")
    view.page.evaluate(HOLD_READING, "first.png")
    view.seek(2)
    for name in ("first.png", "second.png"):
        file.set_input_files(str(tmp_path / name))
    view.seek(5)
    view.page.evaluate("goOnReading()")
    expect(view.page.locator("#status")).to_contain_text("second.png: a mask over frame 2, in place of what was drawn")
    expect(layers(view).locator(".go")).to_have_text("frame 2")
    undo.click()
    view.page.evaluate(HOLD_READING, "second.png")
    file.set_input_files(str(tmp_path / "second.png"))
    undo.click()
    view.page.evaluate("goOnReading()")
    view.wait_until_drawn()
    expect(layers(view)).to_have_count(1)
    expect(view.page.locator("#redo")).to_be_enabled()  # the second one, from before
    file.set_input_files(str(tmp_path / "first.png"))
    expect(view.page.locator("#status")).to_contain_text("first.png: a mask over frame 2, in place")


def test_files_that_change_while_they_are_read_are_told_from_damaged_ones(view: ViewPage, tmp_path: Path):
    for name, picker in (("mask.png", "#mask-file"), ("sign.png", "#picture-file"), ("project.json", "#files")):
        (tmp_path / name).write_bytes(b"before")
        os.utime(tmp_path / name, (1, 1))  # browsers compare whole seconds
        view.page.evaluate(HOLD_READING, name)
        view.page.locator(picker).set_input_files(str(tmp_path / name))
        (tmp_path / name).write_bytes(b"and after")
        view.page.evaluate("goOnReading()")
        view.expect_alert(f"{name} cannot be read, or has changed; open it again.")


def test_drawn_by_keyboard_alone(view: ViewPage):
    page, key = view.page, view.page.keyboard.press
    page.locator("#tools input:checked").focus()
    key("ArrowRight")  # the brush
    expect(page.locator("#tools input[value=brush]")).to_be_checked()
    for _ in range(20):
        key("Tab")
        if page.evaluate("document.activeElement.id") == "stage":
            break
    key("Shift+ArrowLeft")
    key("Enter")
    for _ in range(2):
        key("Shift+ArrowRight")
    key("Enter")
    expect(layers(view)).to_have_count(1)
    pink = (255, 51, 85)
    expect_colour(view, WIDTH // 2 - 5, HEIGHT // 2, pink)
    key("Escape")
    view.page.evaluate("document.activeElement.blur()")
    key(".")
    view.expect_frame(1)
    expect_colour(view, *moved(WIDTH // 2 - 5, HEIGHT // 2, 1), pink)
    key("Control+z")
    expect(layers(view)).to_have_count(0)


def test_drawn_on_a_small_screen(chromium: Browser, model: Path, clip: Path, tmp_path: Path):
    size = {"width": 390, "height": 780}
    with opened(chromium, tmp_path / "site", model, clip, viewport=size) as view:
        assert view.page.evaluate("document.documentElement.scrollWidth") <= 390
        choose(view, "brush", RED, 6)
        assert view.page.evaluate("document.documentElement.scrollWidth") <= 390
        view.drag((8, 20), (30, 20))
        view.seek(3)
        expect_colour(view, *moved(20, 20, 3), RED)
        assert view.page.evaluate("document.documentElement.scrollWidth") <= 390


def test_a_picture_is_put_down(view: ViewPage, tmp_path: Path):
    picture = np.zeros((20, 40, 4), np.uint8)
    picture[..., 0] = picture[..., 3] = 255  # blue
    cv2.imwrite(str(tmp_path / "sign.png"), picture)
    (tmp_path / "none.png").write_bytes(b"no picture")
    choose(view, "picture")
    view.page.locator("#picture-file").set_input_files(str(tmp_path / "none.png"))
    view.expect_alert("none.png does not decode as an image")
    view.page.locator("#picture-file").set_input_files(str(tmp_path / "sign.png"))
    expect(view.page.locator("#draw-picture")).to_have_text("sign.png")
    view.drag((10, 8), (30, 18))
    expect_colour(view, 20, 13, BLUE)
    expect_colour(view, 20, 21, (GREY,) * 3)
    project = view.save("project.json", tmp_path)
    view.page.reload()
    view.wait_until_open()
    view.open(project)
    expect_colour(view, 20, 13, BLUE)
    view.seek(2)
    expect_colour(view, *moved(20, 13, 2), BLUE)


def test_damaged_drawings_are_refused(view: ViewPage, tmp_path: Path):
    choose(view, "brush", RED, 6)
    view.drag((8, 20), (30, 20))
    project = json.loads(view.save("project.json", tmp_path).read_text())
    mark = project["drawings"][0]["marks"][0]
    wrong = ({"t": NUM_FRAMES}, {"ink": "url(x)"}, {"path": [[0, None, 1]]}, {"kind": "svg"})
    for damage in (
        *({"kind": "other"}, {"on": "nothing"}, {"colour": "red"}, {"label": -1}, {"marks": 3}),
        *({"marks": [mark | each]} for each in wrong),
    ):
        changed = project | {"drawings": [project["drawings"][0] | damage]}
        (tmp_path / "bad.json").write_text(json.dumps(changed))
        view.open(tmp_path / "bad.json")
        view.expect_alert("bad.json, drawing 0 (counted from 0), is damaged")
        view.page.get_by_label("Dismiss").click()
    expect(layers(view)).to_have_count(1)


def test_a_project_with_drawings_is_converted(view: ViewPage, tmp_path: Path):
    view.click(20, 20)
    choose(view, "brush", RED, 6)
    view.drag((8, 20), (30, 20))
    project = view.save("project.json", tmp_path)
    assert Tracks.load(project).xy.shape == (1, NUM_FRAMES, 2)
