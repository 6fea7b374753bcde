"""Flow between two frames: its unit is a pixel of its own raster."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decomotion.config import FlowConfig, load
from decomotion.data.flow import DisFlow

SHIFT = (3, -2)


def shifted_texture(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Two frames; what is at (x, y) in the first is at (x, y) + SHIFT in the second."""
    noise = cv2.GaussianBlur(np.random.default_rng(0).random((height + 10, width + 10, 3)), (0, 0), 2)
    texture = (255 * (noise - noise.min()) / np.ptp(noise)).astype(np.uint8)
    dx, dy = SHIFT
    return texture[5 : 5 + height, 5 : 5 + width], texture[5 - dy : 5 - dy + height, 5 - dx : 5 - dx + width]


def config(**changes: int) -> FlowConfig:
    return load("cpu").data.flow.model_copy(update=changes)


@pytest.mark.parametrize(("height", "width"), [(64, 96), (75, 50)])
def test_a_shift_is_found(height: int, width: int):
    field = DisFlow(config())(*shifted_texture(height, width))
    assert field.shape == (height, width, 2)
    assert field.dtype == np.float32
    # what DIS reaches on a clean texture
    np.testing.assert_allclose(np.median(field, axis=(0, 1)), SHIFT, atol=0.05)


@pytest.mark.parametrize(("height", "width"), [(64, 96), (96, 64), (50, 99)])
def test_a_coarser_raster_has_larger_pixels(height: int, width: int):
    field = DisFlow(config(field_side=48))(*shifted_texture(height, width))
    shrink = np.array([field.shape[1] / width, field.shape[0] / height])
    assert max(field.shape) == 48
    np.testing.assert_allclose(np.median(field, axis=(0, 1)), SHIFT * shrink, atol=0.02)
