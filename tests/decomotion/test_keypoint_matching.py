"""Matches of keypoints by LightGlue: known shifts are found by either network, and only what agrees is trusted."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from decomotion.clip import Clip
from decomotion.data.links import keypoint_matching
from decomotion.data.links.config import MatchingConfig
from decomotion.data.links.keypoint_matching import KeypointMatcher, on_cells, raster_of
from decomotion.data.links.matching import MatchStore, build_matcher
from decomotion.errors import DownloadError, SupervisionError

SHARED = Path(os.environ.get("DECOMO_SHARED", Path(__file__).parents[3] / "shared")) / "weights"
FILES = {
    "xfeat": ("xfeat.pt", "xfeat-lighterglue.pt"),
    "aliked": ("aliked-n16.pth", "aliked_lightglue.pth"),
}
HEIGHT, WIDTH = 180, 320


def files(kind: str) -> tuple[str, ...]:
    found = tuple(str(SHARED / name) for name in FILES[kind])
    if not all(Path(file).is_file() for file in found):
        pytest.skip(f"no weights of {kind} in {SHARED}")
    return found


def frame_of_a_clip() -> Path:
    file = SHARED.parent / "data" / "davis480p" / "frames" / "camel" / "00000.jpg"
    if not file.is_file():
        pytest.skip(f"no {file}")
    return file


def textured(height: int, width: int) -> np.ndarray:
    random = np.random.default_rng(0)
    scales = [random.integers(0, 255, (height // cell, width // cell, 3), dtype=np.uint8) for cell in (6, 12, 30)]
    return np.mean(
        [cv2.resize(scale, (width, height), interpolation=cv2.INTER_CUBIC) for scale in scales], axis=0
    ).astype(np.uint8)


@pytest.mark.parametrize("kind", FILES)
def test_a_far_shift_is_found(kind: str, tmp_path: Path) -> None:
    """By 45 pixels to the right and 18 up, of a frame that is not square."""
    large = cv2.cvtColor(cv2.imread(str(frame_of_a_clip())), cv2.COLOR_BGR2RGB)
    first, second = (large[top : top + HEIGHT, left : left + WIDTH] for top, left in ((60, 100), (60 + 18, 100 - 45)))
    clip = Clip("shifted", np.stack([first, second]), 24.0)
    config = MatchingConfig(kind=kind, weights=files(kind), intervals=(1,), supporters=0)
    store = MatchStore(clip, config.intervals, build_matcher(config), tmp_path / "m")
    assert min(store.seconds(), 60) > 0
    store.compute(progress=False)
    for way, sign in (((0, 1), 1), ((1, 0), -1)):
        matches = store(*way)
        assert matches.trusted.shape == raster_of(HEIGHT, WIDTH) == (36, 64)
        assert matches.trusted.mean() > 0.1
        moved = np.median(matches.displacement[matches.trusted], axis=0) * WIDTH / 64
        assert_allclose(moved, [sign * 45, sign * -18], atol=0.5)
    assert not (tmp_path / "m" / "described").exists()


@pytest.mark.parametrize("kind", FILES)
def test_a_plain_frame_has_no_matches(kind: str) -> None:
    matcher = KeypointMatcher(kind, files(kind))
    plain, other = matcher.keypoints(np.full((90, 160, 3), 127, np.uint8)), matcher.keypoints(textured(90, 160))
    here, there = matcher.matched(plain, other)
    assert len(here) == len(there) < 10
    assert plain.size == other.size == {"xfeat": (768, 448), "aliked": (512, 288)}[kind]


def test_keypoints_are_in_units_with_pixel_centres_at_whole_numbers() -> None:
    """A frame of 256 x 144 units that was looked at in 512 x 256 pixels, a multiple of 32 that does not quite fit."""
    xy = torch.tensor([[255.5, 127.5], [-0.5, -0.5], [511.5, 255.5]])
    keypoints = keypoint_matching.Keypoints(xy, torch.zeros(3, 64), (512, 256), (256.0, 144.0))
    assert_allclose(keypoints.in_units(), [[127.5, 71.5], [-0.5, -0.5], [255.5, 143.5]])


class TestCells:
    """32 rows of 64 cells, 4 units each."""

    raster = (32, 64)

    def moved(self, here: list[tuple[float, float]], by: list[tuple[float, float]]):
        places = np.array(here, np.float32).reshape(-1, 2)
        return on_cells(places, places + np.array(by, np.float32).reshape(-1, 2), self.raster, (256.0, 128.0))

    def test_three_that_agree_are_trusted_where_they_are_near(self) -> None:
        matches = self.moved([(41, 21), (42, 22), (44, 20)], [(8, -4)] * 3)
        assert_allclose(matches.displacement[5, 10], [2, -1], atol=1e-6)
        assert matches.trusted[5, 10]
        near = np.argwhere(matches.trusted)
        assert np.abs(near * 4 + 1.5 - (21, 42)).max() < 7
        assert 2 <= len(near) <= 12

    def test_two_are_not_enough(self) -> None:
        assert not self.moved([(41, 21), (42, 22)], [(8, -4)] * 2).trusted.any()
        assert not self.moved([(41, 21), (42, 22), (200, 100)], [(8, -4)] * 3).trusted.any()

    def test_what_moved_otherwise_neither_supports_nor_counts(self) -> None:
        places = [(41.5, 21.5), (42, 22), (44, 20), (43, 21)]
        assert not self.moved(places, [(8, -4), (8, -4), (11, -4), (8, 0)]).trusted[5, 10]
        three = self.moved(places, [(8, -4), (8, -4), (8, -4), (80, 0)])
        assert three.trusted[5, 10]
        assert_allclose(three.displacement[5, 10], [2, -1], atol=1e-6)

    def test_nothing_is_trusted_without_matches(self) -> None:
        nothing = self.moved([], [])
        assert nothing.displacement.shape == (*self.raster, 2)
        assert not nothing.trusted.any()

    def test_cells_need_not_be_square(self) -> None:
        """2 rows of 3 cells over a frame of 256 x 100 units: 85.3 x 50 each, the last one's middle at (212.8, 74.5)."""
        here = np.array([(212, 74), (213, 75), (214, 74)], np.float32)
        matches = on_cells(here, here + np.array((-64, 25), np.float32), (2, 3), (256.0, 100.0))
        assert_allclose(matches.displacement[1, 2], [-0.75, 0.5], atol=1e-6)
        assert matches.trusted.tolist() == [[False] * 3, [False, False, True]]


class TestWeights:
    def test_the_order_of_the_files_does_not_matter(self) -> None:
        one, other = files("xfeat")
        frame = textured(96, 160)
        found = [KeypointMatcher("xfeat", given).keypoints(frame) for given in ((one, other), (other, one))]
        assert_allclose(found[0].xy, found[1].xy)

    @pytest.mark.parametrize(("given", "lacking"), [(0, "LightGlue for xfeat"), (1, "no file holds xfeat")])
    def test_one_file_is_not_enough(self, given: int, lacking: str) -> None:
        with pytest.raises(SupervisionError, match=lacking):
            KeypointMatcher("xfeat", files("xfeat")[given : given + 1])

    def test_those_of_another_network_are_refused(self) -> None:
        with pytest.raises(SupervisionError, match=r"--match-weights .* no file holds aliked"):
            KeypointMatcher("aliked", files("xfeat"))

    def test_without_a_network_it_is_said(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def failing(*_: object, **__: object) -> None:
            raise OSError("no route to host")

        monkeypatch.setattr(keypoint_matching.XFeat, "from_pretrained", failing)
        with pytest.raises(DownloadError, match="--match-weights, or take --matches sift"):
            KeypointMatcher("xfeat")
