"""The page in Chromium, with a model whose every answer can be worked out by hand."""

from __future__ import annotations

import json
import re
import shutil
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING

import av
import cv2
import numpy as np
import pytest

from decomo_runtime import Tracker, Tracks, contract, convert
from decomo_runtime.cli import main as track_main
from decomo_runtime.convert_cli import main as convert_main
from decomo_runtime.view.cli import main as view_main
from decomo_runtime.view.site import write_site
from decomotion.quality import Figures, Quality
from decomotion.windows import FILE_NAME, Window, Windows
from serving import serving
from tiny_model import VELOCITY, write_tiny_model

pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
from playwright.sync_api import expect

from view_page import HOLD_READING, ViewPage, opened, served, write_grey_clip

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Route

NUM_FRAMES, HEIGHT, WIDTH = 6, 40, 48

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "slide.onnx"
    return write_tiny_model(path, num_frames=NUM_FRAMES, height=HEIGHT, width=WIDTH, clip_name="slide")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frame i has one grey, 40 i."""
    return write_grey_clip(tmp_path_factory.mktemp("clips"), HEIGHT, WIDTH, range(0, 40 * NUM_FRAMES, 40))


@pytest.fixture(scope="module")
def shared_view(chromium: Browser, model: Path, clip: Path, tmp_path_factory: pytest.TempPathFactory):
    with opened(chromium, tmp_path_factory.mktemp("site"), model, clip) as view:
        yield view


@pytest.fixture
def view(shared_view: ViewPage, request: pytest.FixtureRequest) -> ViewPage:
    """The page with the clip, without points, at frame 0."""
    shared_view.begin(request)
    shared_view.clear()
    shared_view.page.keyboard.press("1")
    shared_view.page.locator("#trails").fill("0")
    shared_view.page.locator("#spacing").fill("8")
    shared_view.seek(0)
    return shared_view


def test_click_draws_the_track(view: ViewPage, model: Path, tmp_path: Path):
    view.seek(2)
    view.click(20, 21)
    view.expect_drawn((20, 21))
    (query,) = view.tracks(tmp_path).queries
    track = Tracker(model).track([query])
    for frame in range(NUM_FRAMES):
        view.seek(frame)
        view.expect_drawn(track.xy[0, frame])


def test_click_is_of_the_frame_that_was_shown_at_its_begin(view: ViewPage, tmp_path: Path):
    """Playing goes on while the button is down."""
    mouse, box = view.page.mouse, view.stage.bounding_box()
    assert box is not None
    for begin, end in (((20, 21), (20, 21)), ((8, 9), (40, 35))):
        view.seek(1)
        count = view.rows.count()
        mouse.move(*(box[side] + place for side, place in zip("xy", view.on_stage(*begin), strict=True)))
        mouse.down()
        mouse.move(*(box[side] + place for side, place in zip("xy", view.on_stage(*end), strict=True)))
        view.page.keyboard.press(".")
        mouse.up()
        view.expect_frame(2)
        expect(view.rows).not_to_have_count(count)
    assert set(view.tracks(tmp_path).queries[:, 0]) == {1}


def test_disc_in_sight_and_ring_where_hidden(view: ViewPage):
    view.click(20, 21)
    colour = view.colour_at(20, 21)
    for frame, hidden in ((1, False), (3, False), (4, True), (5, True)):
        view.seek(frame)
        x, y = np.array([20, 21]) + frame * np.array(VELOCITY)
        assert (np.abs(view.colour_at(x, y) - colour).max() > 0.05) == hidden
        view.expect_drawn((x, y))


def test_scrubbing_and_keys_show_the_clip_s_own_frames(view: ViewPage):
    press = view.page.keyboard.press
    view.stage.evaluate("element => document.activeElement.blur()")
    steps = (("ArrowRight", 1), (".", 2), ("End", 5), (",", 4), ("ArrowLeft", 3), ("Home", 0), ("ArrowLeft", 0))
    for key, frame in steps:
        press(key)
        view.expect_frame(frame)
        expect_grey(view, 40 * frame)
    for _ in range(2):
        view.page.keyboard.down(" ")  # and held
    view.page.keyboard.up(" ")
    expect(view.page.locator("#play")).to_have_attribute("aria-pressed", "true")
    expect(view.page.locator("#frame-number")).not_to_have_text("0 / 5")
    press(" ")
    expect(view.page.locator("#play")).to_have_attribute("aria-pressed", "false")


def expect_grey(view: ViewPage, grey: int) -> None:
    """The clip's frame, once it is decoded."""
    view.expect_colour(5, 5, [grey] * 3, apart=3)


def test_ten_points_rename_delete_undo(view: ViewPage, tmp_path: Path):
    for x in range(4, 44, 4):
        view.click(x, 30)
    tracks = view.tracks(tmp_path)
    np.testing.assert_allclose(tracks.queries[:, 1:], [(x, 30) for x in range(4, 44, 4)], atol=0.1)
    name = view.rows.nth(3).locator("input[type=text]")
    name.fill("left eye")
    name.press("Enter")
    expect(name).to_be_focused()
    expect(view.rows.nth(3).locator("input[type=text]")).to_have_value("left eye")
    view.rows.nth(4).get_by_role("button").click()
    expect(view.rows).to_have_count(9)
    for _ in range(2):
        view.page.locator("#undo").click()
    expect(view.rows).to_have_count(10)
    expect(view.rows.nth(3).locator("input[type=text]")).not_to_have_value("left eye")
    view.page.locator("#redo").click()
    expect(view.rows.nth(3).locator("input[type=text]")).to_have_value("left eye")
    described = re.compile("^Point [0-9]+: hidden in frames 4 to 5$")
    expect(view.rows.nth(0).locator(".strip")).to_have_attribute("aria-label", described)
    expect(view.rows.nth(0).locator("small")).to_have_text("4/6")


def test_strip_seeks_and_selects(view: ViewPage):
    view.click(10, 10)
    view.click(30, 30)
    strip = view.rows.nth(0).locator(".strip")
    box = strip.bounding_box()
    assert box is not None
    strip.click(position={"x": 0.75 * box["width"], "y": 3})
    view.expect_frame(4)
    expect(view.rows.nth(0)).to_have_attribute("aria-current", "true")


def test_layers_and_split(view: ViewPage, model: Path):
    look = Tracker(model).sample([(3, 10.0, 8.0)])
    view.seek(3)
    moving = 1 - look.static_confidence[0]
    assert 0.2 < moving < 0.8
    expected = {
        "fused": [look.rgb[0]],
        "static": [look.rgb_static[0]],
        "dynamic": [moving * look.rgb_dynamic[0] + (1 - moving) * chequer for chequer in (0.6, 0.8)],
        "mask": [np.full(3, moving)],
        "depth": [np.full(3, 1 - look.depth[0] / 2)],
    }
    for layer, colours in expected.items():
        view.page.get_by_label(layer.capitalize(), exact=True).check(force=True)
        view.expect_colour(10, 8, *(255 * np.asarray(colour) for colour in colours), apart=5)
    view.page.keyboard.press("1")
    view.page.locator("#split").select_option("mask")
    view.page.locator("#divider").fill("0.5")
    view.expect_colour(40, 8, [127.5] * 3, apart=5)
    view.expect_colour(5, 8, [120] * 3, apart=5)
    view.page.locator("#split").select_option("nothing")
    view.expect_colour(40, 8, [120] * 3, apart=5)


def test_areas_hold_a_grid(view: ViewPage, tmp_path: Path):
    view.page.locator("#spacing").fill("10")
    view.drag((4, 4), (26, 16))
    expect(view.rows).to_have_count(6)
    assert sorted({round(float(x)) for x in view.tracks(tmp_path).queries[:, 1]}) == [5, 15, 25]
    view.page.get_by_label("Lasso").check(force=True)
    view.drag((2, 36), (46, 36), (46, 2))
    expect(view.rows).not_to_have_count(6)
    places = view.tracks(tmp_path).queries[6:, 1:]
    assert len(places) > 2
    assert all(y > 36 - (x - 2) * 34 / 44 - 1 for x, y in places)  # below the diagonal
    view.page.locator("#drag").get_by_label("Box").check(force=True)
    view.page.locator("#spacing").fill("-5")
    view.drag((0, 0), (40, 30))
    view.expect_alert("raise the spacing")


def test_csv_feeds_decomo_track(view: ViewPage, model: Path, tmp_path: Path):
    view.click(12.25, 7)
    view.seek(3)
    view.click(33, 28.5)
    saved = view.save("points.csv", tmp_path)
    out = tmp_path / "tracks.csv"
    assert track_main([str(model), "--queries", str(saved), "--out", str(out)]) == 0
    of_page = np.loadtxt(view.save("tracks.csv", tmp_path), delimiter=",", skiprows=1)
    of_command = np.loadtxt(out, delimiter=",", skiprows=1)
    np.testing.assert_allclose(of_page, of_command, atol=1e-3)


@pytest.mark.parametrize("kind", ["tracks.csv", "tracks.npz", "project.json"])
def test_saved_tracks_say_how_far_off_they_may_be(kind: str, view: ViewPage, model: Path, tmp_path: Path):
    """As the commands say it; `decomo-convert` hands it on."""
    view.click(12.25, 7)
    view.seek(3)
    view.click(33, 28.5)
    saved = view.save(kind, tmp_path)
    of_page = Tracks.load(saved)
    of_command = Tracker(model).track(of_page.queries).error
    assert of_command is not None
    assert of_page.error is not None
    np.testing.assert_allclose(of_page.error, of_command, atol=1e-3)  # files have four decimals
    assert of_command.max() > 1
    assert convert_main([str(saved), str(tmp_path / "converted.npz")]) == 0
    np.testing.assert_array_equal(Tracks.load(tmp_path / "converted.npz").error, of_page.error)


@pytest.mark.parametrize("kind", ["points.csv", "project.json", "tracks.csv", "tracks.npz"])
def test_saved_points_are_opened_again(kind: str, view: ViewPage, tmp_path: Path):
    view.click(12.25, 7)
    view.seek(3)
    view.click(33, 28.5)
    before = view.tracks(tmp_path)
    saved = view.save(kind, tmp_path)
    view.clear()
    view.open(saved)
    expect(view.rows).to_have_count(2)
    after = view.tracks(tmp_path)
    np.testing.assert_array_equal(after.queries, before.queries)
    np.testing.assert_array_equal(after.xy, before.xy)


def test_json_is_that_of_decomo_convert(view: ViewPage, tmp_path: Path):
    """The page's is read with its tracks, and the one that is written is opened by the page."""
    view.click(12.25, 7)
    view.seek(3)
    view.click(33, 28.5)
    before = view.tracks(tmp_path)
    saved = view.save("project.json", tmp_path)
    np.testing.assert_allclose(Tracks.load(saved).xy, before.xy, atol=5.1e-5)  # four decimals
    np.testing.assert_array_equal(Tracks.load(saved).occluded, before.occluded)
    again = tmp_path / "again.json"
    convert(saved, again)
    assert json.loads(again.read_text()) == json.loads(saved.read_text())
    view.clear()
    view.open(again)
    expect(view.rows).to_have_count(2)
    np.testing.assert_array_equal(view.tracks(tmp_path).queries, before.queries)


def test_video_has_every_frame_and_the_points(view: ViewPage, tmp_path: Path):
    """As they were when it was asked for."""
    view.click(20, 21)
    with view.page.expect_download() as download:
        view.page.evaluate("""() => {
            for (const wanted of ["[data-save=video]", "#clear", "input[value=mask]"])
                document.querySelector(wanted).click();
        }""")
    saved = download.value.path()
    with av.open(str(saved)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        assert float(container.streams.video[0].average_rate or 0) == pytest.approx(12.5, rel=0.02)
    assert len(frames) == NUM_FRAMES
    factor = frames[0].shape[1] / WIDTH
    for number, frame in enumerate(frames):
        assert np.median(frame) == pytest.approx(40 * number, abs=8)
        x, y = np.array([20, 21]) + number * np.array(VELOCITY)
        mark = frame[int((y + 0.5) * factor) - 12 :, int((x + 0.5) * factor) - 12 :][:24, :24]
        assert np.ptp(mark.astype(int), axis=-1).max() > 60, "no colour where the point is"


def test_keyboard_alone(view: ViewPage, tmp_path: Path):
    page = view.page
    page.locator("#split").focus()
    page.keyboard.press("Tab")
    expect(view.stage).to_be_focused()
    for key in ("ArrowRight", "ArrowRight", "Shift+ArrowUp", "ArrowDown"):
        page.keyboard.press(key)
    page.keyboard.press("Enter")
    expect(view.rows).to_have_count(1)
    (query,) = view.tracks(tmp_path).queries
    np.testing.assert_array_equal(query, [0, WIDTH // 2 + 2, HEIGHT // 2 - 9])
    view.stage.focus()
    page.keyboard.press("b")
    for _ in range(2):
        page.keyboard.press("Shift+ArrowDown")
        page.keyboard.press("Shift+ArrowRight")
    page.locator("#spacing").evaluate("element => element.value = 5")
    page.keyboard.press("Enter")
    expect(view.rows).not_to_have_count(1)
    page.keyboard.press("Control+z")
    expect(view.rows).to_have_count(1)
    page.keyboard.press("Delete")
    page.keyboard.press("Control+z")
    expect(view.rows).to_have_count(1)
    page.locator("#help").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#keys")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.locator("#keys")).to_be_hidden()


def test_the_cross_keeps_to_the_pixels(view: ViewPage, tmp_path: Path):
    view.page.locator("#split").focus()
    view.page.keyboard.press("Tab")
    for key in [*["Shift+ArrowLeft"] * 3, *["Shift+ArrowDown"] * 3, "Enter"]:
        view.page.keyboard.press(key)
    expect(view.rows).to_have_count(1)
    np.testing.assert_array_equal(view.tracks(tmp_path).queries, [[0, 0, HEIGHT - 1]])


def test_a_folder_of_frames_is_dropped(view: ViewPage, clip: Path, tmp_path: Path):
    folder = shutil.copytree(clip, tmp_path / "frames")
    (folder / ".0.png").touch()
    (folder / "notes.txt").touch()
    (tmp_path / "empty").mkdir()
    view.drop(folder / "notes.txt")
    view.expect_alert("notes.txt is nothing that this page opens")
    view.drop(tmp_path / "empty")
    view.expect_alert("empty holds no images and no windows.json; drop the folder with the frames")
    view.page.locator("#alert button").click()
    view.page.keyboard.press("2")
    view.drop(folder)
    expect(view.page.locator("input[value=clip]")).to_be_checked()
    expect(view.page.locator("#alert")).to_be_hidden()
    view.seek(3)
    expect_grey(view, 120)


def test_foreign_files_get_one_sentence_and_the_page_goes_on(view: ViewPage, clip: Path, tmp_path: Path):
    foreign = write_tiny_model(
        tmp_path / "foreign.onnx", num_frames=3, height=8, width=8, metadata={"decomotion.format_version": None}
    )
    (tmp_path / "text.onnx").write_text("hello")
    (tmp_path / "points.csv").write_text("t,x,y\n0,1,2\n9,1,2\n")
    (tmp_path / "none.csv").write_text("t,x,y\n")
    (tmp_path / "slide.mp4").write_bytes(b"")
    short = sorted(clip.iterdir())[:-1]
    for files, sentence in (
        ([foreign], "foreign.onnx is an ONNX file but holds no decomotion model"),
        ([tmp_path / "text.onnx"], "text.onnx is not an ONNX file"),
        (short, "5 frames of 48x40 but the model was fitted to slide with 6 frames of 48x40; give that clip"),
        ([tmp_path / "slide.mp4"], "slide.mp4 is a video; give its frames as images"),
        ([tmp_path / "points.csv"], "point 1 (counted from 0): t is 9"),
        ([tmp_path / "none.csv"], "none.csv holds no points, and nothing that is drawn"),
        (short[:1], "0.png is one image, and a clip is all its frames; open them at once, or a mask with 'Load mask…'"),
    ):
        view.open(*files)
        view.expect_alert(sentence)
    view.page.locator("#alert button").click()
    view.click(20, 20)


def test_a_frame_that_does_not_come_is_said_and_asked_for_again(
    chromium: Browser, model: Path, clip: Path, tmp_path: Path
):
    with opened(chromium, tmp_path / "site", model, clip) as view:
        view.page.route("**/clip/00003.jpg", lambda route: route.abort())
        view.page.reload()
        view.expect_alert("Frame 3 of the clip cannot be loaded from where the page lies; start 'decomo-view' again.")
        view.page.unroute("**/clip/00003.jpg")

        def comes() -> bool:
            for frame in (2, 3):
                view.seek(frame, is_there=False)
            return view.page.locator("#frame").get_attribute("data-shown") == "3"

        view.wait_for(comes)
        expect_grey(view, 120)
        view.complaints.clear()  # of the browser, that nobody answered


def test_another_model_and_its_clip_are_opened(chromium: Browser, model: Path, clip: Path, tmp_path: Path):
    other = write_tiny_model(tmp_path / "other.onnx", num_frames=4, height=20, width=30, clip_name="other")
    frames = [tmp_path / f"{frame}.png" for frame in (2, 10, 11, 100)]
    for grey, frame in enumerate(frames):
        cv2.imwrite(str(frame), np.full((20, 30, 3), 60 * grey, np.uint8))
    with opened(chromium, tmp_path / "site", model, clip) as view:
        view.click(20, 20)
        view.open(other)
        view.expect_alert("The clip has 6 frames of 48x40 but the model was fitted to other")
        expect(view.page.locator("#facts")).to_contain_text("other · 4 frames of 30")
        expect(view.rows).to_have_count(0)
        view.size = (30, 20)
        view.open(*reversed(frames))
        expect(view.page.locator("input[value=clip]")).to_be_checked()
        view.seek(2)
        expect_grey(view, 120)
        view.click(3, 4)
        np.testing.assert_allclose(view.tracks(tmp_path).queries, [(2, 3, 4)], atol=0.05)


def test_another_model_is_opened_while_an_area_is_tracked(chromium: Browser, model: Path, tmp_path: Path):
    other = write_tiny_model(tmp_path / "other.onnx", num_frames=4, height=20, width=30, clip_name="other")
    with opened(chromium, tmp_path / "site", model) as view:
        view.page.evaluate("""() => {
            const send = Worker.prototype.postMessage;
            Worker.prototype.postMessage = function (request) {
                if (request.kind !== "track" || request.args.queries.length === 3) send.call(this, request);
            };
        }""")  # many points are never answered
        view.drag((4, 4), (40, 30))
        view.open(other)
        expect(view.page.locator("#facts")).to_contain_text("other · 4 frames of 30")
        view.wait_until_open()
        view.size = (30, 20)
        view.click(3, 4)
        expect(view.page.locator("#alert")).to_be_hidden()


def test_nothing_of_a_former_model_comes_into_the_one_that_was_opened_meanwhile(
    chromium: Browser, model: Path, tmp_path: Path
):
    """Neither its points nor its name; and no work is lost that nobody was asked about."""
    other = write_tiny_model(tmp_path / "other.onnx", num_frames=4, height=20, width=30, clip_name="other")
    again = shutil.copy(model, tmp_path / "again.onnx")
    (tmp_path / "points.csv").write_text("t,x,y\n3,20,20\n")
    asked: list[str] = []
    with opened(chromium, tmp_path / "site", model) as view:
        facts, count = view.page.locator("#facts"), view.page.locator("#drawings li")
        view.page.evaluate(HOLD_READING, "points.csv")
        view.open(tmp_path / "points.csv")
        view.page.evaluate(HOLD_READING, "again.onnx")
        view.open(Path(again), tmp_path / "points.csv")  # is read last, and is not wanted any more
        view.open(other)
        expect(facts).to_contain_text("other · 4 frames of 30")
        view.page.evaluate("goOnReading()")
        view.page.on("dialog", lambda dialog: (asked.append(dialog.message), dialog.dismiss()))
        view.page.evaluate(HOLD_READING, "again.onnx")
        view.open(Path(again))
        view.page.locator("#new-mask").click()
        assert asked == []
        view.page.evaluate("goOnReading()")
        view.wait_for(lambda: bool(asked))
        view.wait_until_open()
        expect(facts).to_contain_text("other · 4 frames of 30")
        expect(count).to_have_count(1)
        expect(view.rows).to_have_count(0)
        expect(view.page.locator("#alert")).to_be_hidden()


def test_what_was_set_stays_when_the_trial_of_webgpu_ends_and_when_frames_are_opened(
    chromium: Browser, model: Path, clip: Path, tmp_path: Path
):
    with opened(chromium, tmp_path / "site", model) as view:
        view.page.add_init_script("""
            const requestAdapter = () => new Promise((resolve) => (window.endTrial = () => resolve(null)));
            Object.defineProperty(navigator, "gpu", { value: { requestAdapter } });
        """)
        view.page.reload()
        view.wait_until_open()
        view.page.locator("#spacing").fill("7")
        view.page.locator("#split").focus()
        view.page.keyboard.press("Tab")
        view.wait_until_answered()  # then only the cross could go
        with_cross = view.pixels()
        view.page.evaluate("endTrial()")
        np.testing.assert_array_equal(view.pixels(), with_cross)
        view.open(*clip.iterdir())
        expect(view.page.locator("input[value=clip]")).to_be_checked()
        expect(view.page.locator("#facts")).not_to_contain_text("without its clip")
        expect(view.page.locator("#spacing")).to_have_value("7")


LENGTHS = (14, 12, 9, 11, 13)
VELOCITIES = ((1.5, -0.5), (-0.75, 0.25), (0.5, 0.5), (-1, 0), (0.25, -0.25))


@pytest.fixture(scope="module")
def model_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five windows that move each in its own way, more than the page has open; before the last one is a cut.

    In the first two nothing is hidden; in the others what is far from its own frame.
    """
    folder = tmp_path_factory.mktemp("models") / "walk"
    begins = (0, 10, 18, 24, 35)
    windows = tuple(
        Window(f"window-{number:03d}", begin, begin + length)
        for number, (begin, length) in enumerate(zip(begins, LENGTHS, strict=True))
    )
    for window, (x, y) in zip(windows, VELOCITIES, strict=True):
        write_tiny_model(
            folder / f"{window.name}.onnx",
            num_frames=len(window),
            height=HEIGHT,
            width=WIDTH,
            rename={"{1.5, -0.5}": f"{{{x}, {y}}}"} | ({f"{{{len(window)}}}": "{40}"} if window.begin < 18 else {}),
        )
    qualities = (None, quality(0.5), quality(2.5), None, None)
    Windows("walk", 48, HEIGHT, WIDTH, 12.5, windows, quality=qualities).save(folder / FILE_NAME)
    return folder


def quality(median: float) -> Quality:
    figures = Figures(60, median, 2 * median + 1, 3 * median, 6 * median + 3, 0.5, 0.6, 0.7, 0.1)
    return Quality(900, None, figures, None, None, ())


def test_a_model_folder_answers_as_the_runtime_does(chromium: Browser, model_folder: Path, tmp_path: Path):
    tracker = Tracker(model_folder)
    with opened(chromium, tmp_path / "site", model_folder) as view:
        expect(view.page.locator("#facts")).to_contain_text("40 in 5 windows · preset cpu")
        for number, frame in enumerate((0, 11, 21, 34, 35)):
            view.seek(frame)
            view.click(4 + 9 * number, 30 - 6 * number)
        view.seek(28)
        view.drag((2, 2), (45, 37))
        expect(view.rows).not_to_have_count(5)
        tracks = view.tracks(tmp_path)
        assert len(tracks.queries) > 50
        expected = tracker.track(tracks.queries)
        np.testing.assert_allclose(tracks.xy, expected.xy, atol=1e-2)
        np.testing.assert_allclose(tracks.occlusion, expected.occlusion, atol=1e-4)
        view.clear()
        view.page.get_by_label("Fused", exact=True).check(force=True)
        for frame in (3, 40):
            view.seek(frame)
            colour = tracker.sample([(frame, 10.0, 8.0)]).rgb[0]
            view.expect_colour(10, 8, 255 * colour, apart=5)


def test_a_point_is_shown_while_windows_far_from_it_are_still_to_come(
    chromium: Browser, model_folder: Path, tmp_path: Path
):
    (tmp_path / "clip").mkdir()
    for frame in range(48):
        cv2.imwrite(str(tmp_path / "clip" / f"{frame}.png"), np.full((HEIGHT, WIDTH, 3), 5 * frame, np.uint8))
    with opened(chromium, tmp_path / "site", model_folder, tmp_path / "clip") as view:
        held: list[Route] = []
        third = "**/window-002.onnx"
        view.page.route(third, lambda route: held.append(route))
        view.seek(2)
        view.click(20, 21)
        view.expect_drawn((20, 21))
        expect(view.page.locator("#status")).to_contain_text("Following the point")
        expect(view.page.locator("[data-save='tracks.npz']")).to_be_disabled()
        name = view.rows.nth(0).locator("input[type=text]")
        name.fill("left ey")
        view.wait_for(lambda: bool(held))
        held.pop().continue_()
        tracks = view.tracks(tmp_path)
        expect(name).to_have_value("left ey")
        expected = Tracker(model_folder).track(tracks.queries)
        np.testing.assert_allclose(tracks.xy, expected.xy, atol=1e-2)
        seen = np.count_nonzero(~expected.occluded)
        expect(view.rows.nth(0).locator("small")).to_have_text(f"{seen}/48")
        view.page.unroute(third)
        view.page.route(third, lambda route: route.abort())
        view.seek(3)
        view.stage.click(position={"x": 5, "y": 5})
        view.expect_alert("model/window-002.onnx cannot be loaded from where the page lies")
        expect(view.rows).to_have_count(1)
        view.complaints.clear()  # of the browser, that it was not loaded


def test_the_page_says_how_good_the_worst_window_is(chromium: Browser, model_folder: Path, tmp_path: Path):
    worst = Tracker(model_folder).quality
    assert worst is not None
    with opened(chromium, tmp_path / "site", model_folder) as view:
        said, line = view.page.locator("#quality p"), view.page.locator("#quality summary")
        expect(line).to_have_text("The fit falls short of its links.")
        expect(said).to_be_hidden()
        line.click()
        expect(said).to_contain_text(f"In the worst window, {worst.summary()}. The fit falls short of its links")
        expect(said).to_contain_text("; fit for longer with decomo-train --resume.")
        alone = write_tiny_model(
            tmp_path / "alone.onnx",
            num_frames=3,
            height=8,
            width=10,
            metadata={contract.META_QUALITY: quality(0.5).as_json()},
        )
        view.open(alone)
        expect(said).to_have_text(f"H{quality(0.5).summary()[1:]}.")
        expect(line).to_have_text("How good the fit is")
        view.open(write_tiny_model(tmp_path / "mute.onnx", num_frames=3, height=8, width=10))
        expect(said).to_be_hidden()


def test_a_model_folder_is_dropped_or_its_files_are_opened(
    chromium: Browser, model: Path, model_folder: Path, tmp_path: Path
):
    expected = Tracker(model_folder).track([[28, 20, 21]])
    files = sorted(model_folder.iterdir())
    assert files[-1].name == FILE_NAME
    broken = shutil.copytree(model_folder, tmp_path / "broken")
    (broken / FILE_NAME).write_text("{}")
    with opened(chromium, tmp_path / "site", model) as view:
        for given, sentence in (
            (files[:-1], "These are 5 models without their windows.json; give one, or a whole model folder."),
            (files[2:], "window-000.onnx, window-001.onnx is missing beside windows.json; open the whole folder"),
            ([broken / FILE_NAME], "windows.json does not tell where the clip's windows are, or is damaged"),
        ):
            view.open(*given)
            view.expect_alert(sentence)
        for give in (lambda: view.drop(model_folder), lambda: view.open(*files)):
            view.open(model)
            expect(view.page.locator("#facts")).to_contain_text("slide · 6 frames")
            give()
            expect(view.page.locator("#facts")).to_contain_text("walk · 48 frames")
            expect(view.page.locator("#alert")).to_be_hidden()
            view.wait_until_open()
            view.seek(28)
            view.click(20, 21)
            xy = view.tracks(tmp_path).xy
            np.testing.assert_allclose(xy, expected.xy, atol=0.05)  # a click is kept to a hundredth of a pixel


def test_page_without_a_clip_on_a_plain_host(chromium: Browser, model: Path, tmp_path: Path):
    """`--export` in a subfolder of a host that sends no header of ours, as a phone sees it."""
    assert view_main([str(model), "--export", str(tmp_path / "web" / "sub")]) == 0
    handler = partial(QuietHandler, directory=str(tmp_path / "web"))
    with (
        serving(ThreadingHTTPServer(("127.0.0.1", 0), handler)) as port,
        chromium.new_context(viewport={"width": 390, "height": 844}, color_scheme="dark", has_touch=True) as context,
    ):
        view = ViewPage(context.new_page(), WIDTH, HEIGHT)
        view.page.goto(f"http://127.0.0.1:{port}/sub/")
        view.wait_until_open()
        expect(view.page.locator("#facts")).to_contain_text("without its clip")
        assert not view.page.evaluate("crossOriginIsolated")
        for number, x in enumerate((4, 14, 24, 34, 44), start=1):
            across, down = view.on_stage(x, 10)
            view.stage.tap(position={"x": across, "y": down})
            expect(view.rows).to_have_count(number)
        looks = view.page.locator("#looks summary")
        expect(looks).to_have_text("Picture: fused")
        assert view.page.locator("#tools").bounding_box()["height"] < 60, "the tools are more than a row"
        expect(view.page.locator("#layers")).to_be_hidden()
        looks.press("Enter")
        view.page.locator("#layers").get_by_label("Static").check(force=True)
        view.page.locator("#split").select_option("mask")
        expect(looks).to_have_text("Picture: static and mask")
        looks.tap()
        assert view.page.evaluate("scrollY") == 0, "the list has scrolled the picture away"
        wide = view.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wide <= 0, "the page scrolls sideways on a phone"
        assert view.complaints == []


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


def test_old_browser_is_told_what_it_lacks(chromium: Browser, model: Path, tmp_path: Path):
    (tmp_path / "site").mkdir()
    write_site(tmp_path / "site", model, None)
    with served(tmp_path / "site") as address, chromium.new_context() as context:
        page = context.new_page()
        page.add_init_script("delete window.WebAssembly")
        page.goto(address)
        expect(page.locator("#alert p")).to_have_text(
            "This browser has no WebAssembly, which the page needs; use a current Chrome, Edge, Firefox or Safari."
        )


def test_tracks_of_the_page_are_those_of_the_runtime(view: ViewPage, model: Path, tmp_path: Path):
    view.drag((2, 2), (45, 37))
    expect(view.rows).to_have_count(6 * 5)
    tracks = view.tracks(tmp_path)
    expected: Tracks = Tracker(model).track(tracks.queries)
    np.testing.assert_allclose(tracks.xy, expected.xy, atol=1e-3)
    np.testing.assert_allclose(tracks.occlusion, expected.occlusion, atol=1e-5)
    np.testing.assert_array_equal(tracks.occluded, expected.occluded)
