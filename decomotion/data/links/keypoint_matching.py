"""Matches of keypoints by LightGlue (Lindenberger et al. 2023).

The keypoints are XFeat's (Potje et al. 2024) or ALIKED's (Zhao et al. 2023); all networks are kornia's. A keypoint is
matched by its descriptor and by all that surrounds it, which holds where an object has moved far and nearest
neighbours of descriptors do not. Keypoints are sparse: a cell takes the displacement of those nearest to it, where
enough of them agree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch
from jaxtyping import Float
from kornia.feature import ALIKED, LightGlue, XFeat
from torch import Tensor, nn
from tqdm import tqdm

from decomotion.clip import Clip
from decomotion.data.links.matcher import Matches, PairMatcher
from decomotion.data.timing import least_seconds
from decomotion.data.weights import downloaded, fitting, read_state
from decomotion.errors import SupervisionError
from decomotion.units import unit

SIDES = {"xfeat": 768, "aliked": 512}
"""Longer side to which frames are brought; small frames are enlarged, which finds more."""
MULTIPLE = 32
"""Of which the sides are multiples: the networks' coarsest raster, so that they resize nothing themselves."""
KEYPOINTS = 1024
"""Of a frame, at most: the time for a pair grows with their square."""
THRESHOLDS = {"xfeat": 0.05, "aliked": 0.02}
"""Scores that keypoints have at least."""
CELLS = 64
"""Along the longer side."""
NEAREST, WITHIN = 4, 6.0
"""Keypoints that a cell asks, and how far from its middle they may lie, in units."""
ALIKE = 2.5
"""Displacements that differ by less than this from the nearest keypoint's, in units, are alike."""
AGREEING = 3
"""Keypoints, the nearest among them, that have to be alike for a match to be trusted."""
OPTION = "--match-weights"
PREFIX = "matcher."
FORMER = (
    ("self_attn.{}", "transformers.{}.self_attn"),
    ("cross_attn.{}", "transformers.{}.cross_attn"),
)
"""How published files of LightGlue name what kornia names otherwise."""
ALIKED_SIZES = ("aliked-n16", "aliked-n32", "aliked-t16")
OWN_BUFFERS = ("dkd.", "confidence_thresholds")
"""kornia's own, which files lack."""


@dataclass(frozen=True)
class Keypoints:
    """Of one frame."""

    xy: Float[Tensor, "point 2"]
    """In pixels of the frame that was looked at."""
    descriptors: Float[Tensor, "point channel"]
    size: tuple[int, int]
    """(width, height) of that frame."""
    sides: tuple[float, float]
    """(width, height) of the clip's frame in units."""

    def in_units(self) -> npt.NDArray[np.float32]:
        """[point, 2], edges of the frame at -0.5."""
        scale = np.array(self.sides) / np.array(self.size)
        return ((self.xy.numpy() + 0.5) * scale - 0.5).astype(np.float32)


class KeypointMatcher:
    """See `Matcher`.

    Args:
        kind: `xfeat` or `aliked`.
        weights: files, the extractor's and LightGlue's in any order; none: their publishers', by download.
        device: where the networks run.

    Raises `SupervisionError` where a file does not fit, `DownloadError` where a download fails.
    """

    def __init__(self, kind: str, weights: Sequence[str] = (), device: str = "cpu") -> None:
        self._kind, self._device = kind, torch.device(device)
        extractor, matcher = _from_files(kind, weights) if weights else _from_publishers(kind)
        self._extractor, self._matcher = extractor.to(self._device).eval(), matcher.to(self._device).eval()

    def describe(self, clip: Clip, folder: Path, progress: bool) -> PairMatcher:
        """Keypoints of all frames are kept in memory: some hundred kilobytes of each."""
        del folder
        shown = tqdm(clip.frames, "keypoints", total=len(clip), disable=not progress, leave=False)
        keypoints = [self.keypoints(frame) for frame in shown]
        raster = raster_of(clip.height, clip.width)

        def match(first: int, second: int) -> tuple[Matches, Matches]:
            sides = keypoints[first].sides
            here, there = self.matched(keypoints[first], keypoints[second])
            return on_cells(here, there, raster, sides), on_cells(there, here, raster, sides)

        return match

    def seconds(self, clip: Clip) -> tuple[float, float]:
        """By the time of the first frame, and of it with the second."""
        both = [self.keypoints(frame) for frame in clip.frames[:2]]
        of_frame = least_seconds(lambda: self.keypoints(clip.frames[0]))
        return of_frame, least_seconds(lambda: self.matched(both[0], both[-1]))

    def keypoints(self, frame: npt.NDArray[np.uint8]) -> Keypoints:
        """The best `KEYPOINTS` of a frame [H, W, 3]."""
        height, width = frame.shape[:2]
        scale = SIDES[self._kind] / max(height, width)
        wide, high = (max(MULTIPLE, MULTIPLE * round(scale * side / MULTIPLE)) for side in (width, height))
        size = wide, high
        image = cv2.resize(frame, size, interpolation=cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA)
        batch = torch.from_numpy(image).to(self._device).permute(2, 0, 1)[None].float() / 255
        with torch.inference_mode():
            found = _DETECT[self._kind](self._extractor, batch)
        length = unit(height, width)
        return Keypoints(found[0].cpu(), found[1].cpu(), size, (width / length, height / length))

    def matched(self, first: Keypoints, second: Keypoints) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Where matched keypoints lie in either frame, both [match, 2] in units."""
        if min(len(first.xy), len(second.xy)) == 0:
            return np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32)
        with torch.inference_mode():
            found = self._matcher({"image0": self._given(first), "image1": self._given(second)})
        which = found["matches"][0].cpu().numpy()
        return first.in_units()[which[:, 0]], second.in_units()[which[:, 1]]

    def _given(self, keypoints: Keypoints) -> dict[str, Tensor]:
        return {
            "keypoints": keypoints.xy[None].to(self._device),
            "descriptors": keypoints.descriptors[None].to(self._device),
            "image_size": torch.tensor([keypoints.size], device=self._device).float(),
        }


def raster_of(height: int, width: int) -> tuple[int, int]:
    """Rows and columns of the cells over a frame."""
    rows, columns = (max(1, round(CELLS * side / max(height, width))) for side in (height, width))
    return rows, columns


def on_cells(
    here: npt.NDArray[np.float32],
    there: npt.NDArray[np.float32],
    raster: tuple[int, int],
    sides: tuple[float, float],
) -> Matches:
    """The displacement of each cell by the matches [match, 2] nearest to it, in units in either frame.

    The raster (rows, columns) covers a frame of these `sides` (width, height) in units.
    """
    rows, columns = raster
    cell = np.array([sides[0] / columns, sides[1] / rows], np.float32)
    if len(here) < AGREEING:
        return Matches(np.zeros((rows, columns, 2), np.float32), np.zeros((rows, columns), np.bool_))
    row, column = np.indices(raster).reshape(2, -1)
    middles = ((np.stack([column, row], axis=-1) + 0.5) * cell - 0.5).astype(np.float32)
    apart = torch.cdist(torch.from_numpy(middles), torch.from_numpy(here))
    away, nearest = (each.numpy() for each in apart.topk(min(NEAREST, len(here)), largest=False))
    moved = (there - here)[nearest]
    alike = (np.linalg.norm(moved - moved[:, :1], axis=-1) < ALIKE) & (away < WITHIN)
    weight = np.where(alike, 1 / (1 + away), 0)
    mean = (weight[..., None] * moved).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)[:, None]
    trusted = alike.sum(axis=1) >= AGREEING
    displacement = np.where(trusted[:, None], mean / cell, 0).astype(np.float32)
    return Matches(displacement.reshape(rows, columns, 2), trusted.reshape(rows, columns))


def _of_xfeat(extractor: Any, batch: Float[Tensor, "1 3 h w"]) -> tuple[Tensor, Tensor]:
    found = extractor.detectAndCompute(batch)[0]
    return found["keypoints"], found["descriptors"]


def _of_aliked(extractor: Any, batch: Float[Tensor, "1 3 h w"]) -> tuple[Tensor, Tensor]:
    found = extractor(batch)[0]
    return found.keypoints, found.descriptors


_DETECT: dict[str, Callable[[Any, Tensor], tuple[Tensor, Tensor]]] = {"xfeat": _of_xfeat, "aliked": _of_aliked}


def _from_publishers(kind: str) -> tuple[nn.Module, nn.Module]:
    def load() -> tuple[nn.Module, nn.Module]:
        if kind == "xfeat":
            extractor: nn.Module = XFeat.from_pretrained(top_k=KEYPOINTS, detection_threshold=THRESHOLDS[kind])
        else:
            extractor = ALIKED.from_pretrained(
                ALIKED_SIZES[0], max_num_keypoints=KEYPOINTS, detection_threshold=THRESHOLDS[kind]
            )
        return extractor, LightGlue(kind)

    return downloaded(
        load, f"the {kind} matcher", f"give both files with {OPTION}, or take --matches sift, which needs none"
    )


def _from_files(kind: str, weights: Sequence[str]) -> tuple[nn.Module, nn.Module]:
    """From files, each of which may fit one of the networks."""
    states = [read_state(file, OPTION) for file in weights]
    extractor = next((found for state in states if (found := _extractor_of(kind, state)) is not None), None)
    matcher = LightGlue(None, **LightGlue.features[kind] | {"weights": None})  # pyright: ignore[reportArgumentType]
    renamed = (_as_kornia(state, matcher.conf.n_layers) for state in states)
    of_matcher = any(fitting(matcher, state, OWN_BUFFERS) for state in renamed)
    if extractor is None or not of_matcher:
        lacking = kind if extractor is None else f"LightGlue for {kind}"
        raise SupervisionError(
            f"{OPTION} {', '.join(weights)}: no file holds {lacking}; give the option twice, with the extractor's file "
            "and with LightGlue's"
        )
    return extractor, matcher


def _extractor_of(kind: str, state: dict[str, Tensor]) -> nn.Module | None:
    """The extractor with these weights; None where they are of something else."""
    if kind == "xfeat":
        xfeat = XFeat(top_k=KEYPOINTS, detection_threshold=THRESHOLDS[kind])
        return xfeat if fitting(xfeat.net, state) else None
    for size in ALIKED_SIZES:
        aliked = ALIKED(size, max_num_keypoints=KEYPOINTS, detection_threshold=THRESHOLDS[kind])
        if fitting(aliked, state, OWN_BUFFERS):
            return aliked
    return None


def _as_kornia(state: dict[str, Tensor], layers: int) -> dict[str, Tensor]:
    renamed = {key.removeprefix(PREFIX): value for key, value in state.items()}
    for layer in range(layers):
        for former, now in FORMER:
            renamed = {key.replace(former.format(layer), now.format(layer)): value for key, value in renamed.items()}
    return renamed
