"""Accuracy of whole runs: for each row, clip and seed prepare, train, export and score; one JSON record each.

    python benchmarks/accuracy.py ../shared/data/tapvid_davis32_dev.pkl \
        --object-masks ../shared/data/davis32_dev_mask.npz --time-budget 10m --seeds 0,1 --out benchmarks/results/10m
    python benchmarks/accuracy.py procedural --time-budget 10m --out benchmarks/results/procedural
    python benchmarks/accuracy.py ../shared/data/tapvid_davis32_dev.pkl --series benchmarks/series/decomposition.yaml \
        --object-masks ../shared/data/davis32_dev_mask.npz

Runs one after the other, each stage as the command that a user would type. What has a record is not run again, so a
series goes on after an interruption, in another session, or with more clips. `benchmarks/table.py` makes the tables,
`benchmarks/plots.py` the plots.
"""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from decomo_eval.dataset import write_frames
from decomo_eval.predictions import from_model
from decomotion import checkpoint
from decomotion.clip import read_clip
from decomotion.config import Config
from decomotion.console import run
from decomotion.data.prepare import prepare
from harness.clips import BenchmarkClip, read_clips
from harness.records import Record, config_digest, is_done, provenance, score_clip, write_record
from harness.series import Row, read_series
from harness.usage import StageError, measured, toolkit

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True)
class Job:
    """One fit to be made and scored."""

    row: Row
    config: Config
    clip: str
    seed: int

    def facts(self) -> Record:
        """What identifies the job in its record."""
        return {**self.row.settings(), "config": config_digest(self.config), "clip": self.clip, "seed": self.seed}

    def place(self, root: Path, suffix: str = "") -> Path:
        """Where the job's files lie below `root`."""
        return root / self.row.name / f"{self.clip}-seed{self.seed}{suffix}"


def fit(job: Job, clip: BenchmarkClip, work: Path) -> Record:
    """Trains, exports and scores one model; what its record says of that."""
    here, row = job.place(work), job.row
    frames, folder, model = write_frames(clip.video, here / job.clip), here / "run", here / f"{job.clip}.onnx"
    stages = {}
    if not row.rebuild_cache:
        begin = time.monotonic()
        prepare(read_clip(frames), job.config.data, seed=job.seed, progress=False)
        stages["prepare"] = {"seconds": round(time.monotonic() - begin, 1)}
    budget = ["--steps", str(row.steps)] if row.steps else ["--time-budget", str(row.time_budget)]
    options = ["--preset", row.preset, *budget, "--seed", str(job.seed), *["--rebuild-cache"] * row.rebuild_cache]
    overrides = [part for override in row.overrides for part in ("--set", override)]
    stages["train"] = measured(toolkit("decomo-train", frames, "--out", folder, *options, *overrides))
    fitted = checkpoint.load(folder / checkpoint.FILE_NAME)
    training, quality = fitted.training, None if fitted.quality is None else asdict(fitted.quality)
    stages["train"] |= {"prepare_seconds": round(training["prepared"], 1), "steps": training["step"]}
    stages["export"] = measured(toolkit("decomo-export", model, "--run", folder))
    begin = time.monotonic()
    scores = score_clip(clip, functools.partial(from_model, model, clip.video))
    stages["score"] = {"seconds": round(time.monotonic() - begin, 1)}
    return {"stages": stages, "model_bytes": model.stat().st_size, "quality": quality, **scores}


def names(text: str | None) -> tuple[str, ...] | None:
    """The parts of a list separated by commas."""
    return tuple(text.split(",")) if text else None


def clips_of(rows: Sequence[Row]) -> tuple[str, ...] | None:
    """The clips that any of the rows names; None where one of them takes all."""
    wanted = [row.clips for row in rows]
    return None if None in wanted else tuple(dict.fromkeys(clip for clips in wanted for clip in clips or ()))


@click.command(context_settings={"show_default": True})
@click.argument("dataset")
@click.option("--object-masks", type=click.Path(exists=True, path_type=Path), help="Splits scores: .npz by clip name.")
@click.option("--series", type=click.Path(exists=True, path_type=Path), help="YAML file of rows, instead of the next.")
@click.option("--preset", "presets", multiple=True, default=("cpu",), help="One row each.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Of every row.")
@click.option("--name", help="Of the row, where there is one preset.  [default: the preset's]")
@click.option("--time-budget", default="10m", help="As for decomo-train.")
@click.option("--seeds", default="0", help="Separated by commas.")
@click.option("--clips", help="Names, separated by commas.  [default: the series', or all]")
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the records.  [default: results/<series>]")
@click.option("--work", type=click.Path(path_type=Path), default=Path("/tmp/decomotion-accuracy"), help="Runs, models.")
def main(
    dataset: str,
    object_masks: Path | None,
    series: Path | None,
    presets: tuple[str, ...],
    overrides: tuple[str, ...],
    name: str | None,
    time_budget: str,
    seeds: str,
    clips: str | None,
    out: Path | None,
    work: Path,
) -> None:
    """Fit, export and score clips of DATASET: a TAP-Vid pickle, or the word `procedural`."""
    if series is not None and (overrides or name):
        raise click.UsageError("--set and --name are of rows that the command line describes; leave them out")
    if series is not None:
        rows = read_series(series).rows
    else:
        common = {"overrides": overrides, "time_budget": time_budget, "seeds": seeds.split(",")}
        rows = [Row.model_validate({"name": name or preset, "preset": preset, **common}) for preset in presets]
    out = out or (RESULTS / series.stem if series is not None else None)
    if out is None:
        raise click.UsageError("give --out, or a --series, whose name it takes")
    known = read_clips(dataset, names(clips) or clips_of(rows), object_masks)
    jobs = []
    for row in rows:
        here = {clip: row.on(clip) for clip in known if clips or row.clips is None or clip in row.clips}
        configs = {clip: each.config() for clip, each in here.items()}
        jobs += [Job(here[clip], configs[clip], clip, seed) for seed in row.seeds for clip in here]
    # a record of another configuration stops the series here, not after hours
    left = [job for job in jobs if not is_done(job.place(out, ".json"), job.facts())]
    click.echo(f"{len(jobs)} fits, {len(jobs) - len(left)} of them done")
    failed = 0
    for job in left:
        about = {"row": job.row.name, **job.facts(), "dataset": Path(dataset).name, **provenance()}
        try:
            record = about | fit(job, known[job.clip], work / out.name)
        except StageError as error:
            failed += 1
            click.echo(f"Error: {error}", err=True)
            continue
        write_record(job.place(out, ".json"), record)
        strided = record["metrics"]["strided"]
        click.echo(
            f"{job.row.name} {job.clip} seed {job.seed}: AJ {strided['average_jaccard']:.3f}, "
            f"delta {strided['average_pts_within_thresh']:.3f}"
        )
    if failed:
        raise click.ClickException(f"{failed} of {len(left)} fits failed; the same command tries them again")


if __name__ == "__main__":
    sys.exit(run(main))
