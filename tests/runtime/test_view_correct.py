"""The page where tracks are put right and the model is refitted: in Chromium, with stand-ins for the fit."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from decomo_runtime import Tracker, Tracks
from refitting import Bench, lives, wait_until
from tiny_model import VELOCITY, write_tiny_model

pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
from playwright.sync_api import expect

from view_page import HOLD_ASKING, ViewPage, opened, write_grey_clip

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Dialog

NUM_FRAMES, HEIGHT, WIDTH = 7, 36, 52
SIZE = {"num_frames": NUM_FRAMES, "height": HEIGHT, "width": WIDTH}

pytestmark = pytest.mark.slow


def answer(x: float, y: float, frames: int) -> tuple[float, float]:
    """Where the model says that the point is so many frames later."""
    return x + frames * VELOCITY[0], y + frames * VELOCITY[1]


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_model(tmp_path_factory.mktemp("model") / "slide.onnx", **SIZE, clip_name="slide")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_grey_clip(tmp_path_factory.mktemp("clips"), HEIGHT, WIDTH, range(0, 30 * NUM_FRAMES, 30))


@pytest.fixture(scope="module")
def shared_view(chromium: Browser, model: Path, clip: Path, tmp_path_factory: pytest.TempPathFactory):
    with opened(chromium, tmp_path_factory.mktemp("site"), model, clip) as view:
        yield view


@pytest.fixture
def view(shared_view: ViewPage, request: pytest.FixtureRequest) -> ViewPage:
    """The page with the clip, without points, at frame 0."""
    shared_view.begin(request)
    shared_view.clear()
    shared_view.page.locator("#trails").fill("0")
    shared_view.seek(0)
    return shared_view


def corrections(view: ViewPage, folder: Path) -> list[list[float | None]]:
    """The rows of the corrections.csv that the page saves."""
    text = view.save("corrections.csv", folder).read_text()
    header, *rows = csv.reader(text.splitlines())
    assert header == ["t", "x", "y", "target_t", "target_x", "target_y"]
    return [[float(cell) if cell else None for cell in row] for row in rows]


def described(states: str) -> re.Pattern[str]:
    """What a strip says of a point with any name."""
    return re.compile(f"^Point [0-9]+: {states}$")


def test_a_dragged_point_bends_its_track(view: ViewPage, tmp_path: Path):
    expect(view.page.locator("#refit")).to_be_hidden()  # without --run
    view.seek(1)
    view.click(12, 20)
    view.click(40, 8)
    view.seek(5)
    expect(view.page.locator("#no-refit")).to_be_hidden()
    view.move(answer(12, 20, 4), (20, 25))
    expect(view.page.locator("#no-refit")).to_contain_text("start decomo-view with --clip and --run")
    view.expect_drawn((20, 25))
    (row,) = corrections(view, tmp_path)
    np.testing.assert_allclose(row, (1, 12, 20, 5, 20, 25), atol=0.1)
    tracks = view.tracks(tmp_path)
    own = np.array([answer(*tracks.queries[0, 1:], frame - 1) for frame in range(NUM_FRAMES)])
    offset = np.array(row[4:], float) - own[5]
    expected = own + np.outer([0, 0, 0.25, 0.5, 0.75, 1, 1], offset)
    np.testing.assert_allclose(tracks.xy[0], expected, atol=1e-3)
    np.testing.assert_allclose(
        tracks.xy[1], [answer(*tracks.queries[1, 1:], frame - 1) for frame in range(7)], atol=1e-3
    )
    strips = view.rows.locator(".strip")
    expect(strips.nth(0)).to_have_attribute("aria-label", described("in sight in every frame, given in frame 5"))
    expect(strips.nth(1)).to_have_attribute("aria-label", described("hidden in frames 5 to 6"))


def test_each_correction_is_undone_and_the_last_one_of_a_frame_counts(view: ViewPage, tmp_path: Path):
    view.click(12, 20)
    view.seek(2)
    view.move(answer(12, 20, 2), (30, 30))
    view.drag((30, 30), (35, 10))
    view.expect_drawn((35, 10))
    expect(view.page.locator("#correction-count")).to_have_text("1")
    for place in ((30, 30), answer(12, 20, 2)):
        view.page.keyboard.press("Control+z")
        view.expect_drawn(place)
    expect(view.rows).to_have_count(1)
    view.page.locator("#redo").click()
    view.expect_drawn((30, 30))
    view.page.get_by_role("button", name="Delete the correction of").click()
    view.expect_drawn(answer(12, 20, 2))
    view.page.locator("#undo").click()
    view.page.get_by_label("Clear the corrections").click()
    expect(view.page.locator("#corrections li")).to_have_count(0)


def test_what_the_model_is_still_asked_for_is_taken_back_and_saved(
    chromium: Browser, model: Path, clip: Path, tmp_path: Path
):
    """By Undo, which leaves alone what was there before; who saves too soon saves all the same."""
    with opened(chromium, tmp_path / "site", model, clip) as view:
        view.click(12, 20)
        view.seek(2)
        view.move(answer(12, 20, 2), (20, 30))
        across, down = view.on_stage(40, 8)
        view.page.evaluate(HOLD_ASKING)
        view.stage.click(position={"x": across, "y": down})
        view.page.locator("#undo").click()
        view.page.evaluate("goOnAsking()")
        view.wait_until_answered()
        expect(view.rows).to_have_count(1)
        expect(view.page.locator("#corrections li")).to_have_count(1)
        view.page.evaluate(HOLD_ASKING)
        view.stage.click(position={"x": across, "y": down})
        with view.page.expect_download() as download:
            view.page.locator("[data-save='tracks.npz']").click()
            view.page.evaluate("goOnAsking()")
        download.value.save_as(tmp_path / "tracks.npz")
        assert Tracks.load(tmp_path / "tracks.npz").queries[:, 0].tolist() == [0, 2]


def test_a_point_dragged_in_its_own_frame_is_followed_from_there(view: ViewPage, tmp_path: Path):
    view.seek(3)
    view.click(12, 20)
    view.drag((12, 20), (30, 9))
    view.expect_drawn((30, 9))
    expect(view.page.locator("#corrections li")).to_have_count(0)
    expect(view.rows).to_have_count(1)
    tracks = view.tracks(tmp_path)
    np.testing.assert_allclose(tracks.queries, [(3, 30, 9)], atol=0.1)
    np.testing.assert_allclose(tracks.xy[0, 5], answer(*tracks.queries[0, 1:], 2), atol=1e-3)
    view.page.keyboard.press("Control+z")
    view.expect_drawn((12, 20))


def test_a_point_that_has_left_the_picture_is_placed_with_a_click(view: ViewPage, tmp_path: Path):
    view.click(48, 20)
    view.seek(5)  # at x = 55.5
    view.page.locator("#place").click()
    expect(view.page.locator("#status")).to_contain_text("Click where the point belongs in this frame")
    across, down = view.on_stage(30, 10)
    view.stage.click(position={"x": across, "y": down})
    ((_, _, _, *target),) = corrections(view, tmp_path)
    np.testing.assert_allclose(np.array(target, float), (5, 30, 10), atol=0.1)
    expect(view.page.locator("#status")).to_contain_text(" is at (30, 10) in frame 5.")
    view.click(12, 30)  # a click is a click again
    view.page.locator("#place").focus()
    for key in ("Enter", "Escape", "Enter"):
        view.page.keyboard.press(key)  # taken hold of, given up: Enter places a new point, where the cross is
    expect(view.rows).to_have_count(3)
    expect(view.page.locator("#corrections li")).to_have_count(1)
    view.page.locator("#place").click()
    view.page.keyboard.press("Escape")
    expect(view.page.locator("#status")).to_be_empty()


def test_hidden_and_in_sight_are_marked(view: ViewPage, tmp_path: Path):
    view.click(12, 20)
    strip = view.rows.nth(0).locator(".strip")
    expect(strip).to_have_attribute("aria-label", described("hidden in frames 4 to 6"))
    view.page.locator("#mark-hidden").click()
    view.expect_alert("was placed in frame 0: it is in sight there. Mark it in another frame.")
    view.seek(2)
    view.page.locator("#mark-hidden").click()
    expect(strip).to_have_attribute("aria-label", described("hidden in frames 2 to 6, given in frame 2"))
    view.seek(5)
    view.page.keyboard.press("h")
    states = "hidden in frames 2 to 4, given in frame 2, given in frame 5"
    expect(strip).to_have_attribute("aria-label", described(states))
    rows = view.page.locator("#corrections li")
    expect(rows.nth(0)).to_contain_text("frame 2: hidden")
    expect(rows.nth(1)).to_contain_text("frame 5: at (")
    assert corrections(view, tmp_path)[0][3:] == [2, None, None]
    np.testing.assert_allclose(corrections(view, tmp_path)[1][3:], (5, *answer(12, 20, 5)), atol=0.1)
    rows.nth(0).get_by_role("button").first.click()
    view.expect_frame(2)


@pytest.mark.parametrize("kind", ["corrections.csv", "project.json"])
def test_saved_corrections_are_opened_again(kind: str, view: ViewPage, tmp_path: Path):
    view.click(12.25, 20)
    view.click(40, 8)
    view.seek(2)
    view.move(answer(12.25, 20, 2), (30, 30))
    view.page.keyboard.press("Home")
    view.seek(4)
    view.page.locator("#mark-seen").click()
    before, rows = view.tracks(tmp_path), corrections(view, tmp_path)
    saved = view.save(kind, tmp_path)
    view.clear()
    expect(view.page.locator("#corrections li")).to_have_count(0)
    view.drop(saved)
    expect(view.page.locator("#corrections li")).to_have_count(2)
    expect(view.rows).to_have_count(1 if kind == "corrections.csv" else 2)
    assert corrections(view, tmp_path) == rows
    after = view.tracks(tmp_path)
    np.testing.assert_array_equal(after.xy, before.xy[: len(after.xy)])
    if kind == "project.json":  # as the commands read it
        np.testing.assert_allclose(Tracks.load(saved).xy, before.xy, atol=5.1e-5)
    view.page.get_by_label("Clear the corrections").click()
    if kind == "corrections.csv":  # those of a point that is there are its own
        view.open(saved)
        expect(view.page.locator("#corrections li")).to_have_count(2)
        expect(view.rows).to_have_count(1)


def test_tracks_are_opened_again_as_points(view: ViewPage, tmp_path: Path):
    view.click(12.25, 20)
    view.seek(3)
    view.click(40, 8)
    before = view.tracks(tmp_path)
    saved = view.save("tracks.csv", tmp_path)
    view.clear()
    view.drop(saved)
    expect(view.rows).to_have_count(2)
    np.testing.assert_array_equal(view.tracks(tmp_path).queries, before.queries)


def test_a_page_with_unsaved_work_asks_before_it_goes(view: ViewPage, tmp_path: Path):
    asked: list[str] = []

    def answer_and_go(dialog: Dialog) -> None:
        asked.append(dialog.type)
        dialog.accept()

    def reload() -> list[str]:
        asked.clear()
        view.page.reload()
        view.wait_until_open()
        return asked

    view.page.on("dialog", answer_and_go)
    try:
        view.click(12, 20)
        assert reload() == []
        view.click(12, 20)
        view.seek(2)
        view.move(answer(12, 20, 2), (20, 30))
        project = view.save("project.json", tmp_path)
        view.page.locator("#mark-hidden").click()
        assert reload() == ["beforeunload"]
        view.open(project)
        expect(view.page.locator("#corrections li")).to_have_count(1)
        assert reload() == []
    finally:
        view.page.remove_listener("dialog", answer_and_go)


def test_corrected_by_keyboard_alone(view: ViewPage, tmp_path: Path):
    view.click(12, 20)
    view.click(40, 8)
    page, press = view.page, view.page.keyboard.press
    page.locator("#clear").focus()
    for _ in range(5):  # colour, name, delete, strip of the first point
        press("Tab")
        if page.evaluate("document.activeElement.className") == "strip":
            break
    expect(view.rows.nth(0).locator(".strip")).to_be_focused()
    expect(view.rows.nth(0)).to_have_attribute("aria-current", "true")
    for _ in range(2):
        press("ArrowRight")
    view.expect_frame(2)
    expect(view.rows.nth(0).locator(".strip")).to_have_attribute("aria-valuenow", "2")
    page.locator("#split").focus()
    press("Tab")
    expect(view.stage).to_be_focused()
    for key in ("m", "Shift+ArrowRight", "ArrowDown", "Escape", "m", "Shift+ArrowRight", "ArrowDown", "Enter"):
        press(key)
    (row,) = corrections(view, tmp_path)
    x, y = answer(*view.tracks(tmp_path).queries[0, 1:], 2)
    np.testing.assert_allclose(row[3:], (2, x + 10, y + 1), atol=0.011)
    expect(view.rows).to_have_count(2)
    page.get_by_role("button", name="Delete the correction of").focus()
    press("Enter")
    expect(page.locator("#corrections li")).to_have_count(0)


@pytest.fixture
def bench(clip: Path, model: Path, tmp_path: Path) -> Bench:
    (tmp_path / "models").mkdir()
    own = tmp_path / "models" / "slide.onnx"
    own.write_bytes(model.read_bytes())
    return Bench(tmp_path, own, clip, **SIZE, clip_name="slide")


@pytest.fixture
def refitted(chromium: Browser, bench: Bench, clip: Path, tmp_path: Path) -> Iterator[ViewPage]:
    """The page of `decomo-view --run`, with two points, of which the first is corrected."""
    with opened(chromium, tmp_path / "site", bench.model, clip, bench.refits) as view:
        expect(view.page.locator("#refit-begin")).to_be_disabled()
        view.page.locator("#trails").fill("0")
        view.click(12, 20)
        view.click(40, 8)
        view.seek(2)
        view.move(answer(12, 20, 2), (20, 30))
        yield view


def test_a_refit_is_compared_and_taken(refitted: ViewPage, bench: Bench, tmp_path: Path):
    page = refitted.page
    assert "token" not in page.url
    page.locator("#refit-begin").click()
    expect(page.locator("#refit-said")).to_contain_text("fit step 42")
    expect(page.locator("#refit-progress")).to_have_js_property("value", 0.42)
    expect(page.locator("#refit-begin")).to_be_disabled()
    bench.let_go()
    expect(page.locator("#refit-verdict")).to_be_visible()
    expect(page.locator("#refit-figures")).to_contain_text("Given places are missed by 0.0 px, before by ")
    expect(page.locator("#refit-figures")).to_contain_text("The other points move by ")
    refitted.seek(1)
    white = {}
    for side, place in (("old", answer(12, 20, 1)), ("both", (16, 25)), ("new", (16, 25))):
        page.locator(f"#side-{side}").check(force=True)
        refitted.expect_drawn(place)
        white[side] = np.count_nonzero(refitted.pixels().min(-1) > 180)
    assert white["both"] > white["new"] + 20  # the rings of the old places
    page.locator("#refit-take").click()
    expect(page.locator("#refit-said")).to_contain_text("slide-corrected.onnx")
    expect(page.locator("#refit-verdict")).to_be_hidden()
    refitted.expect_drawn((16, 25))
    expect(page.locator("#corrections li")).to_have_count(1)
    tracks = refitted.tracks(tmp_path)
    expected = Tracker(bench.model.with_name("slide-corrected.onnx")).track(tracks.queries)
    np.testing.assert_allclose(tracks.xy, expected.xy, atol=0.05)
    page.keyboard.press("Control+z")
    expect(page.locator("#corrections li")).to_have_count(0)
    page.reload()
    refitted.wait_until_open()
    refitted.click(12, 20)
    refitted.seek(1)
    refitted.expect_drawn((16, 25))
    assert bench.left() == ["slide", "slide-corrected"]


def test_the_verdict_waits_until_the_new_model_is_there(refitted: ViewPage, bench: Bench):
    page, held = refitted.page, []
    page.route("**/refit-1.onnx", lambda route: held.append(route))  # which answers when it is told to
    bench.let_go()
    with page.expect_request("**/refit-1.onnx"):
        page.locator("#refit-begin").click()
    expect(page.locator("#refit-said")).to_have_text("Opening the new model …")
    expect(page.locator("#refit-verdict")).to_be_hidden()
    (route,) = held
    route.continue_()
    expect(page.locator("#refit-verdict")).to_be_visible()
    expect(page.locator("#refit-figures")).to_contain_text("Given places are missed by")


def test_a_refit_is_rejected_and_the_next_one_goes_on_from_the_old_run(refitted: ViewPage, bench: Bench):
    page = refitted.page
    bench.let_go()
    page.locator("#refit-begin").click()
    page.locator("#refit-reject").click()
    expect(page.locator("#refit-said")).to_contain_text("Rejected; the run is still there")
    refitted.expect_drawn((20, 30))
    refitted.seek(1)
    bench.let_go()
    page.locator("#refit-begin").click()
    expect(page.locator("#refit-verdict")).to_be_visible()
    assert [Path(run).name for _, run, _ in bench.begun()] == ["slide", "slide"]


def test_a_cancelled_refit_leaves_nothing(refitted: ViewPage, bench: Bench):
    page = refitted.page
    page.locator("#refit-begin").focus()
    page.keyboard.press("Enter")
    process = bench.wait_until_begun()
    page.locator("#refit-cancel").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#refit-said")).to_have_text("Cancelled; nothing was left behind.")
    expect(page.locator("#refit-begin")).to_be_enabled()
    wait_until(lambda: not lives(process))
    assert bench.left() == ["slide"]


def test_a_fit_that_fails_says_why(refitted: ViewPage, bench: Bench):
    bench.let_go("the corrections contradict each other")
    refitted.page.locator("#refit-begin").click()
    expect(refitted.page.locator("#refit-said")).to_have_text("the corrections contradict each other")
    expect(refitted.page.locator("#refit-begin")).to_be_enabled()


def test_a_second_tab_sees_the_refit_that_runs(refitted: ViewPage, bench: Bench):
    first = refitted.page
    second = first.context.new_page()
    second.goto(first.url)  # without the token: the browser knows it
    expect(second.locator("#loading")).to_be_hidden()
    first.locator("#refit-begin").click()
    for page in (first, second):
        expect(page.locator("#refit-running")).to_be_visible()
        expect(page.locator("#refit-begin")).to_be_disabled()
    second.locator("#refit-cancel").click()
    expect(first.locator("#refit-said")).to_have_text("Cancelled; nothing was left behind.")
    bench.let_go()
    first.locator("#refit-begin").click()
    second.locator("#refit-take").click()
    for page in (first, second):
        expect(page.locator("#refit-said")).to_contain_text("Taken")
        expect(page.locator("#refit-verdict")).to_be_hidden()
    refitted.seek(1)
    refitted.expect_drawn((16, 25))


def test_a_wrong_token_refits_nothing_and_the_page_goes_on(refitted: ViewPage, bench: Bench):
    page = refitted.page
    token = page.evaluate("localStorage.getItem('decomo-token')")
    page.evaluate("localStorage.setItem('decomo-token', 'guess')")
    page.reload()
    refitted.wait_until_open()
    expect(page.locator("#refit-said")).to_contain_text("This page may not refit: open the whole address")
    refitted.click(12, 20)
    refitted.seek(2)
    refitted.move(answer(12, 20, 2), (20, 30))
    expect(page.locator("#refit-begin")).to_be_disabled()
    assert bench.begun() == []
    page.evaluate("token => { location.hash = `token=${token}`; }", token)  # the whole address, in the tab that is open
    expect(page.locator("#refit-begin")).to_be_enabled()
    expect(page.locator("#refit-said")).to_be_empty()
    assert "token" not in page.url
    expect(page.locator("#corrections li")).to_have_count(1)
    refitted.complaints.clear()  # of the browser, that it was refused


def test_without_the_server_the_page_goes_on(refitted: ViewPage, tmp_path: Path):
    """It has ended, or there is no way to it any more."""
    page = refitted.page
    page.context.set_offline(True)
    expect(page.locator("#refit-said")).to_contain_text("decomo-view has ended, so nothing is refitted")
    expect(page.locator("#refit-begin")).to_be_disabled()
    refitted.click(30, 30)
    refitted.seek(3)
    refitted.move(answer(40, 8, 3), (10, 10), row=1)
    assert len(corrections(refitted, tmp_path)) == 2
    page.context.set_offline(False)
    expect(page.locator("#refit-begin")).to_be_enabled()
    expect(page.locator("#refit-said")).to_be_empty()
    refitted.complaints.clear()  # of the browser, that nobody answered


def test_another_model_is_not_refitted(refitted: ViewPage, bench: Bench, tmp_path: Path):
    page = refitted.page
    other = write_tiny_model(tmp_path / "other.onnx", num_frames=5, height=20, width=30, clip_name="other")
    bench.let_go()
    page.locator("#refit-begin").click()
    expect(page.locator("#refit-verdict")).to_be_visible()
    with page.expect_event("dialog"):
        page.once("dialog", lambda dialog: dialog.dismiss())
        refitted.open(other)
    expect(page.locator("#corrections li")).to_have_count(1)  # unsaved: the page has asked
    expect(page.locator("#facts")).to_contain_text("slide")
    page.once("dialog", lambda dialog: dialog.accept())
    refitted.open(other)
    expect(page.locator("#facts")).to_contain_text("other")
    expect(page.locator("#refit-verdict")).to_be_hidden()
    refitted.size = (30, 20)
    refitted.click(12, 10)
    refitted.seek(2)
    refitted.move(answer(12, 10, 2), (20, 15))
    expect(page.locator("#refit-begin")).to_be_disabled()
    expect(page.locator("#refit-begin")).to_have_accessible_description(re.compile("^Another model is open"))


def test_on_a_phone(chromium: Browser, bench: Bench, clip: Path, tmp_path: Path):
    options = {"viewport": {"width": 390, "height": 844}, "has_touch": True}
    with opened(chromium, tmp_path / "site", bench.model, clip, bench.refits, **options) as view:
        view.click(12, 20)
        view.seek(2)
        view.move(answer(12, 20, 2), (20, 30))
        bench.let_go()
        view.page.locator("#refit-begin").tap()
        expect(view.page.locator("#refit-verdict")).to_be_visible()
        wide = view.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wide <= 0, "the page scrolls sideways on a phone"
        view.page.locator("#refit-take").tap()
        expect(view.page.locator("#refit-said")).to_contain_text("Taken")


def test_a_finger_is_never_still_and_the_second_one_places_nothing(
    chromium: Browser, model: Path, clip: Path, tmp_path: Path
):
    options = {"viewport": {"width": 390, "height": 844}, "has_touch": True}
    with opened(chromium, tmp_path / "site", model, clip, **options) as view:
        devtools = view.page.context.new_cdp_session(view.page)
        box = view.stage.bounding_box()
        assert box is not None

        def touch(kind: str, *fingers: tuple[float, float]) -> None:
            points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(fingers)]
            devtools.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})

        def on_page(x: float, y: float) -> tuple[float, float]:
            across, down = view.on_stage(x, y)
            return box["x"] + across, box["y"] + down

        view.click(12, 20)
        view.seek(2)
        x, y = on_page(*answer(12, 20, 2))
        touch("Start", (x - 6, y))  # beside it, and moving by less than a finger does
        touch("Move", (x - 1, y + 3))
        touch("End")
        first, second = on_page(40, 8), on_page(8, 30)
        touch("Start", first)
        touch("Start", first, second)
        touch("Move", first, (second[0] + 30, second[1]))
        touch("End")
        expect(view.rows).to_have_count(2)
        expect(view.page.locator("#corrections li")).to_have_count(0)
        queries = view.tracks(tmp_path).queries
        np.testing.assert_allclose(queries, [(0, 12, 20), (2, 40, 8)], atol=0.2)
        devtools.detach()
