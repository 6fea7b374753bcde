"""Batches: what is drawn, from where, and how often."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from decomotion.config import load
from decomotion.data.batch import Batch, Sampler
from decomotion.data.pool import UNKNOWN_MOTION, Pool
from decomotion.data.structure import Structure
from decomotion.schedule import OptimConfig

FRAMES, POINTS = 6, 40


def make_pool(**changes: Any) -> Pool:
    """Arrays whose values say where they come from."""
    frame, point = np.mgrid[:FRAMES, :POINTS].astype(np.float32)
    source, target, there = np.mgrid[:FRAMES, :FRAMES, :POINTS].astype(np.float32)
    arrays = {
        "points": np.stack([frame, point], axis=-1),
        "targets": np.stack([10 * source + target, there], axis=-1),
        "confidence": (there + 100).astype(np.uint8),
        "rgb": np.stack([frame, point, 0 * point], axis=-1).astype(np.uint8),
        "feature": np.stack([point, frame], axis=-1).astype(np.float16),
        "moving": (point % 2).astype(np.uint8),
        "camera": np.zeros((FRAMES, 2, 3), np.float32),
        "object": np.zeros((FRAMES, 2, 3), np.float32),
        "longer_side": 256,
    }
    return Pool(**(arrays | changes))


def config(**changes: Any) -> OptimConfig:
    plain = {
        "pairs": 50,
        "points": 30,
        "hard_mining": 0.0,
        "count_maps": False,
        "candidates": 1,
        "moving_share": 0.0,
        "hidden_share": 0.0,
    }
    return load("cpu").optim.model_copy(update=plain | changes)


def draw(sampler: Sampler, longest_gap: int, seed: int = 0) -> Batch:
    return sampler.draw(longest_gap, torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("longest_gap", [1, 2, 5])
def test_pairs_are_two_frames_of_the_clip_within_the_longest_gap(longest_gap: int):
    batch = draw(Sampler(make_pool(), config(pairs=500)), longest_gap)
    gap = (batch.target_frame - batch.frame).abs()
    assert gap.min() >= 1
    assert gap.max() == longest_gap
    for frame in (batch.frame, batch.target_frame):
        assert sorted(frame.unique().tolist()) == list(range(FRAMES))
    assert (batch.target_frame > batch.frame).any()
    assert (batch.target_frame < batch.frame).any()


def test_at_the_clip_s_ends_a_pair_keeps_its_gap_and_turns_round():
    batch = draw(Sampler(make_pool(), config(pairs=6000)), 5)
    gap = (batch.target_frame - batch.frame)[batch.frame == 0]
    # 1000 pairs: a standard deviation of 0.013
    torch.testing.assert_close(gap.bincount()[1:] / len(gap), torch.full((5,), 0.2), rtol=0, atol=0.05)


def test_a_gap_that_there_is_room_for_on_neither_side_becomes_a_step_across_the_middle():
    """Of six frames the two in the middle have none four or five away: two of five gaps lead to each other instead."""
    batch = draw(Sampler(make_pool(), config(pairs=12_000)), 5)
    # a step, or two, of either direction: 0.1 each; three where there is but one way: 0.2
    for frame, expected in ((2, [0.1, 0.1, 0.0, 0.5, 0.1, 0.2]), (3, [0.2, 0.1, 0.5, 0.0, 0.1, 0.1])):
        reached = batch.target_frame[batch.frame == frame].bincount(minlength=FRAMES)
        # 2000 pairs: a standard deviation of 0.011
        torch.testing.assert_close(reached / reached.sum(), torch.tensor(expected), rtol=0, atol=0.05)


def test_a_clip_of_two_frames():
    two = {name: value[:2] if isinstance(value, np.ndarray) else value for name, value in vars(make_pool()).items()}
    two |= {name: two[name][:, :2] for name in ("targets", "confidence")}
    batch = draw(Sampler(Pool(**two), config()), 1)
    assert (batch.frame + batch.target_frame == 1).all()


def test_values_are_those_of_the_drawn_points():
    batch = draw(Sampler(make_pool(), config()), 5)
    frame = batch.frame[:, None].expand_as(batch.point).float()
    point = batch.point.float()
    assert torch.equal(batch.xy, torch.stack([frame, point], dim=-1))
    there = 10 * frame + batch.target_frame[:, None]
    assert torch.equal(batch.target_xy, torch.stack([there, point], dim=-1))
    torch.testing.assert_close(batch.confidence, (point + 100) / 255)
    torch.testing.assert_close(batch.rgb, torch.stack([frame, point, 0 * point], dim=-1) / 255)
    assert torch.equal(batch.feature, torch.stack([point, frame], dim=-1))
    assert torch.equal(batch.moving, point % 2)
    assert batch.masked.all()


def test_where_there_is_no_mask():
    pool = make_pool(moving=np.full((FRAMES, POINTS), UNKNOWN_MOTION, np.uint8))
    batch = draw(Sampler(pool, config()), 5)
    assert not batch.masked.any()
    assert not batch.moving.any()


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"hard_mining": 0.5},
        {"count_maps": True},
        {"candidates": 3, "moving_share": 0.5},
        {"candidates": 3, "hidden_share": 0.3},
    ],
)
def test_the_generator_decides(changes: dict[str, Any]):
    sampler = Sampler(make_pool(), config(**changes))
    first, same, other = (draw(sampler, 5, seed) for seed in (1, 1, 2))
    assert torch.equal(first.point, same.point)
    assert torch.equal(first.target_frame, same.target_frame)
    assert not torch.equal(first.point, other.point)


def test_all_points_are_drawn_alike_without_hard_mining():
    batch = draw(Sampler(make_pool(), config(pairs=2000)), 5)
    share = batch.point.flatten().bincount(minlength=POINTS) / batch.point.numel()
    # 60,000 draws: a standard deviation of 0.0006
    torch.testing.assert_close(share, torch.full((POINTS,), 1 / POINTS), rtol=0, atol=0.003)


def test_hard_points_are_drawn_more_often():
    sampler = Sampler(make_pool(), config(pairs=1000, hard_mining=0.5))
    sampler.errors[:, :4] = 50.0
    share = (draw(sampler, 5).point < 4).float().mean()
    # a tenth of the uniform half; in the other, wherever one of four rivals is hard: 1 - 0.9^4
    assert share.item() == pytest.approx(0.5 * 0.1 + 0.5 * (1 - 0.9**4), abs=0.02)


@pytest.mark.parametrize("candidates", [1, 3])
def test_hard_points_come_last(candidates: int):
    """Smoothness is evaluated at the first points of a pair."""
    sampler = Sampler(make_pool(), config(pairs=200, hard_mining=0.5, candidates=candidates))
    sampler.errors[:, :4] = 50.0
    hard = (draw(sampler, 5).point < 4).float().mean(dim=0)
    assert hard[:15].mean().item() == pytest.approx(0.1, abs=0.03)
    assert hard[15:].mean().item() == pytest.approx(1 - 0.9**4, abs=0.05)


def test_points_that_are_linked_to_few_frames_are_drawn_more_often():
    confidence = np.full((FRAMES, FRAMES, POINTS), 255, np.uint8)
    confidence[..., :20] = 0
    confidence[np.arange(FRAMES), np.arange(FRAMES)] = 255
    share = (draw(Sampler(make_pool(confidence=confidence), config(pairs=2000, count_maps=True)), 5).point < 20).float()
    rare, common = 1 / np.sqrt(1 + 1), 1 / np.sqrt(FRAMES + 1)
    assert share.mean().item() == pytest.approx(rare / (rare + common), abs=0.02)


@pytest.mark.parametrize("least", [0.4, 0.9])
def test_what_moves_is_drawn_at_its_least_share(least: float):
    moving = np.zeros((FRAMES, POINTS), np.uint8)
    moving[:, :4] = 1
    batch = draw(Sampler(make_pool(moving=moving), config(pairs=2000, moving_share=least)), 5)
    assert batch.moving.mean().item() == pytest.approx(least, abs=0.02)


@pytest.mark.parametrize("everything", [0, 1])
def test_a_frame_of_one_kind_is_drawn_from_alike(everything: int):
    moving = np.full((FRAMES, POINTS), everything, np.uint8)
    batch = draw(Sampler(make_pool(moving=moving), config(pairs=2000, moving_share=0.4)), 5)
    share = batch.point.flatten().bincount(minlength=POINTS) / batch.point.numel()
    torch.testing.assert_close(share, torch.full((POINTS,), 1 / POINTS), rtol=0, atol=0.003)


def test_the_scene_keeps_a_share_however_much_moves():
    moving = np.ones((FRAMES, POINTS), np.uint8)
    moving[:, :2] = 0
    batch = draw(Sampler(make_pool(moving=moving), config(pairs=2000, moving_share=0.4)), 5)
    assert 1 - batch.moving.mean().item() == pytest.approx(0.2, abs=0.02)


def test_points_with_a_known_target_are_taken_first():
    confidence = np.full((FRAMES, FRAMES, POINTS), 255, np.uint8)
    confidence[..., ::2] = 0
    pool = make_pool(confidence=confidence)
    assert draw(Sampler(pool, config(candidates=4)), 5).confidence.mean() > 0.99
    assert draw(Sampler(pool, config()), 5).confidence.mean().item() == pytest.approx(0.5, abs=0.06)


def test_where_no_target_is_known_points_are_drawn_all_the_same():
    batch = draw(Sampler(make_pool(confidence=np.zeros((FRAMES, FRAMES, POINTS), np.uint8)), config(candidates=4)), 5)
    assert batch.point.shape == (50, 30)


def test_hidden_points_have_a_share_and_are_expected_with_what_moves_as_they_do():
    """What moves goes 40 pixels to the right, the scene 16 up; a third of each is hidden. The clip is 512 wide."""
    points = np.random.default_rng(0).uniform((0, 0), (511, 299), (FRAMES, 600, 2)).astype(np.float32)
    moving = (points[..., 0] > 256).astype(np.uint8)
    gone = np.where(moving[..., None] == 1, (40, 0), (0, -16)).astype(np.float32)
    confidence = np.full((FRAMES, FRAMES, 600), 255, np.uint8)
    confidence[..., ::3] = 0
    targets = np.repeat((points + gone)[:, None], FRAMES, axis=1)
    targets[:, :, ::3] = 999
    pool = make_pool(
        points=points,
        targets=targets,
        confidence=confidence,
        rgb=np.zeros((FRAMES, 600, 3), np.uint8),
        feature=np.zeros((FRAMES, 600, 2), np.float16),
        moving=moving,
        longer_side=512,
    )
    batch = draw(Sampler(pool, config(points=40, candidates=4, hidden_share=0.25, moving_share=0.3)), 5)
    hidden = batch.confidence == 0
    assert hidden[:, 30:].all()
    assert not hidden[:, :30].any()
    assert not batch.expected_weight[~hidden].any()
    assert batch.expected_weight[hidden].mean() > 0.5
    gone_to = torch.where(batch.moving[..., None] == 1, torch.tensor([20.0, 0.0]), torch.tensor([0.0, -8.0]))
    told = hidden & (batch.expected_weight > 0)
    torch.testing.assert_close(batch.expected_xy[told], (batch.xy + gone_to)[told], rtol=0, atol=0.01)


def test_hidden_points_that_stand_still_are_expected_by_structure():
    """A camera that sees all at (0, 0), the centre; of what moves or was held out structure says nothing."""
    cameras = np.zeros((FRAMES, 3, 4), np.float32)
    cameras[:, 2, 3] = 1
    agreement = np.full((FRAMES, POINTS), 0.5, np.float32)
    agreement[:, 4] = 0
    covariance = np.zeros((FRAMES, POINTS, 3, 3), np.float32)
    structure = Structure(cameras, np.zeros((FRAMES, POINTS, 3), np.float32), covariance, agreement)
    moving = np.tile(np.arange(POINTS) % 4 == 1, (FRAMES, 1)).astype(np.uint8)
    moving[:, 6] = UNKNOWN_MOTION
    confidence = np.full((FRAMES, FRAMES, POINTS), 255, np.uint8)
    confidence[..., :20] = 0
    pool = make_pool(structure=structure, moving=moving, confidence=confidence)
    held_out = lambda i, j, p: (p >= 20) & (p < 26) & (i + 0 * j >= 0)  # noqa: E731
    batch = draw(Sampler(pool, config(pairs=200, points=40, candidates=3, hidden_share=0.5), held_out), 5)
    told = (batch.confidence == 0) & (batch.expected_weight > 0)
    by_structure = told & (batch.expected_weight == 0.5) & (batch.expected_xy == 128).all(dim=-1)
    assert set(batch.point[by_structure].tolist()) == {p for p in range(20) if p % 4 != 1 and p != 4}
    assert (told & ~by_structure).any(), "the others by what is around them"


def test_where_all_targets_are_known_nothing_is_expected():
    full = np.full((FRAMES, FRAMES, POINTS), 255, np.uint8)
    batch = draw(Sampler(make_pool(confidence=full), config(candidates=2, hidden_share=0.5)), 5)
    assert (batch.confidence == 1).all()
    assert not batch.expected_weight.any()


def test_hidden_points_are_expected_where_hard_ones_come_last():
    confidence = np.full((FRAMES, FRAMES, POINTS), 255, np.uint8)
    confidence[..., ::2] = 0
    changes = {"candidates": 2, "hidden_share": 0.2, "hard_mining": 0.3}
    batch = draw(
        Sampler(make_pool(confidence=confidence, moving=np.zeros((FRAMES, POINTS), np.uint8)), config(**changes)), 5
    )
    assert ((batch.expected_weight > 0) <= (batch.confidence == 0)).all()
    assert (batch.expected_weight > 0).any()


def test_errors_are_remembered_where_the_target_is_known():
    sampler = Sampler(make_pool(), config())
    batch = Batch(
        frame=torch.tensor([2]),
        target_frame=torch.tensor([3]),
        point=torch.tensor([[5, 7]]),
        xy=torch.zeros(1, 2, 2),
        target_xy=torch.zeros(1, 2, 2),
        confidence=torch.tensor([[0.3, 0.0]]),
        rgb=torch.zeros(1, 2, 3),
        feature=torch.zeros(1, 2, 2),
        moving=torch.zeros(1, 2),
        masked=torch.ones(1, 2),
        expected_xy=torch.zeros(1, 2, 2),
        expected_weight=torch.zeros(1, 2),
    )
    sampler.note_errors(batch, torch.tensor([[9.0, 9.0]]))
    assert sampler.errors[2, 5] == 5  # halfway from 1
    assert sampler.errors[2, 7].item() == pytest.approx(0.9)  # unknown: slowly forgotten
    sampler.errors[2, 5] = sampler.errors[2, 7] = 1
    assert (sampler.errors == 1).all()


def test_parts_of_a_batch():
    batch = draw(Sampler(make_pool(), config()), 5)
    part = batch.pairs(10, 13)
    assert torch.equal(part.frame, batch.frame[10:13])
    assert torch.equal(part.target_xy, batch.target_xy[10:13])
    assert len(batch.pairs(48, 60).frame) == 2
