"""How each stage is made, from the ones before it."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomotion.chance import generator
from decomotion.clip import Clip
from decomotion.data.config import ISNET
from decomotion.data.features.stage import build_feature_arrays
from decomotion.data.links.filtering import build_filtered
from decomotion.data.links.stage import Found, Linked, build_links
from decomotion.data.masks.auto import moving_probability
from decomotion.data.masks.cost import seconds_a_frame
from decomotion.data.masks.isnet import Isnet
from decomotion.data.masks.links import Links
from decomotion.data.masks.outlines import asked, outlined
from decomotion.data.masks.scene import wider
from decomotion.data.masks.silhouette import Mask, silhouettes
from decomotion.data.motion import build_motion
from decomotion.data.pool import jittered_grid
from decomotion.data.positions import PackedPositions
from decomotion.data.prepare.inputs import Inputs
from decomotion.data.prepare.keys import Keys
from decomotion.data.sampling import rescaled, sample_map
from decomotion.data.stages import write_array
from decomotion.data.structure.places import seconds_a_frame as seconds_to_place
from decomotion.data.timing import least_seconds
from decomotion.data.working import build_frames, working_clip, working_side
from decomotion.units import unit

PROBABILITY = "probability.npy"
"""In the folder of `links`, where it is found there: how likely points of the grid move, [frame, row, column]."""
OUTLINES = "outlines.npy"
"""There as well, where a network draws them: what moves, [frame, H, W / 8], eight pixels a byte."""
SCENE = 0.5
"""What it costs to find how frames differ from the scene, of what masks do."""
BESIDE = 2.0
"""Units around outlines that have their own flow too: what lacks it costs links, what has too much does not."""


class Making:
    """Fills the stages' folders; each `build_*` returns the facts of its stage."""

    def __init__(self, inputs: Inputs, keys: Keys) -> None:
        self.inputs, self.keys = inputs, keys

    @cached_property
    def working(self) -> Clip:
        """The clip at the size that preparation works at, on disk; made when the first stage asks for it."""
        side = working_side(self.inputs.config.flow)
        made = self.keys.stage("frames", side=side).run(partial(self.build_frames, side), self.inputs.rebuild)
        return working_clip(self.inputs.clip, made.folder)

    def build_frames(self, side: int, folder: Path) -> dict[str, Any]:
        """`frames`."""
        return build_frames(self.inputs.clip, side, self.inputs.progress, folder)

    def build_links(self, folder: Path) -> dict[str, Any]:
        """`links`."""
        inputs, begin = self.inputs, time.monotonic()
        random = generator(inputs.seed, "points")
        wanted = (inputs.clip, self.working, inputs.config, inputs.count, self.seconds_after_links, random)
        found = Found(partial(self.moving, folder), self.keys.outlines) if inputs.finds_masks_of_links else None
        given = (inputs.tracks, inputs.estimator, self.keys.matcher, inputs.masks_of_links, found)
        return build_links(*wanted, *given, inputs.progress, folder, time.monotonic() - begin)

    def moving(self, folder: Path, linked: Linked) -> Iterable[Mask]:
        """What moves in each frame, for flow of its own.

        How likely points move is kept in the folder, and so are outlines by a network.
        """
        probability = self.found(linked)
        write_array(folder / PROBABILITY, probability)
        if self.keys.outlines:
            masks = self.outlined(probability, linked)
            write_array(folder / OUTLINES, np.stack([np.packbits(mask, axis=-1) for mask in masks]))
            return (wider(mask, round(BESIDE * unit(*mask.shape))) for mask in self.kept_outlines(folder))
        frames, links = self.working.frames, Links(*linked, self.inputs.sides)
        return silhouettes(frames, probability, links, generator(self.inputs.seed, "silhouettes"))

    def found(self, linked: Linked) -> npt.NDArray[np.float32]:
        """How likely each point of the grid moves, [frame, row, column]."""
        how = (self.inputs.sides, generator(self.inputs.seed, "masks"), self.inputs.progress)
        return moving_probability(self.working.frames, *linked, *how)

    def outlined(self, probability: npt.NDArray[np.float32], linked: Linked) -> Iterator[Mask]:
        """Outlines, [H, W] each, of what is so likely to move, by the network."""
        how = (self.network, generator(self.inputs.seed, "outlines"), self.inputs.progress)
        return outlined(self.working.frames, probability, Links(*linked, self.inputs.sides), *how)

    def kept_outlines(self, folder: Path) -> Iterator[Mask]:
        """Those that are in the folder of `links`."""
        packed = np.load(folder / OUTLINES, mmap_mode="r")
        return (np.unpackbits(each, axis=-1, count=self.working.width).astype(np.bool_) for each in packed)

    @cached_property
    def network(self) -> Isnet:
        """That draws outlines."""
        masks = self.inputs.config.masks
        return Isnet(None if masks == ISNET else masks, self.inputs.device)

    @property
    def outlines_wanted(self) -> bool:
        """Whether a network is to draw them, and has not yet."""
        keys, inputs = self.keys, self.inputs
        drawn = keys.links.finished and (inputs.finds_masks_of_links or keys.motion.finished)
        return keys.outlines and (inputs.rebuild or not drawn)

    def seconds_after_links(self, points: int) -> float:
        """What features, masks and structure will take here, about, by those of a frame with so many points."""
        inputs, frames = self.inputs, self.working.frames
        seconds = seconds_to_place(points, len(frames), generator(inputs.seed, "cost"))
        extractor = inputs.extractor
        if extractor is not None:
            sides = (self.working.height, self.working.width)
            where = jittered_grid(1, *sides, points, generator(inputs.seed, "cost"))[0]
            seconds += least_seconds(lambda: sample_map(extractor(frames[0]), where, *sides))
        if inputs.config.finds_masks:
            more = 1 + SCENE * (2 if self.keys.outlines else 1 if inputs.finds_masks_of_links else 0)
            seconds += more * seconds_a_frame(frames, points, generator(inputs.seed, "cost"))
        return len(frames) * seconds

    def seconds_of_outlines(self) -> float:
        """What the network will take here, about: on top of the budget, so that it costs no links."""
        if not self.outlines_wanted:
            return 0.0
        frames = self.working.frames
        return len(asked(len(frames))) * least_seconds(lambda: self.network(frames[0]))

    def build_features(self, folder: Path) -> dict[str, Any]:
        """`features`."""
        inputs, clip = self.inputs, self.working
        points = rescaled(np.load(self.keys.links.folder / "points.npy"), inputs.sides, (clip.height, clip.width))
        what = (inputs.extractor, inputs.config.feature_size)
        return build_feature_arrays(clip, points, *what, inputs.progress, folder)

    def build_filter(self, folder: Path) -> dict[str, Any]:
        """`filter`."""
        inputs, keys = self.inputs, self.keys
        feature = np.load(keys.features.folder / "feature.npy", mmap_mode="r")
        return build_filtered(*self.linked(), feature, keys.grid, inputs.config.rules, inputs.progress, folder)

    def build_motion(self, folder: Path) -> dict[str, Any]:
        """`motion`."""
        inputs, keys = self.inputs, self.keys
        points, targets, confidence = self.linked()
        if inputs.filters_on:
            confidence = np.load(keys.filter.folder / "confidence.npy", mmap_mode="r")
        linked = points, targets, confidence, (keys.grid.rows, keys.grid.columns)
        masks, probability = inputs.given_masks, None
        if inputs.finds_masks_of_links:
            probability = np.load(keys.links.folder / PROBABILITY)
        elif inputs.config.finds_masks:
            probability = self.found(linked)
        if probability is not None and keys.outlines:
            kept = inputs.finds_masks_of_links
            masks = self.kept_outlines(keys.links.folder) if kept else self.outlined(probability, linked)
        random = generator(inputs.seed, "structure")
        return build_motion(inputs.sides, points, targets, confidence, masks, probability, random, folder)

    def linked(self) -> tuple[npt.NDArray[np.float32], PackedPositions, npt.NDArray[np.uint8]]:
        """Points, targets and confidence of the stage `links`."""
        files = (self.keys.links.folder / f"{name}.npy" for name in ("points", "targets", "confidence"))
        points, targets, confidence = (np.load(file, mmap_mode="r") for file in files)
        return np.asarray(points), PackedPositions(targets, self.inputs.longer_side), confidence
