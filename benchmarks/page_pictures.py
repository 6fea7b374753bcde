"""The pictures of the page in docs/view.md and docs/draw.md, by what a person would do.

In Chromium, of clips of DAVIS at 854x480:

    python benchmarks/page_pictures.py points goat.onnx frames/goat docs/images/view-points.jpg
    python benchmarks/page_pictures.py split breakdance.onnx frames/breakdance docs/images/view-split.jpg
    python benchmarks/page_pictures.py draw camel.onnx frames/camel docs/images/view-draw.jpg
    python benchmarks/page_pictures.py mask camel.onnx frames/camel docs/images/view-mask.jpg --mask camel@0.png
    python benchmarks/page_pictures.py refit parkour.onnx frames/parkour docs/images/view-refit.jpg --run runs/parkour

Places are pixels of those clips. A refit takes its minute; with `--refitted`, a copy of a run that was refitted before
with these corrections takes its place.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path

import click
import cv2
import numpy as np
import numpy.typing as npt
from playwright.sync_api import Page, expect, sync_playwright

from decomo_runtime.view.refit import TRAIN, Refits
from decomo_runtime.view.server import make_server
from decomo_runtime.view.site import read_inputs, write_site
from decomotion.console import run
from page import FLAGS, PATIENCE

SIZE = {"points": (900, 720), "split": (900, 720), "draw": (900, 800), "mask": (1024, 720), "refit": (1100, 1080)}
STILL = 10_000
"""Milliseconds without a change after which a picture is taken to be final."""
QUALITY = 88
COPY = "import shutil, sys; at = sys.argv.index('--out'); shutil.copytree({!r}, sys.argv[at + 1], dirs_exist_ok=True)"

GOAT = ((410, 180), (470, 130), (365, 330), (375, 265), (80, 360), (640, 250), (250, 170))
CROWD = ((60, 190), (350, 300), (590, 150), (690, 200), (770, 180), (490, 175))
HAND = (585.1, 179.1)
"""Of parkour, in frame 0; and where it belongs, as TAP-Vid annotates it."""
CORRECTIONS = {9: (538.6, 329.7), 28: (421.6, 158.3)}
BESIDE = ((529, 158), (575, 132), (544, 76))
FORELEG = ((482, 278), (508, 270), (512, 345), (533, 383), (496, 390), (488, 332), (482, 278))
NO_CAMEL = ((119, 240), (114, 270), (108, 300))
SIGN = ((619, 29), (801, 119))
STROKE = ((367, 208), (397, 191), (412, 215), (439, 191), (459, 220), (479, 191), (496, 228))

Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Hand:
    """What a person does on the page, in pixels of a clip of that width."""

    page: Page
    width: int

    def at(self, x: float, y: float) -> tuple[float, float]:
        """In CSS pixels of the window, whose top is shown."""
        self.page.evaluate("scrollTo(0, 0)")
        box = self.page.locator("#stage").bounding_box()
        assert box is not None
        scale = box["width"] / self.width
        return box["x"] + (x + 0.5) * scale, box["y"] + (y + 0.5) * scale

    def click(self, x: float, y: float) -> None:
        self.page.mouse.click(*self.at(x, y))

    def point(self, x: float, y: float) -> None:
        """Places one, and waits for its track."""
        count = self.page.locator("#points li").count()
        self.click(x, y)
        expect(self.page.locator("#points li")).to_have_count(count + 1)
        expect(self.page.locator("[data-save='tracks.npz']")).to_be_enabled()

    def drag(self, *places: tuple[float, float]) -> None:
        mouse = self.page.mouse
        mouse.move(*self.at(*places[0]))
        mouse.down()
        for place in places[1:]:
            mouse.move(*self.at(*place), steps=4)
        mouse.up()

    def seek(self, frame: int) -> None:
        self.page.locator("#scrub").fill(str(frame))
        expect(self.page.locator("#frame")).to_have_attribute("aria-busy", "false")

    def take(self, tool: str, size: int | None = None, colour: str | None = None) -> None:
        self.page.locator(f"#tools input[value={tool}]").check(force=True)
        if size is not None:
            self.page.locator("#draw-size").fill(str(size))
        if colour is not None:
            self.page.locator("#draw-colour").fill(colour)

    def shot(self, *, whole: bool = True) -> Picture:
        """The window, or the picture alone, once it is still."""
        shown = self.page if whole else self.page.locator("#stage")
        before, now = b"", shown.screenshot()
        while now != before:
            self.page.wait_for_timeout(STILL)
            before, now = now, shown.screenshot()
        decoded = cv2.imdecode(np.frombuffer(now, np.uint8), cv2.IMREAD_COLOR)
        assert decoded is not None
        return decoded.astype(np.uint8, copy=False)


def points(hand: Hand) -> Picture:
    """Of a goat and the rocks about it, 15 frames later."""
    for place in GOAT:
        hand.point(*place)
    hand.seek(15)
    return hand.shot()


def split(hand: Hand) -> Picture:
    """The clip beside the static scene."""
    hand.seek(20)
    for place in CROWD:
        hand.point(*place)
    hand.page.locator("#split").select_option("static")
    return hand.shot()


def draw(hand: Hand) -> Picture:
    """A sign on the scene and a stroke on a camel; beside it 20 frames later."""
    hand.seek(40)
    hand.page.locator("#draw-on").select_option("static", force=True)
    hand.take("box", colour="#ffd21f")
    hand.drag(*SIGN)
    hand.take("text", 36, "#1f3c88")
    hand.page.locator("#draw-text").fill("CAMELS")
    hand.click(*np.mean(SIGN, axis=0))
    hand.page.locator("#draw-on").select_option("dynamic")
    hand.page.locator("#new-layer").click()
    hand.take("brush", 14, "#ff3355")
    hand.drag(*STROKE)
    first = hand.shot()
    hand.seek(60)
    later = hand.shot(whole=False)
    beside = np.full((len(first), later.shape[1], 3), 255, np.uint8)
    top = (len(first) - len(later)) // 2
    beside[top : top + len(later)] = later
    return np.hstack([first, np.full((len(first), 16, 3), 255, np.uint8), beside])


def mask(hand: Hand, file: Path) -> Picture:
    """Of frame 0, as it is carried to frame 30, and corrected there."""
    hand.page.locator("#mask-file").set_input_files(str(file))
    expect(hand.page.locator("#drawings li")).to_have_count(1)
    hand.seek(30)
    hand.shot()
    hand.take("eraser", 60)
    hand.drag(*NO_CAMEL)
    hand.take("polygon")
    hand.drag(*FORELEG)
    hand.take("eraser")
    return hand.shot()


def refit(hand: Hand) -> Picture:
    """A track that was corrected in two frames, after the refit."""
    for place in (*BESIDE, HAND):
        hand.point(*place)
    for frame, place in CORRECTIONS.items():
        hand.seek(frame)
        hand.page.locator("#place").click()
        hand.click(*place)
    expect(hand.page.locator("#corrections li")).to_have_count(len(CORRECTIONS))
    hand.page.locator("#trails").fill("30")
    hand.page.locator("#refit-begin").click()
    expect(hand.page.locator("#refit-verdict")).to_be_visible()
    hand.page.evaluate("scrollTo(0, 0)")
    return hand.shot()


@click.command()
@click.argument("what", type=click.Choice(list(SIZE)))
@click.argument("model", type=click.Path(exists=True, path_type=Path))
@click.argument("clip", type=click.Path(exists=True, path_type=Path))
@click.argument("picture", type=click.Path(path_type=Path))
@click.option("--mask", "mask_file", metavar="PNG", type=click.Path(exists=True, path_type=Path))
@click.option("--run", "run_folder", metavar="DIR", type=click.Path(exists=True, path_type=Path))
@click.option("--refitted", metavar="DIR", type=click.Path(exists=True, path_type=Path))
def main(
    what: str,
    model: Path,
    clip: Path,
    picture: Path,
    mask_file: Path | None,
    run_folder: Path | None,
    refitted: Path | None,
) -> None:
    """Makes the PICTURE of WHAT with MODEL and CLIP."""
    if (what == "mask") != (mask_file is not None) or (what == "refit") != (run_folder is not None):
        raise click.UsageError("mask takes --mask, and refit takes --run")
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        site = Path(name) / "site"
        site.mkdir()
        refits = None
        if run_folder is not None:
            own = shutil.copytree(run_folder, Path(name) / "run")  # new runs and models go with the folder
            train = TRAIN if refitted is None else (sys.executable, "-c", COPY.format(str(refitted)))
            refits = Refits(site, clip, own, Path(name) / model.name, train=train)
        facts, frames = read_inputs(model, clip)
        write_site(site, model, frames, refit=refits is not None)
        with make_server(site, refits=refits) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
            width, height = SIZE[what]
            scheme = "dark" if what == "split" else "light"
            page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
            page.set_default_timeout(PATIENCE)
            expect.set_options(timeout=PATIENCE)
            token = f"#token={refits.token}" if refits else ""
            page.goto(f"http://127.0.0.1:{server.server_address[1]}/{token}")
            expect(page.locator("#loading")).to_be_hidden()
            hand = Hand(page, facts.width)
            made = (
                mask(hand, mask_file)
                if mask_file
                else {"points": points, "split": split, "draw": draw}.get(what, refit)(hand)
            )
            cv2.imwrite(str(picture), made, (cv2.IMWRITE_JPEG_QUALITY, QUALITY))
            browser.close()
            server.shutdown()
    click.echo(f"wrote {picture}")


if __name__ == "__main__":
    sys.exit(run(main))
