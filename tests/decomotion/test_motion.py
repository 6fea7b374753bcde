"""The stage of what moves: which points the camera's and the object's maps are fitted to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from decomotion.data.motion import build_motion, closed_form
from decomotion.data.pool import open_pool
from decomotion.data.positions import pack
from decomotion.units import to_units

FRAMES, HEIGHT, WIDTH = 5, 40, 64
SCENE, OBJECT = np.array([1.0, -0.5]), np.array([-2.0, 1.5])
"""Pixels a frame."""


def moved(points: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points, targets, confidence, and which move: every third. Of links without confidence nothing is true."""
    random = np.random.default_rng(0)
    xy = random.uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (FRAMES, points, 2)).astype(np.float32)
    moving = np.tile((np.arange(points) % 3 == 0).astype(np.uint8), (FRAMES, 1))
    gap = (np.arange(FRAMES)[None] - np.arange(FRAMES)[:, None])[..., None, None]
    targets = (xy[:, None] + gap * np.where(moving[0, :, None], OBJECT, SCENE)).astype(np.float32)
    confidence = np.full(targets.shape[:3], 200, np.uint8)
    confidence[:, :, 30:] = 0
    targets[:, :, 30:] += random.uniform(-9, 9, targets[:, :, 30:].shape)
    targets[:, :, 30:45] += 5
    return xy, targets, confidence, moving


def shifts(maps: np.ndarray) -> np.ndarray:
    """Of affine maps that only shift, in pixels: normalised by half of the longer side."""
    np.testing.assert_allclose(maps[:, :, :2], np.tile(np.eye(2), (FRAMES, 1, 1)), atol=1e-4)
    return maps[:, :, 2] * WIDTH / 2


def test_scene_and_object_have_their_own_motion_to_the_middle_frame():
    of_scene, of_object = closed_form((HEIGHT, WIDTH), *moved())
    gap = (FRAMES // 2 - np.arange(FRAMES))[:, None]
    np.testing.assert_allclose(shifts(of_scene), gap * SCENE, atol=1e-3)
    np.testing.assert_allclose(shifts(of_object), gap * OBJECT, atol=1e-3)


@pytest.mark.parametrize("everywhere", [0, 1])
def test_where_no_object_is_seen_it_moves_as_the_scene_and_a_scene_that_is_not_seen_stands(everywhere: int):
    points, targets, confidence, moving = moved()
    confidence[:, :, moving[0] != everywhere] = 0
    of_scene, of_object = closed_form((HEIGHT, WIDTH), points, targets, confidence, np.full_like(moving, everywhere))
    gap = (FRAMES // 2 - np.arange(FRAMES))[:, None]
    np.testing.assert_allclose(shifts(of_scene), gap * (SCENE if everywhere == 0 else 0 * SCENE), atol=1e-3)
    np.testing.assert_allclose(shifts(of_object), gap * (SCENE if everywhere == 0 else OBJECT), atol=1e-3)


def test_unknown_motion_counts_for_both():
    points, targets, confidence, moving = moved()
    confidence[:, :, moving[0] == 1] = 0
    of_scene, of_object = closed_form((HEIGHT, WIDTH), points, targets, confidence, np.full_like(moving, 2))
    np.testing.assert_allclose(shifts(of_object), shifts(of_scene), atol=1e-3)
    np.testing.assert_allclose(shifts(of_scene)[0], 2 * SCENE, atol=1e-3)


@pytest.mark.parametrize("finer", [1, 2])
def test_masks_are_read_at_the_nearest_pixel(finer: int, tmp_path: Path):
    """Of frames 0 and 3, in masks as large as the clip and twice as large."""
    points, targets, confidence, _ = moved(60)
    points[0, :3], points[3, :3] = [[4.4, 0.6], [3.4, 1.0], [4.0, 1.6]], [[0.2, 2.7], [0.6, 3.0], [4.0, 1.0]]
    masks = np.zeros((FRAMES, HEIGHT, WIDTH), np.bool_)
    masks[0, 1, 4] = masks[3, 3, 0] = True
    masks = masks.repeat(finer, 1).repeat(finer, 2)
    build_motion((HEIGHT, WIDTH), points, targets, confidence, masks, None, np.random.default_rng(0), tmp_path)
    moving = np.load(tmp_path / "moving.npy")
    assert moving[[0, 3], :3].tolist() == [[1, 0, 0]] * 2


@pytest.mark.parametrize(
    ("kind", "values", "share"), [("none", {2}, None), ("given", {0, 1}, 0.75), ("found", {0, 1}, 0.75)]
)
def test_what_the_stage_leaves(kind: str, values: set[int], share: float | None, tmp_path: Path):
    points, targets, confidence, _ = moved(60)
    points[..., 0] = np.where(np.arange(60) < 15, 8, 50)
    masks = np.broadcast_to(np.arange(WIDTH) > 31, (FRAMES, HEIGHT, WIDTH)) if kind == "given" else None
    likely = np.broadcast_to(np.float32(np.arange(10) > 4), (FRAMES, 6, 10)) if kind == "found" else None
    random = np.random.default_rng(0)
    facts = build_motion((HEIGHT, WIDTH), points, targets, confidence, masks, likely, random, tmp_path)
    assert facts == {"moving": share}
    assert set(np.unique(np.load(tmp_path / "moving.npy"))) == values
    assert np.load(tmp_path / "camera.npy").shape == np.load(tmp_path / "object.npy").shape == (FRAMES, 2, 3)


def test_the_structure_is_that_of_what_stands_still(tmp_path: Path):
    """Of ten frames of twice the points: the pool opens it, and it goes where the scene goes."""
    random = np.random.default_rng(4)
    frames, points = 10, 200
    xy = random.uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (frames, points, 2)).astype(np.float32)
    gap = (np.arange(frames)[None] - np.arange(frames)[:, None])[..., None, None]
    right = np.arange(points) < points // 2
    xy[..., 0] = np.where(right, 40 + xy[..., 0] / 3, xy[..., 0] / 2)
    targets = (xy[:, None] + gap * np.where(right[:, None], OBJECT, SCENE)).astype(np.float32)
    confidence = np.full(targets.shape[:3], 200, np.uint8)
    masks = np.broadcast_to(np.arange(WIDTH) > 35, (frames, HEIGHT, WIDTH))
    build_motion((HEIGHT, WIDTH), xy, targets, confidence, masks, None, random, tmp_path)
    for name, array in (("points", xy), ("targets", pack(targets, WIDTH)), ("confidence", confidence)):
        np.save(tmp_path / f"{name}.npy", array)
    np.save(tmp_path / "rgb.npy", np.zeros((frames, points, 3), np.uint8))
    np.save(tmp_path / "feature.npy", np.zeros((frames, points, 0), np.float16))
    structure = open_pool([tmp_path], WIDTH).structure
    assert structure is not None
    found = structure.expected(np.int64([2]), np.int64([8]), np.arange(points)).xy.numpy()
    there = to_units(targets[2, 8], HEIGHT, WIDTH)
    assert np.median(np.linalg.norm(found - there, axis=-1)[~right]) < 0.1
    assert structure.agreement[:, ~right].mean() > 0.9 > structure.agreement[:, right].mean()
