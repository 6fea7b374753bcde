"""A long and large clip on the page: does anything get black, how many frames a second, how much memory (`page.py`)."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import click
import cv2
import numpy as np
import numpy.typing as npt
import onnx
import onnx.helper
from playwright.sync_api import Page, expect

from decomo_runtime import contract
from decomotion.images import jpeg
from decomotion.windows import FILE_NAME, Window, Windows

PATIENCE = 600_000
SECONDS = 10
POINTS = 6
SHARED, LONGEST = 12, 60
"""Frames that windows share, and that they have."""
FPS = 24.0
SCRUB = """async ([seconds, step]) => {
    const [scrub, picture, stage] = ["scrub", "frame", "stage"].map((id) => document.getElementById(id));
    const pixel = new OffscreenCanvas(8, 8).getContext("2d", { willReadFrequently: true });
    const last = Number(scrub.max);
    const counts = { screen: 0, black: 0, behind: 0, pictures: 0 };
    let [before, at, way] = ["", Number(scrub.value), step];
    const end = performance.now() + 1000 * seconds;
    while (performance.now() < end) {
        if (step !== 0) {
            if (at + way < 0 || at + way > last) way = -way;
            scrub.value = String((at += way));
            scrub.dispatchEvent(new Event("input"));
        }
        await new Promise((done) => requestAnimationFrame(done));
        pixel.drawImage(stage, 0, 0, 8, 8);
        if (pixel.getImageData(0, 0, 8, 8).data.every((value, index) => index % 4 === 3 || value === 0)) counts.black++;
        counts.screen++;
        if (picture.ariaBusy === "true") counts.behind++;
        if (picture.dataset.shown !== before) counts.pictures++;
        before = picture.dataset.shown;
    }
    return counts;
}"""


def write_long(folder: Path, model: Path, length: int, width: int, height: int) -> tuple[Path, Path]:
    """A model folder for a made clip of that length and size, and the clip; `model` is taken for every window."""
    proto = onnx.load(model)
    entries = {each.key: each.value for each in proto.metadata_props}
    longest = min(LONGEST, int(entries[contract.META_NUM_FRAMES]))
    begins = range(0, max(1, length - SHARED), longest - SHARED)
    windows = tuple(
        Window(f"window-{number:03d}", begin, min(begin + longest, length)) for number, begin in enumerate(begins)
    )
    models, clip = folder / "model", folder / "clip"
    models.mkdir()
    clip.mkdir()
    own = {contract.META_HEIGHT: str(height), contract.META_WIDTH: str(width)}
    entries.pop(contract.META_TIMES, None)
    for window in windows:
        told = entries | own | {contract.META_NUM_FRAMES: str(window.end - window.begin)}
        del proto.metadata_props[:]
        onnx.helper.set_model_props(proto, told)
        onnx.save(proto, models / f"{window.name}.onnx")
    Windows("made", length, height, width, FPS, windows).save(models / FILE_NAME)
    for number in range(length):
        (clip / f"{number:05d}.jpg").write_bytes(jpeg(made_frame(number, width, height), 92))
    return models, clip


def made_frame(number: int, width: int, height: int) -> npt.NDArray[np.uint8]:
    """RGB [height, width, 3]: a textured ground that moves three pixels a frame."""
    return np.roll(made_ground(2 * width, height), -3 * number, axis=1)[:, :width]


@cache
def made_ground(width: int, height: int) -> npt.NDArray[np.uint8]:
    """RGB [height, width, 3], nowhere black."""
    rng = np.random.default_rng(0)
    ground = sum(
        np.asarray(cv2.resize(rng.random((cells, 2 * cells, 3)), (width, height), interpolation=cv2.INTER_CUBIC))
        for cells in (8, 64, 256)
    )
    return np.clip(30 + 65 * ground, 20, 255).astype(np.uint8)


def measure(page: Page) -> None:
    """Prints what scrubbing, playing and rendering cost."""
    tell(page, "opened")
    for step in (1, 7):
        told(page, f"scrubbed by {step} a picture of the screen", page.evaluate(SCRUB, [SECONDS, step]))
    page.locator("#play").click()
    told(page, "played", page.evaluate(SCRUB, [SECONDS, 0]))
    page.locator("#play").click()
    stage, rows = page.locator("#stage"), page.locator("#points li")
    box = stage.bounding_box()
    assert box is not None
    for number in range(POINTS):
        page.locator("#scrub").fill(str(number * int(page.locator("#scrub").get_attribute("max") or 0) // POINTS))
        across = box["width"] * (number + 1) / (POINTS + 1)
        stage.click(position={"x": across, "y": box["height"] / 3}, modifiers=["Shift"])
        expect(rows).to_have_count(number + 1, timeout=PATIENCE)
        expect(page.locator("[data-save='tracks.npz']")).to_be_enabled(timeout=PATIENCE)
    tell(page, f"{POINTS} points followed through all windows")
    for box_of in ("#error-colours", "#error-heat"):
        page.locator(box_of).check()
    page.keyboard.press("2")
    told(page, "rendered, with points and a map of errors, scrubbed", page.evaluate(SCRUB, [SECONDS, 1]))
    page.keyboard.press("1")
    told(page, "the same over the clip", page.evaluate(SCRUB, [SECONDS, 1]))


def told(page: Page, what: str, counts: dict[str, int]) -> None:
    """With the numbers that `SCRUB` returns."""
    tell(
        page,
        f"{what}: {counts['pictures'] / SECONDS:.1f} frames a second, {counts['screen'] / SECONDS:.1f} of the screen, "
        f"{counts['behind'] / counts['screen']:.0%} of them behind what is asked for, {counts['black']} black",
    )


def tell(page: Page, what: str) -> None:
    """With the memory of the page's process, now and at most."""
    browser = page.context.browser
    assert browser is not None
    devtools = browser.new_browser_cdp_session()
    processes = devtools.send("SystemInfo.getProcessInfo")["processInfo"]
    devtools.detach()
    memory = [memory_of(each["id"]) for each in processes if each["type"] == "renderer"]
    now, most = (max(each[kind] for each in memory) for kind in ("VmRSS", "VmHWM"))
    heap = page.evaluate("performance.memory.usedJSHeapSize") / 2**20
    click.echo(f"{what}; {now:.0f} MiB, at most {most:.0f} so far, {heap:.0f} of them objects")


def memory_of(process: int) -> dict[str, float]:
    """MiB."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return {line.split(":")[0]: int(line.split()[1]) / 1024 for line in lines if line.startswith(("VmRSS", "VmHWM"))}
