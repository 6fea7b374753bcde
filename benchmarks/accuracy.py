"""Accuracy of whole runs: for each clip of a TAP-Vid pickle, train, export and score; one JSON record a clip.

    python benchmarks/accuracy.py ../shared/data/tapvid_davis32_dev.pkl --clips goat,breakdance \
        --time-budget 10m --out benchmarks/results/cpu-10m

Runs one clip after the other, each stage as the command that a user would type. A clip whose record exists is not
run again, so that a series can go on after an interruption. `benchmarks/table.py` makes the table.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
import cv2

from decomo_eval import evaluate
from decomo_eval.dataset import read_dataset
from decomotion import config as configuration
from decomotion.files import replacing


def run_stage(*command: str) -> dict[str, float]:
    """Runs one command; wall seconds and peak resident memory in GiB."""
    begin = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status):
        raise SystemExit(f"{' '.join(command)} failed")
    return {"seconds": round(time.monotonic() - begin, 1), "peak_rss_gib": round(usage.ru_maxrss / 2**20, 2)}


def write_frames(video: Any, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for index, frame in enumerate(video.frames()):
        cv2.imwrite(str(folder / f"{index:05d}.png"), cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))


def machine() -> dict[str, Any]:
    processor = platform.processor()
    if Path("/proc/cpuinfo").exists():
        names = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
        processor = names[0].partition(":")[2].strip() if names else processor
    return {"processor": processor, "cores": os.cpu_count(), "system": platform.platform()}


def commit() -> str:
    found = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return found.stdout.strip()


@click.command(context_settings={"show_default": True})
@click.argument("dataset", type=click.Path(exists=True, path_type=Path))
@click.option("--clips", help="Names, separated by commas.  [default: all]")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the records.")
@click.option("--work", type=click.Path(path_type=Path), default=Path("/tmp/decomotion-accuracy"), help="Runs, models.")
@click.option("--preset", default="cpu")
@click.option("--time-budget", default="10m")
@click.option("--seed", default=0)
@click.option("--set", "overrides", multiple=True)
def main(
    dataset: Path,
    clips: str | None,
    out: Path,
    work: Path,
    preset: str,
    time_budget: str,
    seed: int,
    overrides: tuple[str, ...],
) -> None:
    videos = read_dataset(dataset)
    config = configuration.load(preset, overrides=overrides)
    digest = hashlib.sha256(json.dumps(config.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()[:12]
    for name in clips.split(",") if clips else videos:
        record_path = out / f"{name}-seed{seed}.json"
        if record_path.exists():
            continue
        here = work / out.name / f"seed{seed}"
        write_frames(videos[name], here / name / "clip")
        model = here / "models" / f"{name}.onnx"
        options = [part for override in overrides for part in ("--set", override)]
        python = [sys.executable, "-m"]
        stages = {
            "train": run_stage(
                *python, "decomotion.cli", str(here / name / "clip"), "--out", str(here / name / "run"),
                "--preset", preset, "--time-budget", time_budget, "--seed", str(seed), "--rebuild-cache", *options,
            ),
            "export": run_stage(*python, "decomo_export.cli", str(model), "--run", str(here / name / "run")),
        }  # fmt: skip
        metrics = {
            mode: evaluate(dataset, models=model.parent, query_mode=mode, videos=[name]).to_json()["videos"][name]
            for mode in ("strided", "first")
        }
        record = {
            "clip": name,
            "dataset": dataset.name,
            "preset": preset,
            "overrides": overrides,
            "time_budget": time_budget,
            "seed": seed,
            "config": digest,
            "commit": commit(),
            "date": time.strftime("%Y-%m-%d"),
            "machine": machine(),
            "versions": {package: version(package) for package in ("decomotion", "torch", "onnxruntime")},
            "model_bytes": model.stat().st_size,
            "stages": stages,
            "metrics": metrics,
        }
        with replacing(record_path) as temporary:
            temporary.write_text(json.dumps(record, indent=2) + "\n")
        strided = metrics["strided"]
        click.echo(f"{name}: AJ {strided['average_jaccard']:.3f}, delta {strided['average_pts_within_thresh']:.3f}")


if __name__ == "__main__":
    main()
