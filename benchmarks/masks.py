"""How well the `auto` masks find what moves: intersection over union with masks drawn by hand.

    python benchmarks/masks.py ../shared/data/tapvid_davis32_dev.pkl ../shared/data/davis32_dev_mask.npz --ablate

The second file holds a boolean array [frame, H, W] for each clip of the first, by name. Flow and links are those of
the preset, from the cache where they were prepared before. Every figure is a mean over the clip's frames. A column of
the ablation leaves out one part of the method; with `--network isnet.onnx` one has the outlines that IS-Net draws.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import fmean
from types import ModuleType
from typing import Any

import click
import numpy as np

from decomo_eval.dataset import read_dataset
from decomotion.chance import generator
from decomotion.clip import Clip
from decomotion.config import load
from decomotion.data.masks import cameras, consistency, evidence, labelling
from decomotion.data.masks.auto import moving_probability, rendered
from decomotion.data.masks.isnet import Isnet
from decomotion.data.masks.links import Links
from decomotion.data.masks.outlines import outlined
from decomotion.data.prepare import prepare_in_stages
from harness.pictures import intersection_over_union

ABLATIONS: dict[str, tuple[ModuleType, str, Any]] = {
    "homography alone": (evidence, "EPIPOLAR_TRUST", ((0.0, 0.0), (1.0, 0.0))),
    "epipolar alone": (evidence, "EPIPOLAR_TRUST", ((0.0, 1.0), (1.0, 1.0))),
    "border not preferred": (cameras, "INTERIOR_WEIGHT", 1.0),
    "each pair its own scene": (consistency, "AGREES", -2.0),
    "colours not compared": (labelling, "CHANGE_RANGE", (-1.0, 0.0)),
    "threshold 1 px": (labelling, "otsu", lambda _: 0.0),
    "threshold of the clip": (labelling, "NEIGHBOURS", 10**6),
    "far frames not heard": (labelling, "CARRIED_WEIGHT", 0.0),
    "not averaged along links": (labelling, "SMOOTHED", 0),
    "no neighbours": (labelling, "SPATIAL_WEIGHT", 0.0),
}
"""What is left out: the module's name that gets another value."""


@contextmanager
def exchanged(module: ModuleType, name: str, value: Any) -> Iterator[None]:
    """Another value for a module's name, for a while."""
    former = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, former)


@click.command(context_settings={"show_default": True})
@click.argument("dataset", type=click.Path(exists=True))
@click.argument("truth", type=click.Path(exists=True))
@click.option("--clips", help="Names, separated by commas.  [default: all]")
@click.option("--preset", type=click.Choice(["cpu", "paper"]), default="cpu", help="Whose flow and links.")
@click.option("--set", "overrides", multiple=True, help="Settings of the links, as data.flow.intervals=[1,2].")
@click.option("--ablate", is_flag=True, help="Also without each part of the method.")
@click.option("--network", help="IS-Net's file: also with its outlines.")
def main(
    dataset: str,
    truth: str,
    clips: str | None,
    preset: str,
    overrides: tuple[str, ...],
    ablate: bool,
    network: str | None,
) -> None:
    videos, drawn = read_dataset(dataset), np.load(truth)
    config = load(preset, overrides=("data.features=none", "data.masks=none", *overrides)).data
    without = tuple(ABLATIONS if ablate else ())
    isnet = None if network is None else Isnet(network)
    columns = ["auto", *without, *(["isnet"] if isnet is not None else [])]
    click.echo(f"| clip | moves | found | seconds | {' | '.join(columns)} |\n|{'---|' * (4 + len(columns))}")
    table = []
    for name in clips.split(",") if clips else videos:
        frames = videos[name].frames()
        prepared = prepare_in_stages(Clip(name, frames, 24.0), config, progress=False)
        pool = prepared.pool

        sides = frames.shape[1:3]
        linked = (frames, pool.points, pool.targets, pool.confidence, prepared.grid, sides)
        begin = time.monotonic()
        probability = moving_probability(*linked, generator(0, "masks"))
        found = rendered(probability, sides)
        seconds = time.monotonic() - begin
        scores = [intersection_over_union(found, drawn[name])]
        for column in without:
            with exchanged(*ABLATIONS[column]):
                other = rendered(moving_probability(*linked, generator(0, "masks")), sides)
                scores.append(intersection_over_union(other, drawn[name]))
        if isnet is not None:
            links = Links(*linked[1:])
            other = np.stack(list(outlined(frames, probability, links, isnet, generator(0, "outlines"))))
            scores.append(intersection_over_union(other, drawn[name]))
        table.append(scores)
        figures = " | ".join(f"{score:.3f}" for score in scores)
        click.echo(f"| {name} | {drawn[name].mean():.1%} | {found.mean():.1%} | {seconds:.1f} | {figures} |")
    means = " | ".join(f"{fmean(column):.3f}" for column in zip(*table, strict=True))
    click.echo(f"| **mean** | | | | {means} |")


if __name__ == "__main__":
    main()
