"""Structure is the same in any light; likeness is what motion leads to, near 0 between scenes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomotion.data.likeness import StructureImage, likeness, structure_of
from decomotion.greys import small_grey

HEIGHT, WIDTH = 90, 140


def scene(seed: int) -> np.ndarray:
    """[2 HEIGHT, 2 WIDTH, 3], of soft shapes of three sizes."""
    chance = np.random.default_rng(seed)
    shapes = sum(
        cv2.resize(
            chance.normal(0, 25, (*cells, 3)).astype(np.float32), (2 * WIDTH, 2 * HEIGHT), interpolation=cv2.INTER_CUBIC
        )
        for cells in ((5, 8), (14, 22), (40, 62))
    )
    return np.clip(90 + shapes, 0, 255).astype(np.uint8)


def seen(frame: np.ndarray, x: int = 60, y: int = 40) -> StructureImage:
    """The view whose upper left corner is there."""
    structure = structure_of(small_grey(frame[y : y + HEIGHT, x : x + WIDTH]))
    assert structure is not None
    return structure


def test_light_leaves_it():
    frame = scene(0)
    for other in (frame // 2 + 100, frame // 6, 255 - (255 - frame) // 3, frame[..., ::-1]):
        assert likeness(seen(frame), seen(other)) > 0.8


def test_none_where_all_is_of_one_level():
    for level in (0, 90, 255):
        assert structure_of(small_grey(np.full((40, 30, 3), level, np.uint8))) is None
    assert structure_of(small_grey(np.zeros((1, 1, 3), np.uint8))) is None


@pytest.mark.parametrize("shape", [(1, 300), (300, 2), (7, 9), (480, 854)])
def test_any_size(shape: tuple[int, int]):
    frame = np.random.default_rng(0).integers(0, 255, (*shape, 3), dtype=np.uint8)
    structure = structure_of(small_grey(frame))
    assert structure is not None
    assert max(structure.image.shape) <= 160
    assert min(structure.image.shape) >= 24
    assert likeness(structure, structure) == 1


@pytest.mark.parametrize("shift", [(2, 0), (0, -7), (35, 0), (-40, 12)])
def test_motion_is_undone(shift: tuple[int, int]):
    frame = scene(0)
    assert likeness(seen(frame), seen(frame, 60 + shift[0], 40 + shift[1])) > 0.3


@pytest.mark.parametrize(("angle", "zoom"), [(25, 1.0), (0, 1.4), (-15, 0.8)])
def test_so_are_turns_and_zooms(angle: float, zoom: float):
    frame = scene(0)
    turn = cv2.getRotationMatrix2D((60 + WIDTH / 2, 40 + HEIGHT / 2), angle, zoom)
    turned = np.asarray(cv2.warpAffine(frame, turn, (2 * WIDTH, 2 * HEIGHT)), np.uint8)
    assert likeness(seen(frame), seen(turned)) > 0.2


def test_scenes_are_not_alike():
    assert max(likeness(seen(scene(seed)), seen(scene(seed + 1))) for seed in range(12)) < 0.03


def test_noise_in_a_flat_place_is_no_structure():
    """The left half is textured, the right one flat but for a grey level of noise."""
    random = np.random.default_rng(5)
    grey = np.full((60, 130), 90, np.float32) + random.normal(0, 1, (60, 130)).astype(np.float32)
    grey[:, :65] += 40 * cv2.GaussianBlur(random.normal(0, 1, (60, 65)).astype(np.float32), (0, 0), 1.0)
    structure = structure_of(grey)
    assert structure is not None
    textured, flat = (structure.image[:, part].std() for part in (slice(0, 45), slice(100, 130)))
    assert textured > 30
    assert flat < 0.5 * textured
