"""The page tells how sure the model is: colours, a map over the picture, jumps. In Chromium."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pytest

from decomo_runtime import Tracker
from decomo_runtime.expected_error import calibration
from tiny_model import VELOCITY, write_tiny_model

pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
from playwright.sync_api import expect

from view_page import ViewPage, opened, write_grey_clip

if TYPE_CHECKING:
    from playwright.sync_api import Browser

NUM_FRAMES, HEIGHT, WIDTH = 8, 320, 512
UNIT = 2
GREY = 100
COLOURS = np.array([[44, 123, 182], [171, 217, 233], [255, 255, 191], [253, 174, 97], [215, 25, 28]])
HEAT_INK = 0.55

pytestmark = pytest.mark.slow


def colour_of(error: float) -> npt.NDArray[np.float64]:
    """RGB of an error in pixels: from blue at half a unit to red at 16, even in logarithms."""
    at = np.log2(max(error / UNIT, 0.5) / 0.5) / 5 * (len(COLOURS) - 1)
    return np.array([np.interp(at, range(len(COLOURS)), channel) for channel in COLOURS.T])


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A point is in sight up to four frames away from where it was asked for, ever less surely."""
    path = tmp_path_factory.mktemp("model") / "slide.onnx"
    return write_tiny_model(path, num_frames=NUM_FRAMES, height=HEIGHT, width=WIDTH, clip_name="slide")


@pytest.fixture(scope="module")
def shared_view(chromium: Browser, model: Path, tmp_path_factory: pytest.TempPathFactory):
    clip = write_grey_clip(tmp_path_factory.mktemp("clips"), HEIGHT, WIDTH, [GREY] * NUM_FRAMES)
    with opened(chromium, tmp_path_factory.mktemp("site"), model, clip) as view:
        yield view


@pytest.fixture
def view(shared_view: ViewPage, request: pytest.FixtureRequest) -> ViewPage:
    """The page with the clip, without points, at frame 0."""
    shared_view.begin(request)
    shared_view.clear()
    shared_view.page.locator("#error-colours").uncheck()
    shared_view.page.locator("#error-heat").uncheck()
    shared_view.page.locator("#trails").fill("0")
    shared_view.seek(0)
    return shared_view


def expect_colour(view: ViewPage, x: float, y: float, colour: npt.NDArray[np.float64]) -> None:
    """What the stage shows at a place, 0 to 255, once what is made in the background is there."""
    view.expect_colour(x, y, colour, apart=4)


def test_tracks_are_coloured_by_what_the_runtime_says(view: ViewPage, model: Path, tmp_path: Path):
    view.click(200, 150)
    view.page.locator("#error-colours").check()
    tracks = view.tracks(tmp_path)
    told = Tracker(model).track(tracks.queries)
    assert tracks.error is not None
    assert told.error is not None
    np.testing.assert_allclose(tracks.error, told.error, rtol=1e-5)
    shown = []
    for frame in range(5):
        view.seek(frame)
        x, y = np.array([200, 150]) + frame * np.array(VELOCITY)
        shown.append(colour_of(told.error[0, frame]))
        expect_colour(view, x, y, shown[-1])
        expect(view.page.locator("#error-said")).to_contain_text(
            f"frame {frame}: within {float(f'{told.error[0, frame]:.2g}'):g} px"
        )
    assert np.abs(shown[1] - shown[4]).max() > 40
    view.seek(5)
    expect(view.page.locator("#error-said")).to_contain_text("frame 5: hidden; if it is in sight,")
    assert "rgb(44, 123, 182)" in view.rows.nth(0).locator(".strip").evaluate("each => each.style.backgroundImage")
    view.page.locator("#error-colours").uncheck()
    view.seek(0)
    own = view.rows.nth(0).locator("input[type=color]").input_value()
    expect_colour(view, 200, 150, np.array([int(own[at : at + 2], 16) for at in (1, 3, 5)], np.float64))


def test_the_space_bar_ticks_a_box_that_has_the_focus_and_plays_elsewhere(view: ViewPage):
    colours, play = view.page.locator("#error-colours"), view.page.locator("#play")
    colours.focus()
    view.page.keyboard.press("Space")
    expect(colours).to_be_checked()
    expect(play).to_have_attribute("aria-pressed", "false")
    view.page.keyboard.press("Space")
    expect(colours).not_to_be_checked()
    view.page.locator("#tools input:checked").focus()
    view.page.keyboard.press("Space")
    expect(play).to_have_attribute("aria-pressed", "true")
    view.page.keyboard.press("Space")


def test_legend_is_in_pixels_of_the_clip(view: ViewPage):
    legend = view.page.locator("#error-legend")
    expect(legend).to_be_hidden()
    view.page.locator("#error-heat").check()
    expect(legend).to_be_visible()
    assert legend.locator("span").all_text_contents() == ["1", "2", "4", "8", "16", "32"]


@pytest.mark.parametrize(("frame", "gaps"), [(0, (2, 4)), (3, (2, 2, 4)), (6, (2, 4))])
def test_a_map_over_the_picture_is_of_the_frames_near_by(frame: int, gaps: tuple[int, ...], view: ViewPage):
    view.page.locator("#error-heat").check()
    view.seek(frame)
    error = np.median(UNIT * calibration().error(np.array(gaps) / NUM_FRAMES, np.array(gaps), None))
    for x, y in ((20, 20), (490, 300), (250, 160)):
        expect_colour(view, x, y, (1 - HEAT_INK) * GREY + HEAT_INK * colour_of(float(error)))
    view.page.locator("#error-heat").uncheck()
    expect_colour(view, 250, 160, np.full(3, float(GREY)))


def test_keys_and_buttons_jump_to_the_least_sure_moments(view: ViewPage):
    following, former = view.page.locator("#error-next"), view.page.locator("#error-previous")
    expect(following).to_be_disabled()
    view.click(200, 150)  # in sight up to frame 4
    view.seek(NUM_FRAMES - 1)
    view.click(300, 100)  # in sight from frame 3 on
    view.seek(0)
    view.stage.evaluate("element => document.activeElement.blur()")
    for go, frame, row in (
        (following.click, 3, 1),
        (following.click, 4, 0),
        (lambda: view.page.keyboard.press("n"), 3, 1),
        (lambda: view.page.keyboard.press("p"), 4, 0),
        (former.click, 3, 1),
    ):
        go()
        view.expect_frame(frame)
        expect(view.rows.nth(row)).to_have_attribute("aria-current", "true")
        expect(view.page.locator("#status")).to_contain_text(f"in frame {frame}: expected within")


def test_where_it_is_given_nothing_is_unsure(view: ViewPage, tmp_path: Path):
    view.click(200, 150)
    view.page.locator("#error-next").click()
    view.expect_frame(4)
    x, y = np.array([200, 150]) + 4 * np.array(VELOCITY)
    view.drag((x, y), (x + 20, y + 30))
    expect(view.page.locator("#corrections li")).to_have_count(1)
    tracks = view.tracks(tmp_path)
    assert tracks.error is not None
    assert tracks.error[0, 4] == 0 < tracks.error[0, 3]
    view.page.locator("#error-next").click()
    view.expect_frame(3)
