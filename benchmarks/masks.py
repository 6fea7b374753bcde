"""How well the `auto` masks find what moves: intersection over union with masks drawn by hand.

    python benchmarks/masks.py ../shared/data/tapvid_davis32_dev.pkl ../shared/data/davis32_dev_mask.npz

The second file holds a boolean array [frame, H, W] for each clip of the first, by name. Flow and links are those of
the preset, from the cache where they were prepared before. Every figure is a mean over the clip's frames.
"""

from __future__ import annotations

import time
from statistics import fmean

import click
import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import read_dataset
from decomotion.clip import Clip
from decomotion.config import load
from decomotion.data.masks import auto_masks
from decomotion.data.prepare import prepare_in_stages

Mask = npt.NDArray[np.bool_]


def intersection_over_union(mask: Mask, truth: Mask) -> float:
    """Mean over frames of two masks [frame, H, W]; 1 in frames where both are empty."""
    both, either = (mask & truth).sum(axis=(1, 2)), (mask | truth).sum(axis=(1, 2))
    return float(np.where(either > 0, both / np.maximum(either, 1), 1).mean())


@click.command(context_settings={"show_default": True})
@click.argument("dataset", type=click.Path(exists=True))
@click.argument("truth", type=click.Path(exists=True))
@click.option("--clips", help="Names, separated by commas.  [default: all]")
@click.option("--preset", type=click.Choice(["cpu", "paper"]), default="cpu", help="Whose flow and links.")
def main(dataset: str, truth: str, clips: str | None, preset: str) -> None:
    videos, drawn = read_dataset(dataset), np.load(truth)
    config = load(preset, overrides=("data.features=none", "data.masks=none")).data
    click.echo("| clip | IoU | share of the image | true share | seconds for the masks |\n|---|---|---|---|---|")
    scores = []
    for name in clips.split(",") if clips else videos:
        frames = videos[name].frames()
        prepared = prepare_in_stages(Clip(name, frames, 24.0), config, progress=False)
        pool = prepared.pool
        begin = time.monotonic()
        mask = auto_masks(frames, pool.points, pool.targets, pool.confidence, prepared.grid)
        seconds = time.monotonic() - begin
        scores.append(intersection_over_union(mask, drawn[name]))
        click.echo(f"| {name} | {scores[-1]:.3f} | {mask.mean():.3f} | {drawn[name].mean():.3f} | {seconds:.1f} |")
    click.echo(f"| **mean** | {fmean(scores):.3f} | | | |")


if __name__ == "__main__":
    main()
