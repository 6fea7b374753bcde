"""What preparation costs: seconds by stage, disk and memory, what is there for a while included, and a batch's draw.

    python benchmarks/preparation.py ../shared/data/clips/apple.mp4 --frames 100 --size 854x480 --json out.json

The clip is brought to that size and played back and forth to that length. The cache is a folder of its own, removed
at the end.
"""

from __future__ import annotations

import json
import os
import resource
import tempfile
import time
from pathlib import Path

import click
import cv2
import numpy as np

from decomotion import config as configuration
from decomotion.chance import torch_generator
from decomotion.clip import Clip, read_clip
from decomotion.data.batch import Sampler
from decomotion.data.prepare import prepare_in_stages
from decomotion.memory import kept_memory
from harness.usage import Watch, memory_of

MIB = 2**20
DRAWS = 100


def lengthened(clip: Clip, frames: int, size: tuple[int, int]) -> Clip:
    """The clip at (width, height), played back and forth until it has so many frames."""
    there_and_back = [*range(len(clip)), *range(len(clip) - 2, 0, -1)]
    order = [there_and_back[number % len(there_and_back)] for number in range(frames)]
    resized = {
        number: cv2.resize(clip.frames[number], size, interpolation=cv2.INTER_AREA) for number in sorted(set(order))
    }
    return Clip(clip.name, np.stack([resized[number] for number in order]).astype(np.uint8), clip.fps)


@click.command(context_settings={"show_default": True})
@click.argument("clip", type=click.Path(exists=True))
@click.option("--frames", default=100)
@click.option("--size", default="854x480")
@click.option("--preset", default="cpu")
@click.option("--set", "overrides", multiple=True)
@click.option("--json", "out", type=click.Path(path_type=Path))
def main(clip: str, frames: int, size: str, preset: str, overrides: tuple[str, ...], out: Path | None) -> None:
    width, height = (int(side) for side in size.split("x"))
    config = configuration.load(preset, overrides=overrides)
    longer = lengthened(read_clip(clip), frames, (width, height))
    before = memory_of([os.getpid()]).anonymous
    with tempfile.TemporaryDirectory(dir=os.environ.get("DECOMO_CACHE")) as folder:
        os.environ["DECOMO_CACHE"] = folder
        watch = Watch(os.getpid(), [Path(folder)])
        begin = time.perf_counter()
        with kept_memory():  # as the commands do
            prepared = prepare_in_stages(longer, config.data, progress=False)
        seconds = time.perf_counter() - begin
        watch.finish()
        sampler = Sampler(prepared.pool, config.optim)
        draws = []
        for number in range(DRAWS):
            start = time.perf_counter()
            sampler.draw(frames - 1, torch_generator(0, "batch", number))
            draws.append(time.perf_counter() - start)
        record = {
            "clip": clip,
            "frames": frames,
            "size": size,
            "points": prepared.pool.num_points,
            "intervals": prepared.stages[0].facts["intervals"],
            "seconds": seconds,
            "seconds_of_stage": {part: each for stage in prepared.stages for part, each in stage.seconds.items()},
            "pool_mib": sum(stage.bytes for stage in prepared.stages) / MIB,
            "disk_peak_mib": watch.disk / MIB,
            "memory_mib": {
                "frames": float(np.prod(longer.frames.shape)) / MIB,
                "before": before / MIB,
                "peak": watch.anonymous / MIB,
                "peak_with_mapped_files": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            },
            "draw_ms": {"first": 1e3 * draws[0], "median": 1e3 * float(np.median(draws))},
        }
    text = json.dumps(record, indent=1)
    click.echo(text)
    if out is not None:
        out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
