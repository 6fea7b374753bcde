"""The page of `decomo-view` as a person uses it: served, opened in Chromium, clicked."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from playwright.sync_api import Browser, Page, expect

from decomo_runtime import Tracks
from decomo_runtime.view.refit import Refits
from decomo_runtime.view.server import HOST, make_server
from decomo_runtime.view.site import read_inputs, write_site
from serving import serving

PATIENCE = 60_000
"""Milliseconds; a busy machine is not a failure."""
expect.set_options(timeout=PATIENCE)
TWO_FRAMES = "await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));"
"""In JavaScript: until what was changed is drawn."""
COUNT_ASKED = """
(() => {
  const [post, end, asked] = [Worker.prototype.postMessage, Worker.prototype.terminate, new Map()];
  Worker.prototype.postMessage = function (...given) {
    const onAnswer = () => asked.has(this) && asked.set(this, asked.get(this) - 1);
    if (!asked.has(this)) this.addEventListener("message", onAnswer);
    asked.set(this, (asked.get(this) ?? 0) + 1);
    post.apply(this, given);
  };
  Worker.prototype.terminate = function () {
    asked.delete(this);
    end.call(this);
  };
  window.unanswered = () => [...asked.values()].reduce((sum, each) => sum + each, 0);
})();
"""
"""Before the page's own scripts: counts what a model is asked for and has not answered."""


def write_grey_clip(folder: Path, height: int, width: int, greys: Sequence[int]) -> Path:
    """A clip `slide` in `folder`, a frame of one grey each."""
    clip = folder / "slide"
    clip.mkdir()
    for frame, grey in enumerate(greys):
        cv2.imwrite(str(clip / f"{frame}.png"), np.full((height, width, 3), grey, np.uint8))
    return clip


@contextmanager
def served(folder: Path, refits: Refits | None = None) -> Iterator[str]:
    """The address at which `folder` is served as `decomo-view` does."""
    with serving(make_server(folder, refits=refits)) as port:
        yield f"http://{HOST}:{port}/" + (f"#token={refits.token}" if refits else "")


HOLD_READING = """
(name) => {
  const [read, former] = [Blob.prototype.arrayBuffer, window.goOnReading];
  const wait = new Promise((go) => (window.goOnReading = () => go(former?.())));
  Blob.prototype.arrayBuffer = async function () {
    if (this.name === name) await wait;
    return read.call(this);
  };
}
"""
"""Files of that name are read once the page's `goOnReading` is called."""
HOLD_ASKING = """
() => {
  const [send, held] = [Worker.prototype.postMessage, []];
  Worker.prototype.postMessage = function (request) {
    held.push(() => send.call(this, request));
  };
  window.goOnAsking = () => {
    Worker.prototype.postMessage = send;
    for (const each of held) each();
  };
}
"""
"""Models are asked once the page's `goOnAsking` is called."""


class ViewPage:
    """What a person does on the page, and what they see. Places are in pixels of the clip."""

    def __init__(self, page: Page, width: int, height: int) -> None:
        self.page = page
        self.size = (width, height)
        self.stage = page.locator("#stage")
        self.rows = page.locator("#points li")
        self.complaints: list[str] = []
        self._failed = 0
        page.set_default_timeout(PATIENCE)
        page.add_init_script(COUNT_ASKED)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("console", lambda said: self.complaints.append(said.text) if said.type == "error" else None)

    def wait_until_open(self) -> None:
        expect(self.page.locator("#loading")).to_be_hidden()

    def begin(self, request: pytest.FixtureRequest) -> None:
        """Opens the page anew where a test has failed since: nobody knows how that has left it."""
        if request.session.testsfailed == self._failed:
            return
        self._failed = request.session.testsfailed
        self.page.unroute_all()
        self.page.reload()
        self.wait_until_open()
        self.complaints.clear()

    def wait_for(self, holds: Callable[[], bool], patience: float = PATIENCE) -> None:
        """Looks again and again, for so many milliseconds at most."""
        end = time.monotonic() + patience / 1000
        while not holds():
            assert time.monotonic() < end, "it never comes true"
            self.page.wait_for_timeout(50)

    def wait_until_drawn(self) -> None:
        """What was changed is to be seen, and what is under the pointer is that."""
        self.page.evaluate(f"async () => {{ {TWO_FRAMES} }}")

    def wait_until_answered(self, patience: float = PATIENCE) -> None:
        """Whatever the page wants of a model for what it shows, the finest too, is there."""
        idle = f"async () => {{ if (unanswered() > 0) return false; {TWO_FRAMES} return unanswered() === 0; }}"
        self.wait_for(lambda: self.page.evaluate(idle), patience)

    def on_stage(self, x: float, y: float) -> tuple[float, float]:
        """The place (x, y) in CSS pixels of the stage, from its upper left corner."""
        box = self.stage.bounding_box()
        assert box is not None
        width, height = self.size
        return (x + 0.5) * box["width"] / width, (y + 0.5) * box["height"] / height

    def click(self, x: float, y: float) -> None:
        """Clicks there and waits for the new point."""
        self.wait_until_drawn()
        count = self.rows.count()
        across, down = self.on_stage(x, y)
        self.stage.click(position={"x": across, "y": down})
        expect(self.rows).to_have_count(count + 1)

    def drag(self, *places: tuple[float, float]) -> None:
        self.wait_until_drawn()
        self.stage.scroll_into_view_if_needed()
        box = self.stage.bounding_box()
        assert box is not None
        corners = [self.on_stage(*place) for place in places]
        mouse = self.page.mouse
        mouse.move(box["x"] + corners[0][0], box["y"] + corners[0][1])
        mouse.down()
        for across, down in corners[1:]:
            mouse.move(box["x"] + across, box["y"] + down, steps=4)
        mouse.up()

    def move(self, begin: tuple[float, float], end: tuple[float, float], row: int = 0) -> None:
        """Drags the point at `begin`, which is that of the row, to `end`."""
        corrections = self.page.locator("#corrections li")
        count = corrections.count()
        self.drag(begin, end)
        expect(corrections).to_have_count(count + 1)
        expect(self.rows.nth(row)).to_have_attribute("aria-current", "true")

    def seek(self, frame: int, is_there: bool = True) -> None:
        self.page.locator("#scrub").fill(str(frame))
        self.expect_frame(frame, is_there)

    def expect_frame(self, frame: int, is_there: bool = True) -> None:
        """Waits until the frame is gone to and, if `is_there`, shown: another stands in for one that is to come."""
        last = self.page.locator("#scrub").get_attribute("max")
        expect(self.page.locator("#frame-number")).to_have_text(f"{frame} / {last}")
        if is_there:
            expect(self.page.locator("#frame")).to_have_attribute("data-shown", str(frame))

    def clear(self) -> None:
        if self.rows.count():
            self.page.locator("#clear").click()
        expect(self.rows).to_have_count(0)

    def pixels(self) -> npt.NDArray[np.uint8]:
        """[h, w, 3], what the stage shows, RGB."""
        got = self.page.evaluate(
            f"async () => {{ {TWO_FRAMES} "
            + """
              const canvas = document.getElementById("stage");
              const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
              let text = "";
              for (let at = 0; at < data.length; at += 8192)
                text += String.fromCharCode(...data.subarray(at, at + 8192));
              return [canvas.height, canvas.width, btoa(text)];
            }"""
        )
        height, width, text = got
        return np.frombuffer(base64.b64decode(text), np.uint8).reshape(height, width, 4)[..., :3]

    def where_drawn(self, row: int = 0) -> tuple[float, float]:
        """The centre of what has exactly the colour of the point in that row, in pixels of the clip; NaN: nothing."""
        colour = self.rows.nth(row).locator("input[type=color]").input_value()
        rgb = [int(colour[at : at + 2], 16) for at in (1, 3, 5)]
        pixels = self.pixels()
        down, across = np.nonzero((pixels == rgb).all(-1))
        if len(down) < 4:
            return float("nan"), float("nan")
        height, width = pixels.shape[:2]
        return (
            float((across.min() + across.max() + 1) / 2 * self.size[0] / width - 0.5),
            float((down.min() + down.max() + 1) / 2 * self.size[1] / height - 0.5),
        )

    def expect_drawn(self, place: Sequence[float] | npt.NDArray[np.floating], row: int = 0) -> None:
        """Waits until the point in that row is drawn there, within half a pixel of the clip."""
        drawn: tuple[float, float] = (0, 0)

        def is_there() -> bool:
            nonlocal drawn
            drawn = self.where_drawn(row)
            return bool(np.abs(np.subtract(drawn, place)).max() <= 0.5)

        self._expect(is_there, lambda: f"the point is drawn at {drawn}, not at {place}")

    def expect_colour(
        self, x: float, y: float, *colours: Sequence[float] | npt.NDArray[np.floating], apart: float
    ) -> None:
        """Waits until a place of the clip shows one of these colours, 0 to 255, within `apart`: it takes its time."""
        shown = np.zeros(3)

        def is_there() -> bool:
            nonlocal shown
            shown = self.colour_at(x, y) * 255
            return bool(min(np.abs(shown - each).max() for each in colours) <= apart)

        self._expect(is_there, lambda: f"({x}, {y}) shows {shown}, not {colours}")

    def _expect(self, holds: Callable[[], bool], otherwise: Callable[[], str]) -> None:
        try:
            self.wait_for(holds)
        except AssertionError:
            pytest.fail(otherwise())

    def colour_at(self, x: float, y: float) -> npt.NDArray[np.float64]:
        """RGB in [0, 1] of what the stage shows at a place."""
        pixels = self.pixels()
        height, width = pixels.shape[:2]
        down, across = (y + 0.5) * height / self.size[1], (x + 0.5) * width / self.size[0]
        return pixels[int(down), int(across)] / 255

    def save(self, kind: str, folder: Path) -> Path:
        """Clicks a button under 'Save' and returns the file."""
        with self.page.expect_download(timeout=PATIENCE) as download:
            self.page.locator(f"[data-save='{kind}']").click()
        path = folder / download.value.suggested_filename
        download.value.save_as(path)
        return path

    def tracks(self, folder: Path) -> Tracks:
        """All points, as the page saves them."""
        return Tracks.load(self.save("tracks.npz", folder))

    def open(self, *files: Path) -> None:
        self.page.locator("#files").set_input_files([str(file) for file in files])

    def drop(self, *files: Path) -> None:
        """Drops files or folders on the stage, as from a file manager."""
        box = self.stage.bounding_box()
        assert box is not None
        data = {"items": [], "files": [str(file) for file in files], "dragOperationsMask": 1}
        devtools = self.page.context.new_cdp_session(self.page)
        for kind in ("dragEnter", "dragOver", "drop"):
            event = {"type": kind, "x": box["x"] + 5, "y": box["y"] + 5, "data": data}
            devtools.send("Input.dispatchDragEvent", event)
        devtools.detach()

    def expect_alert(self, sentence: str) -> None:
        expect(self.page.locator("#alert p")).to_contain_text(sentence)


@contextmanager
def opened(
    browser: Browser,
    folder: Path,
    model: Path,
    clip: Path | None = None,
    refitting: Callable[[Path], Refits] | None = None,
    **options: Any,
) -> Iterator[ViewPage]:
    """The page with that model, which must end without an error on its console; `options` are a browser context's.

    `refitting` makes the refits of the folder that is served.
    """
    facts, frames = read_inputs(model, clip)
    folder.mkdir(parents=True, exist_ok=True)
    write_site(folder, model, frames, refit=refitting is not None)
    refits = refitting and refitting(folder)
    with served(folder, refits) as address, browser.new_context(**options) as context:
        view = ViewPage(context.new_page(), facts.width, facts.height)
        view.page.goto(address)
        view.wait_until_open()
        yield view
        assert view.complaints == [], view.complaints
    if refits is not None:
        refits.cancel()
