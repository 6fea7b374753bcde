"""The page on a real clip and a small fit of it: masked, corrected and refitted, drawn on. In Chromium."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from decomo_runtime import Tracker, propagate_files
from decomo_runtime.propagation.regions import without_specks
from decomo_runtime.view.refit import Refits

pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
from playwright.sync_api import expect

from view_page import ViewPage, opened

if TYPE_CHECKING:
    from playwright.sync_api import Browser

NAME, FRAMES, WIDTH, HEIGHT = "camel", 34, 192, 108
"""Of DAVIS: a camel walks, and the camera follows."""
QUICK = (
    "data.matching.intervals=[]",
    "data.flow={kind: dis, field_side: 512, intervals: [1, 4], longest_interval: 16, upsample: 2, max_side: 96, "
    "patch_stride: 3, descent_iterations: 25, refinement_iterations: 10, gradient_weight: 10}",
    "data.pool.points_per_frame=1024",
)
STEPS = 180
REFIT = (
    "import sys; from decomotion.cli import main; at = sys.argv.index('--time-budget'); "
    "sys.argv[at : at + 2] = ['--steps', '60']; sys.exit(main(sys.argv[1:]))"
)
"""`decomo-train` with so many steps in place of its time, which on a busy machine are few."""
BLUE = (20, 60, 255)

REFIT_PATIENCE = 400_000
"""Milliseconds; of a model that is none of a few sums."""

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Fit:
    """A clip, what is known of it, and a small fit."""

    clip: Path
    run: Path
    model: Path
    xy: npt.NDArray[np.float64]
    """[N, T, 2], TAP-Vid's tracks, in pixels of the clip."""
    seen: npt.NDArray[np.bool_]
    """[N, T], where they are annotated and in sight."""
    masks: list[npt.NDArray[np.bool_]]
    """DAVIS's, [H, W] for each frame."""

    @property
    def queries(self) -> npt.NDArray[np.float64]:
        """[N, 3], each point in the first frame that shows it."""
        first = self.seen.argmax(axis=1)
        return np.column_stack([first, self.xy[np.arange(len(first)), first]])

    def errors(self, xy: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        """[N, T], of tracks of the queries; NaN where the truth is not known."""
        return np.where(self.seen, np.linalg.norm(xy - self.xy, axis=-1), np.nan)


def picture(content: bytes) -> npt.NDArray[np.uint8]:
    """As OpenCV has it."""
    decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded is not None
    return decoded.astype(np.uint8, copy=False)


def mask(content: bytes, size: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """[H, W], what is not 0 in a file, brought to a size (width, height)."""
    labels = picture(content)
    labels = labels if labels.ndim == 2 else labels.max(axis=2)
    return cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST) > 0


@pytest.fixture(scope="module")
def fit(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Fit:
    from decomo_export.cli import main as export
    from decomotion.cli import main as train

    data, folder = shared / "data" / "davis480p", tmp_path_factory.mktemp("fit")
    clip, run, model = folder / NAME, folder / "run", folder / f"{NAME}.onnx"
    clip.mkdir()
    for file in sorted((data / "frames" / NAME).iterdir())[:FRAMES]:
        small = cv2.resize(picture(file.read_bytes()), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(clip / f"{file.stem}.png"), small)
    settings = [part for each in QUICK for part in ("--set", each)]
    assert train([str(clip), "--preset", "cpu", "--steps", str(STEPS), "--out", str(run), *settings]) == 0
    assert export([str(model), "--run", str(run)]) == 0
    with np.load(data / "annotations.npz") as annotations:
        xy = annotations[f"{NAME}/first32/points"][:, :FRAMES] * (WIDTH, HEIGHT) - 0.5
        seen = ~annotations[f"{NAME}/first32/occluded"][:, :FRAMES]
    masks = [mask(file.read_bytes(), (WIDTH, HEIGHT)) for file in sorted((data / "masks" / NAME).iterdir())]
    return Fit(clip, run, model, xy.astype(np.float64), seen, masks)


@pytest.fixture(scope="module")
def shared_view(chromium: Browser, fit: Fit, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewPage]:
    def refits(site: Path) -> Refits:
        return Refits(site, fit.clip, fit.run, fit.model, train=(sys.executable, "-c", REFIT))

    size = {"width": 700, "height": 600}
    with opened(chromium, tmp_path_factory.mktemp("site"), fit.model, fit.clip, refits, viewport=size) as view:
        yield view


@pytest.fixture
def view(shared_view: ViewPage) -> ViewPage:
    """The page as it is when opened."""
    shared_view.page.reload()
    shared_view.wait_until_open()
    expect(shared_view.page.locator("#frame")).to_have_attribute("aria-busy", "false")
    return shared_view


def choose(view: ViewPage, tool: str) -> None:
    view.page.locator(f"#tools input[value={tool}]").check(force=True)


def overlap(one: npt.NDArray[np.bool_], other: npt.NDArray[np.bool_]) -> float:
    return float((one & other).sum() / (one | other).sum())


def put(view: ViewPage, row: int, shown: npt.NDArray[np.floating], target: npt.NDArray[np.floating]) -> None:
    """Drags the point of a row from where it is `shown`, [N, 2], or clicks at the target if that or another is near."""
    others = np.vstack([np.delete(shown, row, axis=0), target])
    if np.linalg.norm(others - shown[row], axis=1).min() > 8:
        view.drag(tuple(shown[row].tolist()), tuple(target.tolist()))
        return
    view.rows.nth(row).locator("input[type=text]").focus()
    view.page.locator("#place").click()
    across, down = view.on_stage(*target.tolist())
    view.stage.click(position={"x": across, "y": down})


def test_a_mask_is_carried_as_decomo_propagate_carries_it(view: ViewPage, fit: Fit, tmp_path: Path):
    frame = 12
    cv2.imwrite(str(tmp_path / "first.png"), fit.masks[0].astype(np.uint8))
    view.page.locator("#mask-file").set_input_files(str(tmp_path / "first.png"))
    expect(view.page.locator("#drawings li")).to_have_count(1)
    view.seek(frame)
    y, x = (int(np.median(each)) for each in np.nonzero(fit.masks[frame]))
    choose(view, "box")
    view.wait_until_answered(REFIT_PATIENCE)  # it is known finely
    view.drag((x - 1, y - 1), (x + 1, y + 1))  # the mask of this frame begins as it is carried here
    expect(view.page.locator("#drawings li .go")).to_have_count(2)
    with zipfile.ZipFile(view.save("masks.zip", tmp_path)) as archive:
        of_page = mask(archive.read(f"{frame:05d}.png"), (WIDTH, HEIGHT))
    propagate_files(Tracker(fit.model, threads=1), [(tmp_path / "first.png", 0)], tmp_path / "out", clip=fit.clip)
    of_command = mask((tmp_path / "out" / f"{frame:05d}.png").read_bytes(), (WIDTH, HEIGHT))
    assert overlap(of_page, of_command) > 0.83  # 0.81 without looks
    assert overlap(of_page, fit.masks[frame]) > overlap(of_command, fit.masks[frame]) - 0.1
    assert (of_page & ~without_specks(of_page)).sum() < 0.01 * of_page.sum()


def test_corrected_tracks_are_nearer_to_the_annotation_after_a_refit_and_what_is_drawn_moves_with_them(
    view: ViewPage, fit: Fit, tmp_path: Path
):
    rows = np.flatnonzero(fit.seen[:, 0] & fit.seen[:, 30])
    known, given = np.arange(1, 32), [16, 31]
    tracker = Tracker(fit.model, threads=1)
    before = fit.errors(tracker.track(fit.queries).xy)[rows]
    view.page.locator("#trails").fill("0")
    for row in rows:
        view.click(*fit.xy[row, 0].tolist())
    for frame in given:
        view.seek(frame)
        shown = view.tracks(tmp_path).xy[:, frame]
        for row, target in enumerate(fit.xy[rows, frame]):
            put(view, row, shown, target)
            shown[row] = target
    expect(view.page.locator("#correction-count")).to_have_text(str(len(given) * len(rows)))
    view.page.locator("#refit-begin").click()
    expect(view.page.locator("#refit-take")).to_be_visible(timeout=REFIT_PATIENCE)
    view.page.locator("#refit-take").click()
    expect(view.page.locator("#refit-said")).to_contain_text("Taken: the run is")
    view.page.get_by_label("Clear the corrections").click()
    after = np.where(fit.seen[rows], np.linalg.norm(view.tracks(tmp_path).xy - fit.xy[rows], axis=-1), np.nan)
    others = np.setdiff1d(known, given)
    assert np.nanmean(after[:, others]) < 0.6 * np.nanmean(before[:, others])
    followed = rows[after[:, 30] < 3]
    assert len(followed) >= 3
    view.clear()

    view.seek(0)
    choose(view, "brush")
    view.page.locator("#draw-colour").fill("#{:02x}{:02x}{:02x}".format(*BLUE))
    view.page.locator("#draw-size").fill("13")
    for x, y in fit.xy[followed, 0].tolist():
        view.drag((x - 1, y), (x + 1, y))
    view.seek(30)

    def blue() -> npt.NDArray[np.bool_]:
        shown = cv2.resize(view.pixels(), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(int)
        return np.abs(shown - BLUE).max(axis=2) < 60

    x, y = np.rint(fit.xy[followed, 30]).astype(int).T
    view.wait_until_answered(REFIT_PATIENCE)
    assert blue()[y, x].all(), blue()[y, x]
    assert blue().mean() < 0.02 * len(followed)
