"""Where hidden points are expected: by a motion that is known."""

from __future__ import annotations

import cmath
import math

import pytest
import torch
from torch import Tensor

from decomotion.data.surroundings import FEWEST, REACH, expected

TURN, SCALE, SHIFT = math.radians(25), 1.3, (7.0, -4.0)


def moved(xy: Tensor) -> Tensor:
    """Turned, scaled and shifted."""
    cos, sin = SCALE * math.cos(TURN), SCALE * math.sin(TURN)
    return xy @ torch.tensor([[cos, sin], [-sin, cos]]) + torch.tensor(SHIFT)


def links(count: int = 60, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Where they begin, in a field of 90 x 50 units, and end."""
    begin = torch.rand(1, count, 2, generator=torch.Generator().manual_seed(seed)) * torch.tensor([90.0, 50.0])
    return begin, moved(begin)


POINTS = torch.tensor([[[40.0, 20.0], [120.0, 30.0], [45.0, -30.0]]])


def alike(begin: Tensor, points: Tensor = POINTS) -> Tensor:
    """All links tell all points."""
    return torch.ones(1, points.shape[1], begin.shape[1])


def test_a_similarity_is_found_within_and_beyond_what_is_known():
    begin, end = links()
    found = expected(POINTS, begin, end, alike(begin))
    torch.testing.assert_close(found.xy, moved(POINTS), rtol=0, atol=0.1)


def test_wrong_links_hardly_count():
    begin, end = links()
    end[0, ::5] += torch.tensor([30.0, 55.0])
    found = expected(POINTS[:, :1], begin, end, alike(begin)[:, :1])
    torch.testing.assert_close(found.xy, moved(POINTS[:, :1]), rtol=0, atol=0.5)


def test_near_links_decide_where_motions_differ():
    """What is left of 45 stands, what is right of it moves by 20."""
    begin, _ = links(200)
    end = begin + torch.where(begin[..., :1] < 45, 0.0, 20.0) * torch.tensor([1.0, 0.0])
    points = torch.tensor([[[15.0, 25.0], [75.0, 25.0]]])
    found = expected(points, begin, end, alike(begin, points))
    torch.testing.assert_close(found.xy - points, torch.tensor([[[0.0, 0.0], [20.0, 0.0]]]), rtol=0, atol=1.0)


def test_links_of_another_part_do_not_count():
    begin, end = links()
    other = begin + 50
    weight = torch.cat([alike(begin), 0 * alike(begin)], dim=-1)
    found = expected(
        POINTS, torch.cat([begin, POINTS, begin[:, 3:]], dim=1), torch.cat([end, POINTS, other[:, 3:]], 1), weight
    )
    torch.testing.assert_close(found.xy, moved(POINTS), rtol=0, atol=0.1)
    apart = torch.cdist(POINTS, begin).amin(-1)
    # not by those that lie at the points themselves
    torch.testing.assert_close(found.weight, torch.exp(-apart / REACH), rtol=0, atol=0.001)


def test_links_that_do_not_agree_tell_less():
    """A quarter of them goes anywhere: of those around the middle, by chance somewhat more or less."""
    begin, end = links(400)
    sure = expected(POINTS[:, :1], begin, end, alike(begin)[:, :1]).weight
    end[0, ::4] += 60 * torch.rand(100, 2, generator=torch.Generator().manual_seed(1)) + 20
    found = expected(POINTS[:, :1], begin, end, alike(begin)[:, :1])
    assert (found.weight / sure).item() == pytest.approx(0.75, abs=0.1)


def test_few_links_tell_nothing():
    begin, end = links(count=int(FEWEST))
    assert (expected(POINTS, begin, end, alike(begin)).weight > 0).all()
    found = expected(POINTS, begin, end, 0.99 * alike(begin))
    assert not found.weight.any()
    assert torch.equal(expected(POINTS, begin, end, 0 * alike(begin)).xy, POINTS)


def test_links_that_begin_at_one_place_are_a_shift():
    begin = torch.full((1, 20, 2), 30.0)
    found = expected(POINTS, begin, begin + torch.tensor([3.0, 5.0]), alike(begin))
    torch.testing.assert_close(found.xy, POINTS + torch.tensor([3.0, 5.0]))


def test_links_that_begin_a_tenth_of_a_unit_apart_do_not_turn_what_is_far_away():
    """By their ends, which are a noise of 0.3 units, they would: by a right angle, and thrice as far."""
    apart = 0.1 * torch.rand(1, 20, 2, generator=torch.Generator().manual_seed(2))
    turned = 3 * torch.stack([-apart[..., 1], apart[..., 0]], dim=-1)
    found = expected(POINTS, 30 + apart, 33 + turned, alike(apart))
    torch.testing.assert_close(found.xy, POINTS + 3, rtol=0, atol=1.0)


@pytest.mark.parametrize("pairs", [1, 3])
def test_each_pair_has_its_own_motion(pairs: int):
    begin, end = links()
    shifts = torch.arange(pairs)[:, None, None] * torch.tensor([11.0, 0.0])
    found = expected(
        POINTS.expand(pairs, -1, -1), begin.expand(pairs, -1, -1), end + shifts, alike(begin).expand(pairs, -1, -1)
    )
    torch.testing.assert_close(found.xy, moved(POINTS) + shifts, rtol=0, atol=0.1)


def plainly_expected(at: complex, links: list[tuple[complex, complex, float]]) -> tuple[complex, float]:
    """Of one point, and links (where they begin, where they end, how much they count), one at a time."""
    near = [count / (abs(begin - at) + 4) ** 2 for begin, _, count in links]
    agreeing, moved = near, at
    for _ in range(3):
        total = sum(agreeing)
        centre = sum(each * begin for each, (begin, _, _) in zip(agreeing, links, strict=True)) / total
        its_end = sum(each * end for each, (_, end, _) in zip(agreeing, links, strict=True)) / total
        both, own = 1 + 0j, 1.0
        for each, (begin, end, _) in zip(agreeing, links, strict=True):
            both += each / total * (begin - centre).conjugate() * (end - its_end)
            own += each / total * abs(begin - centre) ** 2
        moved = its_end + both / own * (at - centre)
        off = [abs(end - its_end - both / own * (begin - centre)) for begin, end, _ in links]
        agreeing = [each / (1 + (miss / 2) ** 2) for each, miss in zip(near, off, strict=True)]
    nearest = min(abs(begin - at) for begin, _, count in links if count > 0)
    if sum(count for _, _, count in links) < 8:
        return moved, 0.0
    return moved, sum(agreeing) / sum(near) * math.exp(-nearest / 32)


@pytest.mark.parametrize("count", [15, 60])
def test_as_a_plain_sum_over_links_has_it(count: int):
    """Of links of which some are wrong, and which count by their confidence; fifteen are about as many as it takes."""
    begin, end = links(count, seed=4)
    random = torch.Generator().manual_seed(5)
    end = end + 3 * torch.randn(end.shape, generator=random)
    weight = torch.rand(1, 30, count, generator=random) * (torch.rand(1, 30, count, generator=random) < 0.9)
    points = torch.rand(1, 30, 2, generator=random) * torch.tensor([180.0, 90.0]) - 40
    found = expected(points, begin, end, weight)
    told = 0
    for point in range(30):
        given = [
            (complex(*begin[0, link].tolist()), complex(*end[0, link].tolist()), weight[0, point, link].item())
            for link in range(count)
        ]
        moved, share = plainly_expected(complex(*points[0, point].tolist()), given)
        assert cmath.isclose(complex(*found.xy[0, point].tolist()), moved, abs_tol=0.01)  # float32
        assert found.weight[0, point].item() == pytest.approx(share, abs=1e-4)
        told += share > 0
    assert told == 30 if count == 60 else 2 < told < 28
