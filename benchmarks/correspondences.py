"""How far the pool's links lie from TAP-Vid's ground truth, by flow estimator, before and after each filter.

    python benchmarks/correspondences.py tapvid_davis32_dev.pkl --estimators dis,raft-small,raft-small-x2 \
        --raft-small ../shared/weights/raft-small.pth --out benchmarks/results/correspondences
    python benchmarks/correspondences.py tapvid_davis32_dev.pkl --out benchmarks/results/correspondences --table

One JSON record for each clip and estimator; those that are there are not made again. Each is the `cpu` preset's pool
with another estimator. A true point that is seen in both frames of a pair is compared with the link of the pool's
nearest point of its frame, shifted to it. Errors in pixels of 256x256.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from statistics import fmean
from typing import Any

import click
import numpy as np

from decomo_eval.dataset import Video, read_dataset
from decomotion import config as configuration
from decomotion.clip import Clip
from decomotion.data.config import DataConfig
from decomotion.data.links.config import FilterConfig
from decomotion.data.links.filtering import Grid, filtered
from decomotion.data.prepare import Preparation, prepare_in_stages
from decomotion.files import replacing

ESTIMATORS: dict[str, tuple[str, tuple[str, ...]]] = {
    "dis": ("dis", ()),
    "raft-small": ("raft-small", ("data.flow.upsample=1",)),
    "raft-small-x2": ("raft-small", ("data.flow.upsample=2",)),
    "raft-large": ("raft-large", ("data.flow.upsample=1",)),
    "raft-large-x2": ("raft-large", ("data.flow.upsample=2",)),
}
"""Their option and settings; x2 on frames enlarged twice."""
GAPS = (1, 4, 16)
RULES: dict[str, dict[str, float | None]] = {
    "linked": {},
    "cycle 3": {"cycle": 3.0},
    "cycle 1": {"cycle": 1.0},
    "appearance 0.5": {"appearance": 0.5},
    "appearance 0": {"appearance": 0.0},
    "cycle 3, appearance 0.5": {"cycle": 3.0, "appearance": 0.5},
    "second look": {"second_look": 0.2},
}
"""`linked`: what linking itself holds to be seen; the others on top of it. Before all of them: every link."""
NEAR = 2.0
"""A true point farther than so many pixels from all pool points of its frame is left out."""


def record_of(video: Video, name: str, estimator: str, config: DataConfig) -> dict[str, Any]:
    prepared = prepare_in_stages(Clip(name, video.frames(), 24.0), config)
    scale = np.array([video.width, video.height])
    true = video.points * scale - 0.5
    gaps = {str(gap): errors_at(gap, true, video.occluded, prepared, config, video) for gap in GAPS}
    return {
        "clip": name,
        "estimator": estimator,
        "commit": subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True).stdout.strip(),
        "frames": video.num_frames,
        "intervals": prepared.stages[0].facts["intervals"],
        "fields": prepared.stages[0].facts["fields"],
        "kept": prepared.stages[0].facts["kept"],
        "seconds": {part: each for stage in prepared.stages for part, each in stage.seconds.items()},
        "gaps": gaps,
    }


def errors_at(
    gap: int, true: np.ndarray, occluded: np.ndarray, prepared: Preparation, config: DataConfig, video: Video
) -> dict[str, dict[str, float | None]]:
    """Median error, share below 4 pixels and kept share of the true points, by rule; `all` before any."""
    pool, grid = prepared.pool, Grid(*prepared.grid, video.height, video.width)
    errors, kept = [], {rule: [] for rule in RULES}
    for first in range(video.num_frames):
        for second in (first - gap, first + gap):
            if not 0 <= second < video.num_frames:
                continue
            seen = ~occluded[:, first] & ~occluded[:, second]
            here, there = true[seen, first], true[seen, second]
            distance = np.linalg.norm(here[:, None] - pool.points[first][None], axis=-1)
            nearest = distance.argmin(axis=1) if len(here) else np.zeros(0, int)
            near = distance[np.arange(len(here)), nearest] < NEAR if len(here) else np.zeros(0, bool)
            nearest, here, there = nearest[near], here[near], there[near]
            led = pool.targets[first, second][nearest] + here - pool.points[first][nearest]
            units = 256 / max(video.height, video.width)
            errors.append(units * np.linalg.norm(led - there, axis=-1))
            for rule, changes in RULES.items():
                rules: FilterConfig = config.filters.model_copy(update=changes)
                arrays = (pool.points, pool.targets, pool.confidence, pool.feature)
                kept[rule].append(filtered((first, second), *arrays, grid, rules)[nearest] > 0)
    of_all = np.concatenate(errors)
    result = {"all": summary(of_all, np.ones(len(of_all), bool))}
    return result | {rule: summary(of_all, np.concatenate(each)) for rule, each in kept.items()}


def summary(errors: np.ndarray, kept: np.ndarray) -> dict[str, float | None]:
    if not kept.any():
        return {"median": None, "below_4": None, "kept": 0.0}
    return {
        "median": float(np.median(errors[kept])),
        "below_4": float((errors[kept] < 4).mean()),
        "kept": float(kept.mean()),
    }


def table(out: Path) -> str:
    """Markdown: a row for each clip and estimator, and the means; then the rules, meant over clips."""
    records = [json.loads(file.read_text()) for file in sorted(out.glob("*.json"))]
    lines = ["| clip | estimator | gap 1: all / linked | gap 4 | gap 16 | kept at 1, 4, 16 | seconds of flow |"]
    lines.append("|---|---|---|---|---|---|---|")
    by_estimator: dict[str, list[dict[str, Any]]] = {}
    for record in sorted(records, key=lambda each: (each["estimator"], each["clip"])):
        by_estimator.setdefault(record["estimator"], []).append(record)
    for estimator, group in by_estimator.items():
        for clip, some in [*((record["clip"], [record]) for record in group), ("**mean**", group)]:
            cells = [
                " / ".join(_mean(some, gap, rule, "median", "{:.2f}") for rule in ("all", "linked")) for gap in GAPS
            ]
            share = ", ".join(_mean(some, gap, "linked", "kept", "{:.0%}") for gap in GAPS)
            seconds = fmean(record["seconds"]["flow"] for record in some)
            lines.append(f"| {clip} | {estimator} | {' | '.join(cells)} | {share} | {seconds:.0f} |")
    lines += ["", "| estimator | rule | " + " | ".join(f"gap {gap}: median, < 4 px, kept" for gap in GAPS) + " |"]
    lines.append("|---|---|---|---|---|")
    for estimator, group in by_estimator.items():
        for rule in ("all", *RULES):
            cells = [
                f"{_mean(group, gap, rule, 'median', '{:.2f}')}, {_mean(group, gap, rule, 'below_4', '{:.1%}')}, "
                f"{_mean(group, gap, rule, 'kept', '{:.1%}')}"
                for gap in GAPS
            ]
            lines.append(f"| {estimator} | {rule} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _mean(records: list[dict[str, Any]], gap: int, rule: str, key: str, form: str) -> str:
    values = [record["gaps"][str(gap)][rule][key] for record in records]
    known = [value for value in values if value is not None]
    return form.format(fmean(known)) if known else "none"


@click.command(context_settings={"show_default": True})
@click.argument("dataset", type=click.Path(exists=True))
@click.option("--clips", help="Names, separated by commas.  [default: all]")
@click.option("--estimators", default="dis", help=f"Of {', '.join(ESTIMATORS)}.")
@click.option("--raft-small", type=click.Path(exists=True), help="Weights.  [default: torchvision's, by download]")
@click.option("--raft-large", type=click.Path(exists=True), help="Weights.  [default: torchvision's, by download]")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the records.")
@click.option("--table", "only_table", is_flag=True, help="Only print the table of the records that are there.")
def main(
    dataset: str,
    clips: str | None,
    estimators: str,
    raft_small: str | None,
    raft_large: str | None,
    out: Path,
    only_table: bool,
) -> None:
    if not only_table:
        videos = read_dataset(dataset)
        weights = {"raft-small": raft_small, "raft-large": raft_large, "dis": None}
        for estimator in estimators.split(","):
            flow, overrides = ESTIMATORS[estimator]
            if weights[flow] is not None:
                overrides = (*overrides, f"data.flow.weights={json.dumps(weights[flow])}")
            # the preset's gaps, whatever they cost: the figures of the estimators are to be compared
            overrides = ("data.flow.intervals=[1, 2, 4, 8]", *overrides)
            config = configuration.load("cpu", overrides=overrides, flow=flow).data
            for name in clips.split(",") if clips else videos:
                file = out / f"{name}.{estimator}.json"
                if not file.is_file():
                    with replacing(file) as temporary:
                        record = record_of(videos[name], name, estimator, config)
                        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    click.echo(table(out))


if __name__ == "__main__":
    main()
