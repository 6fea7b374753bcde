"""Motion masks: what moves is found, what only looks as if it moved is not, and what does not fit the clip is named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from decomotion.data.masks.auto import moves_at, moving_probability, rendered
from decomotion.data.masks.folder import read_masks
from decomotion.data.pool import grid_shape, jittered_grid
from decomotion.errors import SupervisionError

FRAMES, HEIGHT, WIDTH, COUNT = 8, 96, 128, 3072
CENTRE = np.array([64.0, 48.0])

Move = Callable[[np.ndarray, float], np.ndarray]
"""Where points [point, 2] lie so many frames later."""


def square(frame: int) -> np.ndarray:
    """A square that goes down, [H, W]."""
    inside = np.zeros((HEIGHT, WIDTH), np.bool_)
    inside[20 + 4 * frame : 48 + 4 * frame, 40:72] = True
    return inside


def pan(xy: np.ndarray, frames: float) -> np.ndarray:
    return xy + np.array([-2.0, 0.5]) * frames


def zoom(xy: np.ndarray, frames: float) -> np.ndarray:
    return (xy - CENTRE) * 1.01**frames + CENTRE


def stand(xy: np.ndarray, frames: float) -> np.ndarray:
    del frames
    return xy


def sink(xy: np.ndarray, frames: float) -> np.ndarray:
    return xy + np.array([0.0, 4.0]) * frames


def near(xy: np.ndarray, frames: float) -> np.ndarray:
    """As `pan`, seen from a camera that moves sideways, at a third of the distance."""
    return xy + 3 * np.array([-2.0, 0.5]) * frames


def scene(
    move: Move, layer: Move | None = None, where: Callable[[int], np.ndarray] = square
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Frames, points, targets and confidence of a textured scene, with a second layer in front of it."""
    random = np.random.default_rng(0)
    textures = [cv2.GaussianBlur(random.normal(size=(HEIGHT, WIDTH, 3)), (0, 0), 1.5) * 200 + 128 for _ in range(2)]
    points = jittered_grid(FRAMES, HEIGHT, WIDTH, COUNT, random)
    targets = np.empty((FRAMES, FRAMES, points.shape[1], 2), np.float32)
    pixels = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).reshape(-1, 2).astype(float)
    covered = [np.zeros((HEIGHT, WIDTH), np.bool_) if layer is None else where(i) for i in range(FRAMES)]
    frames, on_layer = [], np.empty(points.shape[:2], np.bool_)
    for i in range(FRAMES):
        back, front = (
            _drawn(texture, how(pixels, -i)) for texture, how in zip(textures, (move, layer or move), strict=True)
        )
        frames.append(np.where(covered[i][..., None], front, back))
        on_layer[i] = _at(covered[i], points[i])
        for j in range(FRAMES):
            targets[i, j] = np.where(on_layer[i, :, None], (layer or move)(points[i], j - i), move(points[i], j - i))
    x, y = targets[..., 0], targets[..., 1]
    inside = (x > -0.5) & (y > -0.5) & (x < WIDTH - 0.5) & (y < HEIGHT - 0.5)
    hidden = np.stack([_at(covered[j], targets[:, j]) for j in range(FRAMES)], axis=1) & ~on_layer[:, None]
    targets += random.normal(scale=0.1, size=targets.shape).astype(np.float32)
    return np.clip(frames, 0, 255).astype(np.uint8), points, targets, (255 * (inside & ~hidden)).astype(np.uint8)


def _at(mask: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """A mask [H, W] at the pixels nearest to `xy` [..., 2], inside."""
    x, y = np.moveaxis(np.clip(np.round(xy), 0, (WIDTH - 1, HEIGHT - 1)).astype(int), -1, 0)
    return mask[y, x]


def _drawn(texture: np.ndarray, xy: np.ndarray) -> np.ndarray:
    where = xy.reshape(HEIGHT, WIDTH, 2).astype(np.float32)
    return cv2.remap(texture, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)  # type: ignore[call-overload]


def masks_of(frames: np.ndarray, points: np.ndarray, targets: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    linked, sides = (points, targets, confidence, grid_shape(HEIGHT, WIDTH, COUNT)), (HEIGHT, WIDTH)
    return rendered(moving_probability(frames, *linked, sides, np.random.default_rng(0)), sides)


@pytest.mark.parametrize("camera", [pan, zoom, stand])
def test_what_moves_is_found_whatever_the_camera_does(camera: Move):
    masks = masks_of(*scene(camera, sink))
    truth = np.stack([square(frame) for frame in range(FRAMES)])
    assert masks.shape == truth.shape
    # the grid's cells are 2 pixels
    assert (masks & truth).sum() / (masks | truth).sum() > 0.85


@pytest.mark.parametrize("camera", [pan, zoom, stand])
def test_where_nothing_moves_masks_are_empty(camera: Move):
    assert not masks_of(*scene(camera)).any()


def test_parallax_is_not_motion():
    """A near plane at the bottom passes faster than the far one; nothing moves by itself."""

    def ground(_: int) -> np.ndarray:
        return np.repeat(np.arange(HEIGHT)[:, None] > 60, WIDTH, axis=1)

    assert masks_of(*scene(pan, near, ground)).mean() < 0.01


def test_one_object_over_half_of_the_image_is_not_taken_for_the_scene():
    def large(frame: int) -> np.ndarray:
        inside = np.zeros((HEIGHT, WIDTH), np.bool_)
        inside[12:84, 12 + frame : 108 + frame] = True
        return inside

    def shake(xy: np.ndarray, frames: float) -> np.ndarray:
        return xy + np.array([1.0, 0.0]) * frames

    masks = masks_of(*scene(pan, shake, large))
    truth = np.stack([large(frame) for frame in range(FRAMES)])
    assert (masks & truth).sum() / (masks | truth).sum() > 0.8


def test_flow_gone_astray_in_plain_places_is_not_motion():
    """Correspondences of a plain wall slide along it: nothing in the image says that it moved."""
    frames, points, targets, confidence = scene(stand)
    wall = (points[..., 0] > 40) & (points[..., 0] < 80)
    frames[:, :, 36:84] = 128
    targets += np.where(wall[:, None, :, None], np.array([0.0, 3.0]) * (np.arange(FRAMES) - 3)[None, :, None, None], 0)
    assert masks_of(frames, points, targets.astype(np.float32), confidence).mean() < 0.03


def test_without_correspondences_nothing_moves():
    frames, points, targets, confidence = scene(pan, sink)
    assert not masks_of(frames, points, targets, np.zeros_like(confidence)).any()


def test_hidden_correspondences_say_nothing():
    frames, points, targets, confidence = scene(pan, sink)
    hidden = np.random.default_rng(1).random(confidence.shape) < 0.4
    hidden[range(FRAMES), range(FRAMES)] = False
    confidence[hidden] = 0
    targets[hidden] = 1e3
    masks = masks_of(frames, points, targets, confidence)
    truth = np.stack([square(frame) for frame in range(FRAMES)])
    assert (masks & truth).sum() / (masks | truth).sum() > 0.85


def test_the_same_again():
    contents = scene(pan, sink)
    np.testing.assert_array_equal(masks_of(*contents), masks_of(*contents))


def test_points_are_told_as_masks_are_drawn():
    """But for those within a pixel of an outline, which is drawn in whole pixels."""
    random = np.random.default_rng(0)
    probability, sides = random.random((1, 6, 10), dtype=np.float32), (60, 80)
    xy = random.uniform((0, 0), (79, 59), (500, 2)).astype(np.float32)
    x, y = np.round(xy).astype(int).T
    drawn = rendered(probability, sides)[0]
    plain = cv2.blur(drawn.astype(np.float32), (3, 3))[y, x]
    inside = (plain < 0.01) | (plain > 0.99)
    assert inside.mean() > 0.5
    np.testing.assert_array_equal(moves_at(probability[0], xy, sides)[inside], drawn[y, x][inside])


def write(folder: Path, masks: dict[str, np.ndarray]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, mask in masks.items():
        cv2.imwrite(str(folder / name), mask)
    return folder


def blank(*spots: tuple[int, int], height: int = 4, width: int = 6) -> np.ndarray:
    mask = np.zeros((height, width, 3), np.uint8)
    for spot in spots:
        mask[spot] = (0, 0, 7)
    return mask


def read(folder: Path, frames: int, height: int, width: int) -> np.ndarray:
    return np.stack(list(read_masks(folder, frames, height, width)))


class TestRead:
    def test_any_pixel_that_is_not_black_moves(self, tmp_path: Path):
        masks = read(write(tmp_path, {"0.png": blank((1, 2)), "1.png": blank()}), 2, 4, 6)
        assert masks.dtype == np.bool_
        assert np.argwhere(masks).tolist() == [[0, 1, 2]]

    def test_natural_order(self, tmp_path: Path):
        names = ("frame10.png", "frame9.png", "frame1.png")
        write(tmp_path, {name: blank((0, index)) for index, name in enumerate(names)})
        assert np.argwhere(read(tmp_path, 3, 4, 6))[:, 2].tolist() == [2, 1, 0]

    def test_names_that_clips_may_have_too(self, tmp_path: Path):
        write(tmp_path, {"2²1.png": blank((0, 0)), "2²2.png": blank((0, 1))})
        (tmp_path / "._2²1.png").write_bytes(b"what macOS leaves beside a copied file")
        assert np.argwhere(read(tmp_path, 2, 4, 6))[:, 2].tolist() == [0, 1]

    def test_grey_images(self, tmp_path: Path):
        write(tmp_path, {"0.png": blank((3, 5)).max(axis=-1)})
        assert read(tmp_path, 1, 4, 6).sum() == 1

    def test_labels_of_16_bits(self, tmp_path: Path):
        labels = np.zeros((4, 6), np.uint16)
        labels[2, 3] = 1
        cv2.imwrite(str(tmp_path / "0.png"), labels)
        assert np.argwhere(read(tmp_path, 1, 4, 6)[0]).tolist() == [[2, 3]]

    def test_palettes_as_of_davis(self, tmp_path: Path):
        drawn = np.zeros((4, 6), np.uint8)
        drawn[0, 1], drawn[2, 3] = 1, 2
        image = Image.fromarray(drawn, mode="P")
        image.putpalette([0, 0, 0, 128, 0, 0, 0, 128, 0])
        image.save(tmp_path / "0.png")
        np.testing.assert_array_equal(read(tmp_path, 1, 4, 6)[0], drawn > 0)

    def test_the_ringing_of_a_jpeg_is_black(self, tmp_path: Path):
        drawn = np.zeros((32, 32), np.uint8)
        drawn[8:21, 11:24] = 255
        cv2.imwrite(str(tmp_path / "0.jpg"), drawn, [cv2.IMWRITE_JPEG_QUALITY, 70])
        np.testing.assert_array_equal(read(tmp_path, 1, 32, 32)[0], drawn > 0)

    def test_masks_that_are_all_black_are_said(self, tmp_path: Path, caplog: pytest.LogCaptureFixture):
        write(tmp_path, {"0.png": np.zeros((4, 6, 3), np.uint8), "1.png": np.zeros((4, 6, 3), np.uint8)})
        assert not read(tmp_path, 2, 4, 6).any()
        assert "are black: nothing moves" in caplog.text

    def test_absent(self, tmp_path: Path):
        with pytest.raises(SupervisionError, match="nowhere does not exist"):
            read(tmp_path / "nowhere", 2, 4, 6)

    def test_another_number(self, tmp_path: Path):
        with pytest.raises(SupervisionError, match="has 1 images but the clip has 2 frames"):
            read(write(tmp_path, {"0.png": blank()}), 2, 4, 6)

    def test_another_size_is_named(self, tmp_path: Path):
        write(tmp_path, {"0.png": blank(), "1.png": blank(height=5)})
        with pytest.raises(SupervisionError, match=r"1\.png is 6x5 but the clip is 6x4"):
            read(tmp_path, 2, 4, 6)

    def test_undecodable_is_named(self, tmp_path: Path):
        write(tmp_path, {"0.png": blank()})
        (tmp_path / "1.png").write_bytes(b"no image")
        with pytest.raises(SupervisionError, match=r"1\.png does not decode"):
            read(tmp_path, 2, 4, 6)
