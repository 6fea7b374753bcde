"""How fast an exported model answers: ratios to torch and to OmniMotion's way of asking, all measured in one run.

    python benchmarks/runtime.py RUN [--bake none,depth,full] [--precision fp32] [--queries 1,64,4096] [--json FILE]

RUN is a run folder of `decomo-train`. It is exported once for each bake; all answers are positions and occlusion in
32 frames, or of a whole frame in one other frame. Times are the best of `--repeats`. Rows:

    <bake>            the file, asked through `decomo_runtime.Tracker`
    <bake>, torch     the same in torch eager: tracks and occlusion, without the queries' own colours
    omnimotion's way  torch eager, the same weights: all K samples of a query's ray are mapped to every frame and
                      composited there (the paper's Eq. 5); for occlusion, the ray of each answer is rendered and the
                      depths compared

Operations are those of matrix products alone, as torch counts them, against this machine's rate in a large product.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from decomo_export import export
from decomo_export.baking import Bake
from decomo_export.graph import QueryGraph
from decomo_export.precision import Precision
from decomo_runtime import Tracker
from decomotion import checkpoint
from decomotion.compositing import composite
from decomotion.model.fusion import DecoMotion
from harness.records import Record, provenance

COLD = """
import sys, time
begin = time.perf_counter()
from decomo_runtime import Tracker
Tracker(sys.argv[1], threads=int(sys.argv[2])).track([(0, 10.0, 10.0)])
print(time.perf_counter() - begin)
"""
PEAK = """
import re, sys
from pathlib import Path
import numpy as np
from decomo_runtime import Tracker

def peak():  # not ru_maxrss, which counts what the parent held when it forked
    return int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 1024

tracker = Tracker(sys.argv[1], threads=int(sys.argv[2]))
tracker.track([(0, 10.0, 10.0)])
before = peak()
queries = np.random.default_rng(0).uniform(0, [1, tracker.width - 1, tracker.height - 1], (4096, 3))
tracker.track(np.floor(queries))
print(peak() - before, before)
"""


def best_of(repeats: int, ask: Callable[[], object]) -> float:
    """Seconds of the fastest of `repeats` calls, after one that warms up."""
    ask()
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        ask()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


def matrix_rate(repeats: int) -> float:
    """Floating-point operations a second of this machine in a float32 product of 2048 x 2048 matrices, in torch."""
    size = 2048
    left, right = torch.rand(size, size), torch.rand(size, size)
    return 2 * size**3 / best_of(repeats, lambda: left @ right)


@torch.no_grad()
def omnimotion_way(model: DecoMotion, queries: Tensor, frames: Tensor) -> tuple[Tensor, Tensor]:
    """Places [frame, query, 2] and whether the surface there is nearer [frame, query]."""
    conditioning = model.condition(torch.arange(model.num_frames))
    places, hidden = [], []
    frame, xy = queries[:, 0].long(), queries[:, 1:]
    rays = model.cast(xy[:, None], conditioning, frame)
    samples = rays.static_canonical.shape[2]
    for target in frames.tolist():
        there = torch.full_like(frame, target)
        u = model.static.from_canonical(rays.static_canonical[:, 0], conditioning.static, there)
        v = model.dynamic.from_canonical(rays.dynamic_canonical[:, 0], conditioning.dynamic, there)
        local = composite(rays.fused_static[:, 0], u) + composite(rays.fused_dynamic[:, 0], v)
        local = local / rays.opacity.clamp_min(1e-3)
        place = model.plane.to_pixels(local[:, :2])
        seen = model.cast(place[:, None], conditioning, there)
        weights = seen.fused_static + seen.fused_dynamic
        depth = composite(weights, seen.depths[..., None])[:, 0, 0] / seen.opacity[:, 0].clamp_min(1e-6)
        places.append(place)
        hidden.append(local[:, 2] > depth + 2 / samples)
    return torch.stack(places), torch.stack(hidden)


def child(code: str, path: Path, threads: int) -> list[float]:
    """The numbers that `code` prints in a process of its own."""
    asked = [sys.executable, "-c", code, str(path), str(threads)]
    return [float(word) for word in subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()]


def measure_bake(
    folder: Path,
    run: Path,
    bake: Bake,
    precision: Precision,
    counts: list[int],
    repeats: int,
    threads: int,
    whole_frame: bool,
) -> Record:
    """All figures of one bake; `p99_pixels` is the file's distance from float32's tracks."""
    path = folder / f"{bake}.onnx"
    begin = time.perf_counter()
    exported = export(path, run, bake=bake, precision=precision, force=True)
    record: Record = {
        "export_seconds": time.perf_counter() - begin,
        "mib": exported.bytes / 2**20,
        "mean_pixels": exported.deviation.mean,
        "p99_pixels": exported.deviation.p99,
    }
    tracker = Tracker(path, threads=threads)
    graph = QueryGraph(checkpoint.load(run / checkpoint.FILE_NAME).model.eval(), bake).eval()
    frames = np.arange(min(32, tracker.num_frames))
    for count in counts:
        queries = random_queries(tracker, count)
        seconds = best_of(repeats, lambda queries=queries: tracker.track(queries, frames))
        record[f"{count}_seconds"] = seconds
        record[f"{count}_point_frames_per_second"] = count * len(frames) / seconds
    if whole_frame:
        record["whole_frame_seconds"] = best_of(repeats, lambda: tracker.dense(0, to=len(frames) - 1))

    many = random_queries(tracker, max(counts))
    asked = torch.from_numpy(many), torch.from_numpy(frames)
    chunk = max(1, 2**26 // graph.bytes_per_ray // (1 + len(frames)))  # as the runtime's default
    with torch.no_grad():
        eager = best_of(repeats, lambda: [graph.track(part, asked[1]) for part in asked[0].split(chunk)])
        with FlopCounterMode(display=False) as counter:
            graph.track(asked[0][:chunk], asked[1])
    flops = counter.get_total_flops() * len(many) / len(many[:chunk])
    record["torch_eager_seconds"] = eager
    record["faster_than_torch"] = eager / float(record[f"{max(counts)}_seconds"])
    record["matrix_gflop"] = flops / 1e9
    record["matrix_gflop_per_second"] = flops / 1e9 / float(record[f"{max(counts)}_seconds"])
    record["cold_start_seconds"] = min(child(COLD, path, threads)[0] for _ in range(repeats))
    record["peak_mib_above_first_answer"], record["mib_after_first_answer"] = child(PEAK, path, threads)
    return record


def random_queries(tracker: Tracker, count: int) -> np.ndarray:
    random = np.random.default_rng(0)
    place = random.uniform(0, [tracker.width - 1, tracker.height - 1], (count, 2))
    return np.column_stack([random.integers(tracker.num_frames, size=count), place]).astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--bake", default="none,depth,full")
    parser.add_argument("--precision", choices=get_args(Precision), default="fp32", help="of the files' weights")
    parser.add_argument("--queries", default="1,64,4096")
    parser.add_argument("--no-whole-frame", action="store_true", help="leave it out: minutes with the paper preset")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    counts = [int(text) for text in arguments.queries.split(",")]

    record: Record = {
        **provenance(),
        "threads": arguments.threads,
        "precision": arguments.precision,
        "fp32_matrix_gflop_per_second": matrix_rate(arguments.repeats) / 1e9,
    }
    with tempfile.TemporaryDirectory() as folder:
        for bake in arguments.bake.split(","):
            record[bake] = measure_bake(
                Path(folder),
                arguments.run,
                bake,
                arguments.precision,
                counts,
                arguments.repeats,
                arguments.threads,
                not arguments.no_whole_frame,
            )
        tracker = Tracker(Path(folder) / f"{arguments.bake.split(',')[0]}.onnx")
        queries = torch.from_numpy(random_queries(tracker, max(counts)))
        frames = torch.arange(min(32, tracker.num_frames))
    model = checkpoint.load(arguments.run / checkpoint.FILE_NAME).model.eval()
    seconds = best_of(1, lambda: omnimotion_way(model, queries, frames))
    record["omnimotion_way_seconds"] = seconds
    for bake in arguments.bake.split(","):
        of_bake = record[bake]
        of_bake["faster_than_omnimotion_way"] = seconds / of_bake[f"{max(counts)}_seconds"]
        share = of_bake["matrix_gflop_per_second"] / record["fp32_matrix_gflop_per_second"]
        of_bake["share_of_matrix_rate"] = share
    print(json.dumps(record, indent=2))
    if arguments.json:
        arguments.json.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
