"""Long and large clips on the page: what is shown while frames are still to come, and what is kept. In Chromium."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import av
import cv2
import numpy as np
import numpy.typing as npt
import pytest

from decomo_runtime import contract
from tiny_model import write_tiny_model

pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
from playwright.sync_api import expect

from view_page import ViewPage, opened

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Route

NUM_FRAMES, HEIGHT, WIDTH = 40, 24, 44

pytestmark = pytest.mark.slow


def grey_of(frame: int) -> int:
    return 50 + 5 * frame


def write_frames(folder: Path, values: npt.NDArray[np.integer]) -> list[Path]:
    folder.mkdir()
    files = [folder / f"{number:03d}.png" for number in range(len(values))]
    for file, value in zip(files, values, strict=True):
        cv2.imwrite(str(file), np.full((HEIGHT, WIDTH, 3), value, values.dtype))
    return files


def write_model(folder: Path, num_frames: int, **metadata: str) -> Path:
    path = folder / "slide.onnx"
    return write_tiny_model(path, num_frames=num_frames, height=HEIGHT, width=WIDTH, metadata=metadata)


def grey_shown(view: ViewPage) -> float:
    return float(255 * view.colour_at(WIDTH - 3, HEIGHT - 3).mean())


def test_a_frame_that_is_still_to_come_is_stood_in_for(chromium: Browser, tmp_path: Path):
    """By the nearest that is there, with its own points: nothing is black, and a click is of what is seen."""
    write_frames(tmp_path / "clip", np.array([grey_of(frame) for frame in range(NUM_FRAMES)], np.uint8))
    held: list[Route] = []
    with opened(chromium, tmp_path / "site", write_model(tmp_path, NUM_FRAMES), tmp_path / "clip") as view:
        picture = view.page.locator("#frame")
        address = view.page.url
        view.page.goto("about:blank")
        view.page.route("**/clip/*.jpg", lambda route: held.append(route))
        view.page.goto(address)  # and now no frame comes before it is let through
        view.wait_until_open()
        view.wait_for(lambda: len(held) >= 3)
        assert [route.request.url[-7:-4] for route in held] == ["000", "001", "002"]  # few at once
        for route in held[:3]:
            route.continue_()
        view.wait_for(lambda: len(held) == 6)  # the next ones are asked for as these are decoded
        expect(picture).to_have_attribute("aria-busy", "false")
        view.click(30, 11)
        view.page.locator("#scrub").fill("29")
        view.expect_frame(29, is_there=False)
        expect(picture).to_have_attribute("aria-busy", "true")
        marked = int(picture.get_attribute("data-shown") or -1)
        view.page.keyboard.press("h")  # of the frame that is seen, which stays
        expect(view.page.locator("#corrections li")).to_contain_text(f"frame {marked}: hidden")
        view.expect_frame(marked)
        view.page.locator("#scrub").fill("30")
        view.expect_frame(30, is_there=False)
        expect(picture).to_have_attribute("aria-busy", "true")
        shown = int(picture.get_attribute("data-shown") or -1)
        assert shown <= 5
        assert grey_shown(view) == pytest.approx(grey_of(shown), abs=3)
        view.click(20, 11)
        assert view.tracks(tmp_path).queries[:, 0].tolist() == [0, shown]
        view.page.unroute("**/clip/*.jpg")
        expect(picture).to_have_attribute("aria-busy", "false")
        assert grey_shown(view) == pytest.approx(grey_of(30), abs=3)


@pytest.mark.parametrize(("bits", "sentence"), [(12, "need 12 of 16 bits"), (14, "need 14 of 16 bits"), (16, None)])
def test_frames_of_16_bits(bits: int, sentence: str | None, chromium: Browser, tmp_path: Path):
    """The reader scales them by the bits that their values need; the page says so, and shows those that need all."""
    values = np.array([0.1, 0.5, 1]) * ((1 << bits) - 1)
    files = write_frames(tmp_path / "clip", values.astype(np.uint16))
    with opened(chromium, tmp_path / "site", write_model(tmp_path, len(files))) as view:
        view.open(*files)
        if sentence is None:
            expect(view.page.locator("input[value=clip]")).to_be_checked()
            view.seek(1)
            expect(view.page.locator("#frame")).to_have_attribute("aria-busy", "false")
            assert grey_shown(view) == pytest.approx(127.5, abs=2)
        else:
            view.expect_alert(sentence)
            expect(view.page.locator("input[value=clip]")).to_be_disabled()


def test_videos_have_the_times_of_the_clip(chromium: Browser, tmp_path: Path):
    times = [0, 0.1, 0.5, 0.55, 0.8]
    model = write_model(tmp_path, len(times), **{contract.META_TIMES: json.dumps(times)})
    write_frames(tmp_path / "clip", np.full(len(times), 90, np.uint8))
    with opened(chromium, tmp_path / "site", model, tmp_path / "clip") as view:
        view.click(20, 11)
        view.page.locator("#tools input[value=box]").check(force=True)
        view.drag((8, 6), (30, 18))
        for kind in ("video", "drawings"):
            with av.open(str(view.save(kind, tmp_path))) as container:
                saved = [frame.time for frame in container.decode(video=0)]
            np.testing.assert_allclose(saved, times, atol=2e-3)
