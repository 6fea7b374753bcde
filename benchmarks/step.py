"""Time, memory and operations of one optimisation step of a preset at full size, on a CPU or a GPU.

    python benchmarks/step.py [--preset paper] [--steps 2] [--set KEY=VALUE] [--json FILE]
    python benchmarks/step.py --preset cpu --device cuda --steps 200 [--launched] [--profile]

A 256x256 clip of 32 frames; `paper` has 8 pairs x 256 points x 32 samples and 768-channel features (as DINO's). The
clip and its correspondences are random: a step costs the same whatever they show. On a GPU a step is a recorded CUDA
graph, unless it is `--launched` operation by operation. Memory of a GPU is what torch holds of it.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from torch.profiler import ProfilerActivity, profile
from torch.utils.flop_counter import FlopCounterMode

from decomotion import config as configuration
from decomotion.chance import first_weights
from decomotion.checkpoint import ClipFacts
from decomotion.data.pool import Pool
from decomotion.geometry import ImagePlane
from decomotion.gradient import Accumulator
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


def bfloat16_rate(side: int = 8192, products: int = 10) -> float:
    """TFLOP/s of a large product of random matrices in bfloat16, on the GPU."""
    first, second = (torch.randn(side, side, dtype=torch.bfloat16, device="cuda") for _ in range(2))
    for _ in range(3):
        torch.mm(first, second)
    begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
    begin.record()
    for _ in range(products):
        torch.mm(first, second)
    end.record()
    torch.cuda.synchronize()
    return products * 2 * side**3 / begin.elapsed_time(end) / 1e9


def timed_steps(run: Run, steps: int) -> list[float]:
    """Seconds of each step: it ends with a wait for the GPU."""
    seconds = []
    for _ in range(steps):
        begin = time.perf_counter()
        run.optimise(0.2)
        run.step += 1
        seconds.append(time.perf_counter() - begin)
    return seconds


def print_profile(run: Run) -> None:
    """What takes the time of five steps."""
    on_gpu = run.gradient.device.type == "cuda"
    with profile(activities=[ProfilerActivity.CPU, *[ProfilerActivity.CUDA] * on_gpu]) as spent:
        timed_steps(run, 5)
    order = "self_cuda_time_total" if on_gpu else "self_cpu_time_total"
    print(spent.key_averages().table(sort_by=order, row_limit=25, max_name_column_width=70))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", choices=["cpu", "paper"], default="paper")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--steps", type=int, default=2)
    parser.add_argument("--launched", action="store_true", help="on a GPU: without a CUDA graph")
    parser.add_argument("--profile", action="store_true", help="print what takes a step's time")
    parser.add_argument("--set", action="append", default=[], dest="overrides")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()

    config = configuration.load(arguments.preset, overrides=tuple(arguments.overrides))
    points, features = (2048, 768) if arguments.preset == "paper" else (8192, config.data.feature_size)
    pool = random_pool(32, points, 256, features)
    starts = (start_maps("identity", pool), start_maps("identity", pool))
    with first_weights(0):
        model = DecoMotion(config.model, ImagePlane(256, 256), starts, features).to(arguments.device)
    clip = ClipFacts("random", "", 32, 256, 256, 24.0)
    run = Run(Path(tempfile.mkdtemp()), clip, config, model, pool, seed=0)
    on_gpu = run.gradient.device.type == "cuda"
    if arguments.launched:
        run.gradient = Accumulator(model, config.optim.smooth_share, recorded=False)
    first = timed_steps(run, 1)  # with what is chosen, or recorded, once
    if on_gpu:
        timed_steps(run, 10)
        torch.cuda.reset_peak_memory_stats()
    seconds = timed_steps(run, arguments.steps)
    held = torch.cuda.max_memory_reserved() if on_gpu else 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if arguments.profile:
        print_profile(run)
    recorded = run.gradient.recorded
    run.gradient = Accumulator(model, config.optim.smooth_share, recorded=False)
    with FlopCounterMode(display=False) as counter:  # it sees operations, not what is recorded; and takes much memory
        timed_steps(run, 1)
    tflop = counter.get_total_flops() / 1e12
    record = {
        "preset": arguments.preset,
        "first_step_seconds": round(first[0], 4),
        "seconds": round(statistics.median(seconds), 5),
        "longest_seconds": round(max(seconds), 5),
        "peak_rss_gib": round(peak / 2**20, 2),
        "tflop_in_matrix_products": round(tflop, 4),
        "parameters": sum(parameter.numel() for parameter in model.parameters()),
        "torch": torch.__version__,
        "threads": torch.get_num_threads(),
        "machine": platform.processor() or platform.machine(),
        "autocast": config.optim.autocast,
        "micro_batch": config.optim.micro_batch,
        "overrides": arguments.overrides,
    }
    if on_gpu:
        rate = bfloat16_rate()
        record |= {
            "gpu": torch.cuda.get_device_name(),
            "recorded": recorded,
            "peak_gpu_gib": round(held / 2**30, 2),
            "bfloat16_tflop_per_second": round(rate),
            "share_of_bfloat16_rate": round(tflop / statistics.median(seconds) / rate, 4),
        }
    print(json.dumps(record, indent=2))
    if arguments.json:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
