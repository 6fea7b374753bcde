"""Time, memory and operations of one optimisation step of the `paper` preset at full size.

    python benchmarks/paper_step.py [--feature-size 768] [--steps 2] [--autocast bf16] [--set KEY=VALUE] [--json FILE]

Full size: 8 pairs x 256 points x 32 samples, 768-channel features (as DINO's), a 256x256 clip of 32 frames. The clip
and its correspondences are random: a step costs the same whatever they show.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from torch.utils.flop_counter import FlopCounterMode

from decomotion import config as configuration
from decomotion.chance import first_weights
from decomotion.checkpoint import ClipFacts
from decomotion.data.pool import Pool
from decomotion.geometry import ImagePlane
from decomotion.model.fusion import DecoMotion
from decomotion.run import Run
from decomotion.train import start_maps


def random_pool(frames: int, points: int, size: int, feature_size: int) -> Pool:
    random = np.random.default_rng(0)
    xy = random.uniform(0, size - 1, (frames, points, 2)).astype(np.float32)
    targets = xy[:, None] + random.normal(0, 4, (frames, frames, points, 2)).astype(np.float32)
    feature = random.normal(0, 1, (frames, points, feature_size)).astype(np.float16)
    still = np.tile(np.eye(2, 3, dtype=np.float32), (frames, 1, 1))
    return Pool(
        points=xy,
        targets=targets,
        confidence=np.full((frames, frames, points), 255, np.uint8),
        rgb=random.integers(256, size=(frames, points, 3), dtype=np.uint8),
        feature=feature,
        moving=(random.random((frames, points)) < 0.2).astype(np.uint8),
        camera=still,
        object=still,
        longer_side=size,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--feature-size", type=int, default=768)
    parser.add_argument("--steps", type=int, default=2)
    parser.add_argument(
        "--autocast", choices=["none", "bf16"], help="precision of hidden layers; default: the preset's"
    )
    parser.add_argument("--set", action="append", default=[], dest="overrides")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()

    overrides = tuple(arguments.overrides)
    if arguments.autocast is not None:
        overrides += (f"optim.autocast={arguments.autocast}",)
    config = configuration.load("paper", overrides=overrides)
    pool = random_pool(32, 2048, 256, arguments.feature_size)
    starts = (start_maps("identity", pool), start_maps("identity", pool))
    with first_weights(0):
        model = DecoMotion(config.model, ImagePlane(256, 256), starts, arguments.feature_size)
    clip = ClipFacts("random", "", 32, 256, 256, 24.0)
    run = Run(Path(tempfile.mkdtemp()), clip, config, model, pool, seed=0)
    seconds = []
    for _ in range(arguments.steps):
        begin = time.perf_counter()
        run.optimise(0.2)
        run.step += 1
        seconds.append(round(time.perf_counter() - begin, 2))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    with FlopCounterMode(display=False) as counter:
        run.optimise(0.2)
    record = {
        "seconds": seconds,
        "peak_rss_gib": round(peak, 2),
        "tflop_in_matrix_products": round(counter.get_total_flops() / 1e12, 2),
        "parameters": sum(parameter.numel() for parameter in model.parameters()),
        "torch": torch.__version__,
        "threads": torch.get_num_threads(),
        "machine": platform.processor() or platform.machine(),
        "autocast": config.optim.autocast,
        "overrides": overrides,
    }
    print(json.dumps(record, indent=2))
    if arguments.json:
        arguments.json.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
