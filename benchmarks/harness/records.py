"""Records: one JSON file for each clip and seed of a row, `<series>/<row>/<clip>-seed<seed>.json`.

    clip, dataset, row, preset, overrides, seed      what was run; a baseline has no seed
    time_budget or steps, rebuild_cache              how long, and whether preparation came out of that time
    config          hash of the resolved configuration (of a baseline: of its `data`), the same in all records of a row
    commit, date, machine, versions                  of what, when, where; load_average as the run began,
                                                     threads as OMP_NUM_THREADS limits them
    stages          {stage: {seconds, cpu_seconds, peak_rss_gib, peak_anonymous_gib, ...}}, memory as `usage.py` has it;
                    `train` also has prepare_seconds (part of seconds) and steps
    model_bytes     size of the .onnx file; a baseline has none
    metrics         {query mode: {metric: value}} over all points
    splits          {query mode: {static | dynamic | visible | reappeared | out_of_frame: {metric: value, count}}}

`footage.py` writes `<name>/<part>/<clip>.json` with the budget in words and figures of each part
(`full_length.py`, `scenery.py`, `crossing.py`), `propagation.py` likewise with `ways`, of each J and F; a fit that
several parts ask has a record of its own, in `fits`.

A metric that is not defined (nothing to count) is null.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import subprocess
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
import torch
from pydantic import BaseModel

from decomo_eval.measure import score
from decomo_eval.predictions import Prediction
from decomo_eval.query_mode import QUERY_MODES
from decomo_eval.splits import score_splits
from decomo_eval.tapvid import Queries, sample_queries
from decomotion.files import replacing
from harness.clips import BenchmarkClip

Record = dict[str, Any]


def score_clip(clip: BenchmarkClip, track: Callable[[Queries], Prediction]) -> Record:
    """`metrics` and `splits` of a tracker's answers, in every query mode."""
    metrics, splits = {}, {}
    for mode in QUERY_MODES:
        queries = sample_queries(clip.video, mode)
        prediction = track(queries)
        metrics[mode] = score(queries, prediction, mode)
        splits[mode] = score_splits(queries, prediction, mode, clip.object_masks)
    return {"metrics": metrics, "splits": splits}


def provenance() -> Record:
    """Commit, date, machine and versions."""
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parent,
    )
    return {
        "commit": described.stdout.strip(),
        "date": time.strftime("%Y-%m-%d"),
        "machine": {
            "processor": _processor(),
            "cores": os.cpu_count(),
            "threads": os.environ.get("OMP_NUM_THREADS", "all"),
            "system": platform.platform(),
            "load_average": round(os.getloadavg()[0], 1),
            **({"gpu": torch.cuda.get_device_name()} if torch.cuda.is_available() else {}),
        },
        "versions": {package: version(package) for package in ("decomotion", "torch", "onnxruntime")},
    }


def _processor() -> str:
    facts = Path("/proc/cpuinfo")
    lines = facts.read_text().splitlines() if facts.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def config_digest(config: BaseModel) -> str:
    """A short hash of a resolved configuration, or of the part of one that decides the result."""
    content = json.dumps(config.model_dump(mode="json"), sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:12]


def is_done(path: Path, expected: Record) -> bool:
    """Whether the record exists already.

    Raises `click.ClickException` where it does but differs from `expected` in one of its keys: a row's records must
    be of one configuration.
    """
    if not path.is_file():
        return False
    found = json.loads(path.read_text())
    different = [key for key, value in expected.items() if found.get(key) != value]
    if different:
        raise click.ClickException(
            f"{path} was made with another {' and '.join(different)}; move the row's folder away, or give another --out"
        )
    return True


def write_record(path: Path, record: Record) -> None:
    """Writes a record, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(_without_nan(record), indent=2, allow_nan=False) + "\n")


def read_records(folder: Path) -> dict[str, list[Record]]:
    """The records below `folder` by row: by the name of the folder that holds them."""
    rows: dict[str, list[Record]] = {}
    for path in sorted(folder.rglob("*.json")):
        record = json.loads(path.read_text())
        if "metrics" in record:
            rows.setdefault(record.get("row", path.parent.name), []).append(record)
    return rows


def _without_nan(value: Any) -> Any:
    """JSON has no nan: null."""
    if isinstance(value, dict):
        return {key: _without_nan(each) for key, each in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value
