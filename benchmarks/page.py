"""What a click on the page of `decomo-view` costs, and how far its answers are from the runtime's.

    python benchmarks/page.py goat.onnx goat.mp4
    python benchmarks/page.py goat.onnx --windows 30 --clicks 2
    python benchmarks/page.py goat.onnx goat.mp4 --draw
    python benchmarks/page.py goat.onnx --long 300 --size 1920x1080
    python benchmarks/page.py camel.onnx frames/camel --masks masks/camel --frame 12 --frame 30

Opens the page in Chromium (`apt-get install chromium`), clicks thirty pixels of frame 0 while the clip is shown, then
as many while the model also renders its layers; prints milliseconds from a click to its point on the list and to its
whole track. With `--windows`, the file is taken for each of so many windows of a long clip. With `--draw`, also how
often in a second the picture is drawn anew while the brush draws over those points, and while what it drew is played.
With `--long`, it is taken for each window of a made clip of so many frames, which is scrubbed, played and rendered
(`page_long.py`). With `--masks`, the mask of frame 0 is loaded and carried to the frames (`page_masks.py`).
"""

from __future__ import annotations

import shutil
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
from playwright.sync_api import Page, expect, sync_playwright

import page_long
import page_masks
from decomo_runtime import Tracker, Tracks, ViewError
from decomo_runtime.view.server import make_server
from decomo_runtime.view.site import read_inputs, write_site
from decomotion.console import run
from decomotion.windows import FILE_NAME, Window, Windows

PATIENCE = 600_000
FLAGS = ("--no-sandbox", "--no-first-run", "--disable-gpu", "--disable-background-networking", "--disable-sync")


@click.command()
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("clip", type=click.Path(path_type=Path), required=False)
@click.option("--windows", metavar="N", type=click.IntRange(min=1), default=1)
@click.option("--clicks", metavar="N", type=click.IntRange(min=1), default=30)
@click.option("--draw", is_flag=True)
@click.option("--long", "length", metavar="FRAMES", type=click.IntRange(min=20))
@click.option("--size", metavar="WxH", default="1920x1080", help="Of the long clip.")
@click.option("--masks", metavar="DIR", type=click.Path(path_type=Path), help="A PNG for each frame of CLIP.")
@click.option("--frame", "asked", metavar="T", type=int, multiple=True, help="To carry the first of them to.")
def main(
    model: Path,
    clip: Path | None,
    windows: int,
    clicks: int,
    draw: bool,
    length: int | None,
    size: str,
    masks: Path | None,
    asked: tuple[int, ...],
) -> None:
    """Measures the page with MODEL and CLIP."""
    chromium = shutil.which("chromium")
    if chromium is None:
        raise ViewError("there is no chromium on the PATH; install it")
    with (
        tempfile.TemporaryDirectory() as several,
        tempfile.TemporaryDirectory() as folder,
        make_server(Path(folder)) as server,
        sync_playwright() as driver,
    ):
        if length is not None:
            width, height = map(int, size.split("x"))
            model, clip = page_long.write_long(Path(several), model, length, width, height)
        elif windows > 1:
            write_windows(Path(several), model, windows)
            model = Path(several)
        _, frames = read_inputs(model, clip)
        write_site(Path(folder), model, frames)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        browser = driver.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(f"http://127.0.0.1:{server.server_address[1]}/")
        expect(page.locator("#loading")).to_be_hidden(timeout=PATIENCE)
        click.echo(f"{page.locator('#facts').text_content()}; Chromium {browser.version}")
        if length is not None:
            page_long.measure(page)
            return
        if masks is not None and clip is not None:
            page_masks.measure(page, model, clip, masks, asked, Path(several))
            return
        click.echo(f"a click: {click_times(page, clicks)}")
        if draw:
            click.echo(draw_rates(page))
        page.keyboard.press("2")
        click.echo(f"while layers are rendered: {click_times(page, clicks)}")
        with page.expect_download() as download:
            page.locator("[data-save='tracks.npz']").click()
        saved = Path(folder) / "tracks.npz"
        download.value.save_as(saved)
        tracks = Tracks.load(saved)
        browser.close()
        server.shutdown()
        difference = np.abs(tracks.xy - Tracker(model).track(tracks.queries).xy).max()
    click.echo(f"{len(tracks.queries)} tracks, at most {difference:.5f} px from the runtime's")


def write_windows(folder: Path, model: Path, count: int) -> None:
    """A model folder of so many windows which share twelve frames, or a quarter of theirs, and one model."""
    facts = Tracker(model).facts
    step = facts.num_frames - min(12, facts.num_frames // 4)
    windows = tuple(Window(f"window-{each:03d}", each * step, each * step + facts.num_frames) for each in range(count))
    for window in windows:
        (folder / f"{window.name}.onnx").symlink_to(model.absolute())
    Windows(facts.clip_name, windows[-1].end, facts.height, facts.width, facts.fps, windows).save(folder / FILE_NAME)


def click_times(page: Page, clicks: int) -> str:
    """Milliseconds of so many clicks, spread over the picture."""
    stage, rows = page.locator("#stage"), page.locator("#points li")
    box = stage.bounding_box()
    assert box is not None
    shown, answered = [], []
    for number in range(clicks):
        count = rows.count()
        across, down = (0.05 + 0.9 * (number * step % clicks) / clicks for step in (7, 11))
        start = time.perf_counter()
        # with Shift, a click near a point places another one
        stage.click(position={"x": across * box["width"], "y": down * box["height"]}, modifiers=["Shift"])
        expect(rows).to_have_count(count + 1, timeout=PATIENCE)
        shown.append(1000 * (time.perf_counter() - start))
        expect(page.locator("[data-save='tracks.npz']")).to_be_enabled(timeout=PATIENCE)
        answered.append(float(page.locator("#status").get_attribute("data-milliseconds") or "nan"))
    return f"{summary(answered)}; with Playwright, until the point is listed: {summary(shown)}"


COUNT = """() => {
  const fill = CanvasRenderingContext2D.prototype.fillRect;
  window.drawn = [];
  CanvasRenderingContext2D.prototype.fillRect = function (...box) {
    if (this.canvas.id === "stage" && this.fillStyle === "#000000") window.drawn.push(performance.now());
    return fill.apply(this, box);
  };
}"""
"""Each drawing of the stage begins with a black one."""


def draw_rates(page: Page, seconds: float = 8) -> str:
    """How often the stage is drawn in a second: under the brush, and while what it drew is played."""
    page.evaluate(COUNT)
    page.locator("#tools input[value=brush]").check(force=True)
    box = page.locator("#stage").bounding_box()
    assert box is not None

    def rate(action: Callable[[float], object]) -> float:
        page.evaluate("window.drawn.length = 0")
        begin = time.perf_counter()
        while (elapsed := time.perf_counter() - begin) < seconds:
            action(elapsed)
        return page.evaluate("window.drawn.length") / elapsed

    def stroke(elapsed: float) -> None:
        across, down = 0.5 + 0.3 * np.cos(2 * elapsed), 0.5 + 0.3 * np.sin(2 * elapsed)
        page.mouse.move(box["x"] + box["width"] * across, box["y"] + box["height"] * down)

    stroke(0)
    page.mouse.down()
    drawing = rate(stroke)
    page.mouse.up()
    expect(page.locator("#drawings li")).to_have_count(1)
    page.locator("#play").click()
    first = rate(lambda _: page.wait_for_timeout(100))
    page.wait_for_timeout(20_000)
    later = rate(lambda _: page.wait_for_timeout(100))
    page.locator("#play").click()
    page.locator("#tools input[value=points]").check(force=True)
    points = page.locator("#points li").count()
    return (
        f"over {points} points the picture is drawn {drawing:.1f} times a second under the brush; playing, "
        f"{first:.1f} frames a second at first, {later:.1f} half a minute later"
    )


def summary(times: list[float]) -> str:
    """Median and slowest."""
    return f"median {statistics.median(times):.1f} ms, slowest {max(times):.1f} ms"


if __name__ == "__main__":
    sys.exit(run(main))
