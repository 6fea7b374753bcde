"""The mask of frame 0, as the page carries it, beside the truth and what `decomo-propagate` makes of it (`page.py`)."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import click
import cv2
import numpy as np
import numpy.typing as npt
from playwright.sync_api import Page, expect

from decomo_runtime import Tracker, propagate_files
from decomotion.frame_files import decode_mask
from harness.davis import region

PATIENCE = 600_000
STILL = 4000
"""Milliseconds without a change after which a picture is taken to be final."""
PICTURE = "document.getElementById('stage').toDataURL()"

Mask = npt.NDArray[np.bool_]


def measure(page: Page, model: Path, clip: Path, masks: Path, frames: Sequence[int], folder: Path) -> None:
    """Prints intersections over union; `masks` has a PNG for each frame, not black where the object is."""
    truth = [read(file.read_bytes()) for file in sorted(masks.glob("*.png"))]
    first = folder / "first.png"
    cv2.imwrite(str(first), truth[0].astype(np.uint8))
    propagate_files(Tracker(model), [(first, 0)], folder / "carried", clip=clip)
    of_command = [read(file.read_bytes()) for file in sorted((folder / "carried").glob("*.png"))]
    for frame in frames:
        of_page = carried(page, first, frame, folder)
        figures = (of_page, truth[frame]), (of_command[frame], truth[frame]), (of_page, of_command[frame])
        page_truth, command_truth, both = (region(*pair) for pair in figures)
        click.echo(
            f"frame {frame}: page and truth {page_truth:.2f}, command and truth {command_truth:.2f}, page and command "
            f"{both:.2f}"
        )


def carried(page: Page, first: Path, frame: int, folder: Path) -> Mask:
    """The mask of frame 0 in a frame, by beginning to correct it there."""
    page.reload()
    expect(page.locator("#loading")).to_be_hidden(timeout=PATIENCE)
    page.locator("#mask-file").set_input_files(str(first))
    expect(page.locator("#drawings li")).to_have_count(1)
    page.locator("#scrub").fill(str(frame))
    page.wait_for_timeout(STILL)
    shown, before = page.evaluate(PICTURE), ""
    while shown != before:
        page.wait_for_timeout(STILL)
        shown, before = page.evaluate(PICTURE), shown
    page.locator("#tools input[value=eraser]").check(force=True)
    page.locator("#draw-size").fill("1")
    page.locator("#stage").click(position={"x": 9, "y": 9})
    expect(page.locator("#drawings .go")).to_have_count(2)
    with page.expect_download() as download:
        page.locator("[data-save='masks.zip']").click()
    saved = folder / "masks.zip"
    download.value.save_as(saved)
    name = f"{frame:05d}.png"
    with zipfile.ZipFile(saved) as archive:  # without those of which nothing is left
        return read(archive.read(name)) if name in archive.namelist() else np.zeros_like(read(first.read_bytes()))


def read(content: bytes) -> Mask:
    """[H, W], what is not black in a PNG."""
    mask = decode_mask(content, ".png")
    assert mask is not None
    return mask
