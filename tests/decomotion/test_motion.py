"""Labels of points from masks."""

import numpy as np

from decomotion.clip import Clip
from decomotion.data.motion import closed_form, moving_at
from decomotion.data.pool import RIM

SIDE = 64


def every_pixel(frames: int) -> np.ndarray:
    y, x = np.mgrid[:SIDE, :SIDE]
    return np.repeat(np.stack([x, y], axis=-1).reshape(1, -1, 2).astype(np.float32), frames, axis=0)


def test_the_rim_is_what_lies_within_its_width_of_a_mask():
    masks = np.zeros((2, SIDE, SIDE), np.bool_)
    masks[0, 20:30, 10:40] = True  # nothing moves in the second frame
    moving = moving_at(every_pixel(2), masks, rim=10.0).reshape(2, SIDE, SIDE)  # 2.5 pixels of this clip
    np.testing.assert_array_equal(moving == 1, masks)
    inside = np.argwhere(masks[0])
    distance = np.linalg.norm(np.argwhere(~masks[0])[:, None] - inside, axis=-1).min(axis=1)
    np.testing.assert_array_equal(moving[0][~masks[0]] == RIM, distance <= 2.5)
    assert (moving[1] == 0).all()


def test_without_a_rim():
    masks = np.zeros((1, SIDE, SIDE), np.bool_)
    masks[0, 20:30, 10:40] = True
    np.testing.assert_array_equal(moving_at(every_pixel(1), masks).reshape(masks.shape), masks)


def test_camera_and_object_are_those_of_scene_and_masks_without_the_rim():
    """The scene moves by one pixel, what moves by three, the rim with the scene."""
    points = every_pixel(2)
    column = points[0, :, 0]
    moving = np.repeat(np.select([column < 30, column < 34], [1, RIM], 0).astype(np.uint8)[None], 2, axis=0)
    step = np.where(moving == 1, 3.0, 1.0)[..., None] * np.array([1.0, 0.0])
    targets = np.stack([[points[0], points[0] + step[0]], [points[1] - step[1], points[1]]]).astype(np.float32)
    confidence = np.full((2, 2, SIDE**2), 255, np.uint8)
    clip = Clip("rim", np.zeros((2, SIDE, SIDE, 3), np.uint8), 24.0)
    scene, its = closed_form(clip, points, targets, confidence, moving)
    for maps, pixels in ((scene, 1), (its, 3)):
        shift = maps[0, :, 2] - maps[1, :, 2]
        np.testing.assert_allclose(shift, [2 * pixels / SIDE, 0], atol=1e-3)
