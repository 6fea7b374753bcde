"""How long scoring takes: our metrics and TAP-Vid's official function, on the same arrays in one run.

    python benchmarks/scoring.py evaluation_datasets.py [--videos 30] [--queries 3000] [--frames 80] [--json FILE]

The file is `tapnet/tapvid/evaluation_datasets.py` of google-deepmind/tapnet (Apache-2.0), which is no part of this
project: `compute_tapvid_metrics` is taken out of it alone, and none of the libraries it names are needed. Both get one
video after the other, best of three calls each, and have to return the same numbers.
"""

from __future__ import annotations

import ast
import hashlib
import json
import resource
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from decomo_eval.measure import score
from decomo_eval.metrics import tapvid_metrics
from decomo_eval.predictions import Prediction
from decomo_eval.query_mode import STRIDED
from decomo_eval.tapvid import Queries
from decomotion.console import run
from harness.records import Record, provenance, write_record

OFFICIAL = "compute_tapvid_metrics"
REPEATS = 3

Metrics = Callable[..., Mapping[str, np.ndarray]]


def official_function(path: Path) -> tuple[Metrics, str]:
    """The function of that name in a source file, and a short hash of its statements, comments left out."""
    parts = ast.parse(path.read_text(encoding="utf-8")).body
    found = next((part for part in parts if isinstance(part, ast.FunctionDef) and part.name == OFFICIAL), None)
    if found is None:
        raise click.UsageError(f"{path} has no function {OFFICIAL}; it must be tapnet's evaluation_datasets.py")
    names: dict[str, Any] = {"np": np, "Mapping": Mapping}
    exec(compile(ast.Module([found], []), str(path), "exec"), names)
    statements = found.body[ast.get_docstring(found) is not None :]
    return names[OFFICIAL], hashlib.sha256(ast.unparse(ast.Module(statements, [])).encode()).hexdigest()[:12]


def random_video(number: int, queries: int, frames: int) -> tuple[Queries, Prediction]:
    """True tracks that wander, a third of them hidden, and answers a few pixels off."""
    random = np.random.default_rng(number)
    tracks = random.uniform(0, 256, (queries, 1, 2)) + random.normal(0, 2, (queries, frames, 2)).cumsum(axis=1)
    occluded = random.random((queries, frames)) < 0.33
    frame = random.integers(frames, size=queries)
    points = np.column_stack([frame.astype(np.float64), tracks[np.arange(queries), frame, ::-1]])
    answers = tracks + random.normal(0, 4, tracks.shape)
    wrong = random.random(occluded.shape) < 0.1
    return Queries(points, tracks, occluded), Prediction(answers, occluded ^ wrong, (256, 256))


def best(ask: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of the fastest of some calls, and what it returned."""
    seconds, answer = [], None
    for _ in range(REPEATS):
        begin = time.perf_counter()
        answer = ask()
        seconds.append(time.perf_counter() - begin)
    return min(seconds), answer


@click.command(context_settings={"show_default": True})
@click.argument("official", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--videos", type=click.IntRange(min=1), default=30)
@click.option("--queries", type=click.IntRange(min=1), default=3000, help="Of each video.")
@click.option("--frames", type=click.IntRange(min=2), default=80, help="Of each video; TAP-Vid-DAVIS has 34 to 104.")
@click.option("--json", "record_path", type=click.Path(path_type=Path), help="Write the record there.")
def main(official: Path, videos: int, queries: int, frames: int, record_path: Path | None) -> None:
    """Time `decomo_eval.tapvid_metrics` against the function in OFFICIAL."""
    function, digest = official_function(official)
    totals = {"official_seconds": 0.0, "seconds": 0.0, "all_metrics_seconds": 0.0}
    for number in range(videos):
        asked, answered = random_video(number, queries, frames)
        arrays = {
            "query_points": asked.points[None],
            "gt_occluded": asked.occluded[None],
            "gt_tracks": asked.tracks[None],
            "pred_occluded": answered.occluded[None],
            "pred_tracks": answered.tracks[None],
        }
        theirs, expected = best(lambda arrays=arrays: function(**arrays, query_mode=STRIDED))
        ours, found = best(lambda arrays=arrays: tapvid_metrics(**arrays, query_mode=STRIDED))
        for name, value in expected.items():
            np.testing.assert_array_equal(found[name], value, err_msg=name)
        everything, _ = best(lambda a=asked, b=answered: score(a, b, STRIDED))
        for key, seconds in zip(totals, (theirs, ours, everything), strict=True):
            totals[key] += seconds
    record: Record = {
        "videos": videos,
        "queries": queries,
        "frames": frames,
        "official_function": digest,
        **{key: float(f"{seconds:.4g}") for key, seconds in totals.items()},
        "times_as_fast": round(totals["official_seconds"] / totals["seconds"], 2),
        "peak_rss_mib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        **provenance(),
    }
    click.echo(json.dumps(record, indent=2))
    if record_path is not None:
        write_record(record_path, record)


if __name__ == "__main__":
    sys.exit(run(main))
