"""Links that are held out of a fit, and how far from them the fitted model leads.

Held out are places: patches of frames, chosen by the seed. No link that begins or ends in one is drawn while the fit
lasts, since the link from here to there and the links from there back are of the same flow, and so are those of the
points around. `docs/quality.md` says why places, and what the figures can tell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt
import torch

from decomotion.chance import generator
from decomotion.data.pool import Pool
from decomotion.model.fusion import DecoMotion
from decomotion.model.readout import carry, surface_of
from decomotion.quality import Figures, GapFigures, Quality
from decomotion.units import LONGER_SIDE, to_units, unit

PATCH = 16
"""Side of a patch in units."""
SHARE = 0.02
"""Of the patches, held out: of the links, about twice as many."""
GAPS = ((1, 1), (2, 4), (5, 16), (17, 64), (65, 10**6))
"""Shortest and longest frame gap of links whose figures are told apart."""
DRAWS = 1500
"""Links that are looked at for each of `GAPS`, those without a known target among them."""
NEAR = 4.0
"""Units from where a link ends to the point whose link leads back, at most."""
FARTHEST = 1e6
"""Units that a model is off at most; one that leads nowhere is off by as much."""
AT_ONCE = 256
"""Links whose rays are rendered at a time."""


Contradicts = Callable[..., npt.NDArray[np.bool_]]
"""Tells links by `frame` and `target` [link], `xy` and `target_xy` [link, 2] in pixels."""


class HeldOut:
    """The places that `seed` holds out of fits to a pool."""

    def __init__(self, pool: Pool, seed: int) -> None:
        self._pool = pool
        side = LONGER_SIDE // PATCH
        self._patches = generator(seed, "held out").random((pool.num_frames, side, side)) < SHARE
        self.points = np.stack([self.holds(np.array(frame), xy) for frame, xy in enumerate(pool.points)])
        """bool [frame, point]: the points in such places."""

    def holds(self, frame: npt.NDArray[np.integer], xy: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
        """Whether places `xy` [..., 2], in pixels of the clip, of `frame` [...] are held out."""
        patch = np.floor((to_units(xy, self._pool.longer_side) + 0.5) / PATCH).astype(np.int64)
        column, row = np.moveaxis(patch.clip(0, self._patches.shape[1] - 1), -1, 0)
        return self._patches[frame, row, column]

    def links(
        self, frame: npt.NDArray[np.integer], target: npt.NDArray[np.integer], point: npt.NDArray[np.integer]
    ) -> npt.NDArray[np.bool_]:
        """Whether the links of `point` of `frame` to frame `target`, arrays of shapes that go together, are."""
        return self.points[frame, point] | self.holds(target, self._pool.targets[frame, target, point])


@dataclass(frozen=True)
class _Links:
    """Held-out links whose target is known and confirmed by the way back."""

    frame: npt.NDArray[np.int64]
    target: npt.NDArray[np.int64]
    xy: npt.NDArray[np.float32]
    """[link, 2], pixels of the clip; so is where they lead."""
    target_xy: npt.NDArray[np.float32]
    own_error: npt.NDArray[np.float32]
    """[link], units."""
    weight: npt.NDArray[np.float64]
    """[link]: how many of all held-out links each stands for, but for a factor."""

    def without(self, which: npt.NDArray[np.bool_]) -> _Links:
        """The others."""
        return _Links(**{each.name: getattr(self, each.name)[~which] for each in fields(self)})


def measure(
    model: DecoMotion,
    pool: Pool,
    held_out: HeldOut,
    contradicts: Contradicts | None = None,
    *,
    seed: int,
    steps: int,
) -> Quality | None:
    """How good the model is after so many steps; None where no link is held out whose target is known.

    It looks at some thousands of links, which `seed` decides: about as long as two steps take. Those that `contradicts`
    tells are left out: something is known better.
    """
    links = _drawn(pool, held_out, generator(seed, "held-out links"))
    if contradicts is not None:
        links = links.without(contradicts(links.frame, links.xy, links.target, links.target_xy))
    if not len(links.frame):
        return None
    led_to, is_static = _followed(model, links)
    error = np.linalg.norm(led_to.astype(np.float64) - links.target_xy, axis=-1) / unit(pool.longer_side)
    error = np.nan_to_num(error, nan=FARTHEST).clip(max=FARTHEST)
    gap = np.abs(links.target - links.frame)

    def figures(which: npt.NDArray[np.bool_]) -> Figures | None:
        return _figures(error[which], links.own_error[which], links.weight[which], unit(pool.longer_side))

    everything = figures(np.ones(len(error), np.bool_))
    assert everything is not None
    by_gap = [(least, min(most, pool.num_frames - 1), figures((least <= gap) & (gap <= most))) for least, most in GAPS]
    return Quality(
        steps=steps,
        thinned=pool.thinned,
        all=everything,
        static=figures(is_static),
        dynamic=figures(~is_static),
        gaps=tuple(GapFigures(least, most, each) for least, most, each in by_gap if each is not None),
    )


def _drawn(pool: Pool, held_out: HeldOut, random: np.random.Generator) -> _Links:
    """Links from held-out points to other frames, of each of `GAPS` about as many."""
    kinds = [(least, min(most, pool.num_frames - 1)) for least, most in GAPS if least < pool.num_frames]
    pairs = [_pairs(pool.num_frames, least, most, random) for least, most in kinds]
    frame, target = np.concatenate([drawn for drawn, _ in pairs], axis=1)
    weight = np.repeat([there_are / DRAWS for _, there_are in pairs], DRAWS)

    frame_of, points = np.nonzero(held_out.points)
    count = held_out.points.sum(axis=1)
    place = np.searchsorted(frame_of, frame) + (random.random(len(frame)) * count[frame]).astype(np.int64)
    some = count[frame] > 0
    frame, target, point, weight = frame[some], target[some], points[place[some]], weight[some]
    known = pool.confidence[frame, target, point] > 0
    frame, target, point, weight = frame[known], target[known], point[known], weight[known]

    xy, target_xy = pool.points[frame, point], pool.targets[frame, target, point]
    back, own_error = _way_back(pool, frame, target, xy, target_xy)
    return _Links(frame[back], target[back], xy[back], target_xy[back], own_error[back], weight[back])


def _pairs(frames: int, least: int, most: int, random: np.random.Generator) -> tuple[npt.NDArray[np.int64], int]:
    """`DRAWS` pairs of frames that are `least` to `most` apart, [2, pair], all as likely; how many there are."""
    gaps = np.arange(least, most + 1)
    of_gap = frames - gaps
    gap = random.choice(gaps, DRAWS, p=of_gap / of_gap.sum())
    earlier = random.integers(frames - gap)
    pairs = np.stack([earlier, earlier + gap])
    return np.where(random.random(DRAWS) < 0.5, pairs, pairs[::-1]), 2 * int(of_gap.sum())


def _way_back(
    pool: Pool,
    frame: npt.NDArray[np.int64],
    target: npt.NDArray[np.int64],
    xy: npt.NDArray[np.float32],
    target_xy: npt.NDArray[np.float32],
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.float32]]:
    """Which links the nearest point at their end has a link back for, and the error of each of the two in units.

    The way back begins where the link ends and is as long as the nearest point's. Both miss together by as much as the
    whole misses its beginning; each, if they are alike and know nothing of one another, by that over the root of 2.
    """
    one = unit(pool.longer_side)
    nearest, distance = np.empty(len(frame), np.int64), np.empty(len(frame), np.float32)
    for link, (there, end) in enumerate(zip(target, target_xy, strict=True)):
        offset = pool.points[there] - end
        squared = np.einsum("pc,pc->p", offset, offset)
        nearest[link] = squared.argmin()
        distance[link] = np.sqrt(squared[nearest[link]])
    known = (pool.confidence[target, frame, nearest] > 0) & (distance <= NEAR * one)
    returned = target_xy + pool.targets[target, frame, nearest] - pool.points[target, nearest]
    return known, (np.linalg.norm(returned - xy, axis=-1) / (one * np.sqrt(2))).astype(np.float32)


@torch.no_grad()
def _followed(model: DecoMotion, links: _Links) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Where the model says that the links' points are, [link, 2] in pixels, and which the static volume owns."""
    device = next(model.parameters()).device
    led_to, is_static = [], []
    order = np.lexsort((links.target, links.frame))  # links of a frame together: less to be computed for frames
    for first in range(0, len(order), AT_ONCE):
        some = order[first : first + AT_ONCE]
        frames, rows = np.unique(np.stack([links.frame[some], links.target[some]]), return_inverse=True)
        conditioning = model.condition(torch.from_numpy(frames).to(device))
        here, there = torch.from_numpy(rows.reshape(2, -1)).to(device)
        surface = surface_of(model, torch.from_numpy(links.xy[some])[:, None].to(device), conditioning, here)
        led_to.append(carry(model, surface, conditioning, there)[:, 0].cpu().numpy())
        is_static.append(surface.is_static[:, 0].cpu().numpy())
    back = np.argsort(order)
    return np.concatenate(led_to)[back], np.concatenate(is_static)[back]


def _figures(
    error: npt.NDArray[np.floating], own: npt.NDArray[np.floating], weight: npt.NDArray[np.floating], pixels: float
) -> Figures | None:
    """Of links with these errors in units; `pixels` of the clip are a unit. None where there is no link."""
    if not len(error):
        return None
    median, p90 = (_quantile(error, weight, share) for share in (0.5, 0.9))
    within_1, within_2, within_4 = (float(np.average(error < units, weights=weight)) for units in (1, 2, 4))
    return Figures(
        links=len(error),
        median=round(median, 4),
        p90=round(p90, 4),
        median_pixels=round(median * pixels, 4),
        p90_pixels=round(p90 * pixels, 4),
        within_1=round(within_1, 4),
        within_2=round(within_2, 4),
        within_4=round(within_4, 4),
        own_error=round(_quantile(own, weight, 0.5), 4),
    )


def _quantile(values: npt.NDArray[np.floating], weight: npt.NDArray[np.floating], share: float) -> float:
    """The least value such that those up to it have that share of the weight."""
    order = np.argsort(values)
    cumulated = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(cumulated, share * cumulated[-1])])
