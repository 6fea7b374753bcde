"""Held-out links: which they are, and how far from them a model is that is right, or wrong by a known length."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from decomotion import held_out
from decomotion.config import load
from decomotion.data.batch import Sampler
from decomotion.data.pool import Pool
from decomotion.held_out import HeldOut, measure
from decomotion.model.fusion import DecoMotion
from decomotion.model.readout import Surface
from decomotion.quality import Quality, parse
from decomotion.units import LONGER_SIDE, unit
from tiny_fit import AFFINE, tiny_model

HEIGHT, WIDTH = 64, 96
UNIT = WIDTH / LONGER_SIDE
"""Pixels of the clip."""
VELOCITY = np.array([1.5, -0.75], np.float32)
"""Pixels a frame, of all that is seen."""


def make_pool(
    frames: int = 7, *, off: tuple[float, float] = (0, 0), off_back: tuple[float, float] | None = None, **changes: Any
) -> Pool:
    """Everything moves by `VELOCITY`; links are `off` by so many units, those back in time `off_back`."""
    y, x = np.mgrid[: HEIGHT // 2, : WIDTH // 2].reshape(2, -1).astype(np.float32)
    points = np.broadcast_to(np.stack([2 * x + 0.5, 2 * y + 0.5], axis=-1), (frames, x.size, 2)).copy()
    steps = np.arange(frames)[None] - np.arange(frames)[:, None]
    errors = np.where(steps[..., None] > 0, off, off if off_back is None else off_back) * UNIT
    errors[steps == 0] = 0
    targets = points[:, None] + (steps[..., None] * VELOCITY + errors)[:, :, None]
    arrays = {
        "points": points,
        "targets": targets.astype(np.float32),
        "confidence": np.full(targets.shape[:3], 255, np.uint8),
        "rgb": np.zeros((frames, x.size, 3), np.uint8),
        "feature": np.zeros((frames, x.size, 0), np.float16),
        "moving": np.zeros((frames, x.size), np.uint8),
        "camera": np.zeros((frames, 2, 3), np.float32),
        "object": np.zeros((frames, 2, 3), np.float32),
        "longer_side": WIDTH,
    }
    return Pool(**(arrays | changes))


def moved(frames: int, velocity: np.ndarray) -> torch.Tensor:
    """Maps from local to canonical space of what moves so, [frame, 3, 4]."""
    maps = torch.eye(3, 4).repeat(frames, 1, 1)
    shift = np.arange(frames)[:, None] * velocity / (WIDTH / 2)
    maps[:, :2, 3] = -torch.from_numpy(shift).float()
    return maps


def exact_model(frames: int = 7, velocity: np.ndarray = VELOCITY, overrides: tuple[str, ...] = AFFINE) -> DecoMotion:
    """It knows how everything moves."""
    start = moved(frames, velocity)
    return tiny_model("cpu", frames=frames, height=HEIGHT, width=WIDTH, start=start, overrides=overrides)


def quality(model: DecoMotion, pool: Pool, seed: int = 3) -> Quality:
    found = measure(model, pool, HeldOut(pool, seed), seed=seed, steps=500)
    assert found is not None
    return found


def test_an_exact_model_is_right():
    found = quality(exact_model(), make_pool())
    for _, each in found.rows():
        # float32 in normalised coordinates
        assert max(each.median, each.p90, each.median_pixels, each.p90_pixels, each.own_error) < 1e-3
        assert (each.within_1, each.within_2, each.within_4) == (1, 1, 1)
    assert (found.steps, found.thinned, found.dynamic) == (500, None, None)
    assert found.static == found.all


@pytest.mark.parametrize(("units", "within"), [(3.0, (0, 0, 1)), (1.5, (0, 1, 1)), (5.0, (0, 0, 0))])
def test_one_that_is_off_is_off_by_as_much_in_units_and_in_pixels_of_the_clip(
    units: float, within: tuple[float, float, float]
):
    for _, each in quality(exact_model(), make_pool(off=(0.6 * units, -0.8 * units))).rows():
        assert (each.median, each.p90) == pytest.approx((units, units), abs=1e-3)
        assert (each.median_pixels, each.p90_pixels) == pytest.approx((units * 0.375, units * 0.375), abs=1e-3)
        assert (each.within_1, each.within_2, each.within_4) == within


@pytest.mark.parametrize("nowhere", [np.nan, np.inf, 1e30])
def test_a_model_that_leads_nowhere_is_off_as_far_as_can_be(nowhere: float, monkeypatch: pytest.MonkeyPatch):
    def followed(model: DecoMotion, links: held_out._Links) -> tuple[np.ndarray, np.ndarray]:
        return np.full_like(links.xy, nowhere), np.ones(len(links.xy), bool)

    monkeypatch.setattr(held_out, "_followed", followed)
    found = quality(exact_model(), make_pool())
    assert (found.all.median, found.all.within_4) == (1e6, 0)
    assert parse(found.as_json()) == found


@pytest.mark.parametrize(
    ("off", "off_back", "own"),
    [((3, 0), (-3, 0), 0.0), ((3, 0), (0, 0), 3 / np.sqrt(2)), ((3, 0), (3, 0), 6 / np.sqrt(2))],
)
def test_the_links_own_error_is_that_of_the_way_there_and_back(
    off: tuple[float, float], off_back: tuple[float, float], own: float
):
    """Where both ways are wrong alike, there and back again, it cannot be seen."""
    found = quality(exact_model(), make_pool(off=off, off_back=off_back))
    assert found.all.own_error == pytest.approx(own, abs=1e-3)


def test_links_that_nothing_leads_back_from_are_not_asked():
    pool = make_pool(2)
    pool.confidence[1, 0] = 0
    assert measure(exact_model(2), pool, HeldOut(pool, 0), seed=0, steps=1) is None


def test_links_that_are_not_known_are_not_asked():
    """Those behind frame 3 are of elsewhere and hidden."""
    pool = make_pool()
    pool.targets[:, 4:] += 50
    pool.confidence[:, 4:] = 0
    assert quality(exact_model(), pool).all.p90 < 1e-3


def test_the_nearest_point_leads_back_only_where_it_is_near(monkeypatch: pytest.MonkeyPatch):
    """Points are 5.3 units apart. Over 3 and 5 frames links end 1.5 units from one, over the others 2.4 to 3."""
    pool = make_pool()
    everywhere = quality(exact_model(), pool)
    assert [(each.shortest, each.longest) for each in everywhere.gaps] == [(1, 1), (2, 4), (5, 6)]
    monkeypatch.setattr(held_out, "NEAR", 2.0)
    near = quality(exact_model(), pool)
    assert [(each.shortest, each.longest) for each in near.gaps] == [(2, 4), (5, 6)]
    assert near.all.links < 0.5 * everywhere.all.links


def test_figures_by_volume(monkeypatch: pytest.MonkeyPatch):
    """The dynamic volume owns the left half and thinks that it moves by two units more."""
    whole = held_out.surface_of
    model = exact_model(2, overrides=())
    model.dynamic.affine.start.copy_(moved(2, VELOCITY + np.array([0, 2 * UNIT])))

    def owned(model: DecoMotion, xy: torch.Tensor, *rest: Any) -> Surface:
        monkeypatch.setattr("decomotion.model.readout.static_owns", lambda _: xy[..., 0] > WIDTH / 2)
        return whole(model, xy, *rest)

    monkeypatch.setattr(held_out, "surface_of", owned)
    found = quality(model, make_pool(2))
    assert found.static is not None
    assert found.dynamic is not None
    # the layers begin near the identity
    assert found.static.median == pytest.approx(0, abs=0.02)
    assert found.dynamic.median == pytest.approx(2, abs=0.02)
    assert found.static.links + found.dynamic.links == found.all.links
    assert min(found.dynamic.links, found.static.links) > 50


@pytest.fixture(scope="module")
def of_70_frames() -> Quality:
    """Of a model that thinks that nothing moves; points move by a hundredth of a unit a frame."""
    frames, few = 70, make_pool(2).points[0, ::12]
    steps = np.arange(frames)[None] - np.arange(frames)[:, None]
    targets = (few + 0.01 * UNIT * steps[:, :, None, None] * np.array([1, 0])).astype(np.float32)
    points, certain = np.broadcast_to(few, (frames, *few.shape)), np.full(targets.shape[:3], 255, np.uint8)
    return quality(exact_model(frames, np.zeros(2)), make_pool(2, points=points, targets=targets, confidence=certain))


class TestGaps:
    def test_each_has_its_own(self, of_70_frames: Quality):
        bounds = [(each.shortest, each.longest) for each in of_70_frames.gaps]
        assert bounds == [(1, 1), (2, 4), (5, 16), (17, 64), (65, 69)]
        for (least, most), each in zip(bounds, of_70_frames.gaps, strict=True):
            gaps = np.repeat(np.arange(least, most + 1), 70 - np.arange(least, most + 1))
            # a thousand links: a few per cent of the width
            assert 100 * each.figures.median == pytest.approx(np.median(gaps), abs=0.1 * (most - least) + 0.01)
            assert 100 * each.figures.p90 == pytest.approx(np.quantile(gaps, 0.9), abs=0.1 * (most - least) + 0.01)
            assert each.figures.links > 100

    def test_all_of_them_count_as_often_as_there_are_pairs_of_frames(self, of_70_frames: Quality):
        gaps = np.repeat(np.arange(1, 70), 70 - np.arange(1, 70))
        assert 100 * of_70_frames.all.median == pytest.approx(np.median(gaps), abs=2)  # 21
        assert 100 * of_70_frames.all.p90 == pytest.approx(np.quantile(gaps, 0.9), abs=2)  # 48

    def test_both_ways_in_time_count_alike(self):
        """Links back in time are off by two units, the others by none."""
        assert quality(exact_model(), make_pool(off_back=(2, 0))).all.within_1 == pytest.approx(0.5, abs=0.05)

    def test_of_a_short_clip(self):
        gaps = quality(exact_model(4), make_pool(4)).gaps
        assert [(each.shortest, each.longest) for each in gaps] == [(1, 1), (2, 3)]


class TestWhichLinks:
    def test_those_that_begin_or_end_in_a_patch(self):
        pool = make_pool()
        held = HeldOut(pool, 5)
        patches, side = held._patches, 16 * UNIT
        random = np.random.default_rng(0)
        frames, count = pool.points.shape[:2]
        alike = 0
        for i, j, p in zip(*(random.integers(top, size=3000) for top in (frames, frames, count)), strict=True):
            ends = [(i, pool.points[i, p]), (j, pool.targets[i, j, p])]
            cells = [(t, *np.clip((xy[::-1] + 0.5) // side, 0, 15).astype(int)) for t, xy in ends]
            expected = any(patches[cell] for cell in cells)
            assert held.links(*(np.array([index]) for index in (i, j, p))) == expected
            alike += expected
        assert 0 < alike < 300

    def test_a_few_per_cent_in_every_stretch_of_the_clip(self):
        held = HeldOut(make_pool(40), 1)
        assert 0.01 < held.points.mean() < 0.04
        assert (held.points.reshape(4, -1).mean(axis=1) > 0.003).all()

    def test_the_seed_decides(self):
        pool = make_pool()
        one, same, other = (HeldOut(pool, seed) for seed in (1, 1, 2))
        assert (one.points == same.points).all()
        assert (one.points & other.points).sum() < 0.3 * one.points.sum()
        assert quality(exact_model(), pool, 1) == quality(exact_model(), pool, 1)

    def test_none_is_drawn(self):
        pool = make_pool(6)
        held, config = HeldOut(pool, 2), load("cpu").optim
        sampler = Sampler(pool, config.model_copy(update={"candidates": 1}), held.links)
        held_back = 0
        for seed in range(20):
            batch = sampler.draw(5, torch.Generator().manual_seed(seed))
            i, j, p = batch.frame.numpy()[:, None], batch.target_frame.numpy()[:, None], batch.point.numpy()
            which = held.links(i, j, p)
            assert (batch.confidence.numpy()[which] == 0).all()
            assert (batch.confidence.numpy()[~which] == 1).all()
            held_back += which.sum()
        assert held_back > 100  # their colours are learnt all the same

    def test_others_are_taken_in_their_place(self):
        pool = make_pool(6)
        held, config = HeldOut(pool, 2), load("cpu").optim
        batch = Sampler(pool, config, held.links).draw(5, torch.Generator().manual_seed(0))
        share = round(config.hidden_share * config.points)
        assert (batch.confidence[:, : config.points - share] == 1).all()


def test_unit_of_the_clip():
    assert unit(WIDTH) == UNIT == 0.375


def test_another_seed_looks_at_other_links():
    """Of links that are off by their gap; which places are held out does not depend on it."""
    pool = make_pool(9)
    pool.targets[..., 0] += UNIT * np.arange(9)[:, None]
    held_out_places, model = HeldOut(pool, 3), exact_model(9)
    one, other = (measure(model, pool, held_out_places, seed=seed, steps=1) for seed in (3, 4))
    assert one is not None
    assert other is not None
    assert one.all.links != other.all.links or one.all.median != other.all.median


@pytest.mark.parametrize(("units", "known"), [(3.8, True), (4.2, False)])
def test_a_way_back_begins_within_four_units(units: float, known: bool):
    """Of points that are 43 units apart, which move by so much."""
    points = make_pool(2).points[:, (np.arange(32)[:, None] % 8 * np.ones(48) + np.arange(48) % 8).ravel() == 0]
    steps = (np.arange(2)[None] - np.arange(2)[:, None])[..., None, None]
    targets = (points[:, None] + steps * units * UNIT * np.array([0.6, -0.8])).astype(np.float32)
    certain = np.full(targets.shape[:3], 255, np.uint8)
    pool = make_pool(2, points=points, targets=targets, confidence=certain)
    every = HeldOut(pool, 0)
    every.points[:] = True
    assert (measure(exact_model(2), pool, every, seed=0, steps=1) is not None) == known


def test_what_contradicts_what_is_known_better_is_left_out():
    """Links that begin on the left are off by nine units, and those are contradicted."""
    pool, told = make_pool(), []
    left = pool.points[0, :, 0] < WIDTH / 2
    pool.targets[:, :, left, 0] += 9 * UNIT

    def contradicts(frame: np.ndarray, xy: np.ndarray, target: np.ndarray, target_xy: np.ndarray) -> np.ndarray:
        np.testing.assert_allclose((target_xy - xy)[:, 1], (target - frame) * VELOCITY[1], atol=1e-3)
        told.append(len(frame))
        return xy[:, 0] < WIDTH / 2

    held = HeldOut(pool, 3)
    found = measure(exact_model(), pool, held, contradicts, seed=3, steps=1)
    assert found is not None
    assert 0 < found.all.links < told[0]
    assert found.all.p90 < 1e-3 < quality(exact_model(), pool).all.p90
    assert measure(exact_model(), pool, held, lambda frame, *_: frame >= 0, seed=3, steps=1) is None


def test_what_was_thinned_is_told():
    assert quality(exact_model(), make_pool(thinned="flow at gaps 1")).thinned == "flow at gaps 1"
