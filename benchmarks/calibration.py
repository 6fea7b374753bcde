"""How far off answers are that the runtime says to be off by e pixels, and the numbers by which it says so.

    python benchmarks/calibration.py ../shared MODEL... --out benchmarks/results/calibration \
        --diagram docs/images/reliability.png --write

MODEL: files and folders of exported models, of clips of TAP-Vid-DAVIS's first 32 frames (SHARED/data's pickles) or at
full length (SHARED/data/davis480p; joints are left out, as they are drawn inside limbs). A model is asked for every
annotated point from every fifth frame; its answers in frames where the point is in sight are compared with the truth.
Each clip weighs the same, whatever its number of models and points. What is reported of a clip comes from numbers that
were fitted to the other clips; `--write` fits them to all and replaces `expected_error.json` of the runtime.
Lengths are in units, pixels of a frame whose longer side is 256.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click
import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import Video, read_dataset
from decomo_eval.query_mode import STRIDED
from decomo_eval.tapvid import raster_to_pixels, sample_queries
from decomo_runtime import Tracker
from decomo_runtime.expected_error import FILE, LOWEST_SCORE, NEAR, TAIL, Calibration, share_within
from decomotion.console import run
from decomotion.files import replacing
from decomotion.units import unit
from decomotion.windows import FILE_NAME
from harness import full_length, markdown
from harness.models import model_files
from harness.records import provenance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHARE = 0.8
"""Of answers told e that are to be within e."""
SCORES = (LOWEST_SCORE, 0.003, 0.01, 0.03, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
GAP_POWERS = tuple(np.arange(0, 1.01, 0.05).round(2).tolist())
QUALITY_POWERS = (0.0, 0.25, 0.5, 0.75, 1.0)
LEAST_TELLING = 3
"""Clips whose models say how good they are; of fewer nothing is learned from it."""
SMALLEST = 0.02
"""Units; errors below it are none."""
PICKLES = ("data/tapvid_davis32_dev.pkl", "data/tapvid_davis32_dev2.pkl")
KINDS = (full_length.FIRST_32, full_length.ENDS)
BINS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, np.inf)
"""Of told errors, in units."""
LIMITS = (1.0, 2.0, 4.0, 8.0)
"""As `--max-error` of a clip of 256 pixels."""
CHANCES = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)
"""To be within `NEAR` of the truth, as likelihoods go by it."""
TAILS = tuple(np.arange(0.8, 2.55, 0.1).round(1).tolist())
FEWEST = 20
"""Answers of a clip in a bin that the diagram shows."""

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Answers:
    """Of one model, to points that are in sight."""

    clip: str
    frames: str
    """Their number and size."""
    median: float | None
    """That its held-out links are missed by."""
    score: Floats
    """[n], occlusion."""
    gap: npt.NDArray[np.int64]
    """[n], frames between query and answer, 1 or more."""
    error: Floats
    """[n], units."""
    refined_error: Floats
    """[n], of the same answers by `Tracker.refine`; NaN where it found nothing."""

    def told(self, calibration: Calibration) -> Floats:
        """[n], what it would say the error is."""
        return calibration.error(self.score, self.gap, self.median)


@dataclass(frozen=True, eq=False)
class Told:
    """Answers, and what is told of them."""

    answers: Answers
    error: Floats
    """[n], units."""
    refined_error: Floats
    """[n], where they are refined."""


def ask(tracker: Tracker, videos: Sequence[Video]) -> Answers:
    """To all annotated points of `videos`, which are one clip with several annotations."""
    side = unit(tracker.height, tracker.width)
    parts: list[tuple[Floats, npt.NDArray[np.int64], Floats, Floats]] = []
    for video in videos:
        wanted = sample_queries(video, STRIDED)
        queries = wanted.in_pixels(tracker.width, tracker.height)
        tracks = tracker.track(queries)
        refined = tracker.refine(tracks, video.frames())
        truth = raster_to_pixels(wanted.tracks, tracker.width, tracker.height)
        gap = np.abs(tracks.frames - queries[:, :1].astype(np.int64))
        kept = ~wanted.occluded & (gap > 0)
        error, refined_error = (np.linalg.norm(each.xy - truth, axis=-1) / side for each in (tracks, refined))
        refined_error[~np.asarray(refined.refined)] = np.nan
        parts.append((tracks.occlusion[kept], gap[kept], error[kept], refined_error[kept]))
    score, gap, error, refined_error = (np.concatenate(each) for each in zip(*parts, strict=True))
    frames = f"{tracker.num_frames} of {tracker.width}x{tracker.height}"
    quality = tracker.quality
    median = None if quality is None else quality.all.median
    return Answers(tracker.clip_name, frames, median, score, gap, error, refined_error)


def fit(answers: Sequence[Answers]) -> Calibration:
    """The numbers with the least pinball loss of the errors' logarithms, each clip weighing the same."""
    medians = [each.median for each in answers if each.median is not None]
    typical = float(np.exp(np.mean(np.log(medians)))) if medians else 1.0
    telling = {each.clip for each in answers if each.median is not None}
    powers = QUALITY_POWERS if len(telling) >= LEAST_TELLING else (0.0,)
    weight = np.concatenate(_weights(answers))
    edges = np.sqrt(np.multiply(SCORES[1:], SCORES[:-1]))
    knot = np.digitize(np.concatenate([each.score for each in answers]), edges)
    best: tuple[float, Calibration] | None = None
    for gap_power, quality_power in product(GAP_POWERS, powers):
        flat = Calibration(SHARE, SCORES, (1.0,) * len(SCORES), gap_power, quality_power, typical)
        over = np.log(np.concatenate([np.maximum(each.error, SMALLEST) / each.told(flat) for each in answers]))
        here = [knot == number for number in range(len(SCORES))]
        full = [number for number, rows in enumerate(here) if rows.any()]
        levels = [_quantile(over[here[number]], weight[here[number]]) for number in full]
        curve = np.interp(np.log(SCORES), np.log(SCORES)[full], np.maximum.accumulate(levels))
        fitted = replace(flat, errors=tuple(float(f"{value:.4g}") for value in np.exp(curve)))
        loss = pinball(answers, fitted)
        if best is None or loss < best[0]:
            best = loss, fitted
    assert best is not None
    factor = _refined_factor(answers, best[1])
    return replace(best[1], refined_factor=factor, clips=tuple(sorted({each.clip for each in answers})))


def _refined_factor(answers: Sequence[Answers], calibration: Calibration) -> float:
    """What the quantile `SHARE` of refined answers' errors is, by what they were told; 1 at most."""
    over = np.concatenate([each.refined_error / each.told(calibration) for each in answers])
    found = np.isfinite(over)
    if not found.any():
        return 1.0
    return min(1.0, round(_quantile(over[found], np.concatenate(_weights(answers))[found]), 3))


def pinball(answers: Sequence[Answers], calibration: Calibration) -> float:
    """Mean over clips of how badly the told errors are the quantile `SHARE`, in logarithms; 0 is best."""
    over = [np.log(np.maximum(each.error, SMALLEST) / each.told(calibration)) for each in answers]
    loss = [np.where(each > 0, SHARE * each, (SHARE - 1) * each) for each in over]
    return float(np.average(np.concatenate(loss), weights=np.concatenate(_weights(answers))))


def left_out(answers: Sequence[Answers]) -> list[Told]:
    """Each model's answers, and what they are told by numbers that were fitted to other clips."""
    clips = sorted({each.clip for each in answers})
    others = {clip: fit([each for each in answers if each.clip != clip]) for clip in clips}
    told = [(each, each.told(others[each.clip]), others[each.clip].refined_factor) for each in answers]
    return [Told(each, error, factor * error) for each, error, factor in told]


def report(told: Sequence[Told]) -> dict[str, Any]:
    """What told errors are worth: by model, by bin of told errors, and as a limit."""
    weight = np.concatenate(_weights([each.answers for each in told]))
    error, said = np.concatenate([each.answers.error for each in told]), np.concatenate([each.error for each in told])
    refined = np.concatenate([each.answers.refined_error for each in told])
    found, said_refined = np.isfinite(refined), np.concatenate([each.refined_error for each in told])
    chance, near = share_within(said, NEAR, SHARE), error <= NEAR
    likely = [(begin, end, (chance > begin) & (chance <= end)) for begin, end in pairwise(CHANCES)]
    bins = [(begin, end, (said > begin) & (said <= end)) for begin, end in pairwise(BINS)]
    return {
        "answers": len(error),
        "within": _mean(error <= said, weight),
        "refined": {
            "share_of_answers": _mean(found, weight),
            "within": _mean((refined <= said_refined)[found], weight[found]),
        },
        "models": [
            {
                "clip": each.answers.clip,
                "frames": each.answers.frames,
                "quality_median": each.answers.median,
                "answers": len(each.error),
                "within": float((each.answers.error <= each.error).mean()),
                "median_error": float(np.median(each.answers.error)),
                "median_told": float(np.median(each.error)),
            }
            for each in told
        ],
        "bins": [
            {
                "above": begin,
                "up_to": None if end == np.inf else end,
                "share_of_answers": _mean(rows, weight),
                "within": _mean(error[rows] <= said[rows], weight[rows]),
                "by_clip": _by_clip(told, begin, end),
            }
            for begin, end, rows in bins
        ],
        "chances": [
            {
                "above": begin,
                "up_to": end,
                "share_of_answers": _mean(rows, weight),
                "chance": _mean(chance[rows], weight[rows]),
                "near": _mean(near[rows], weight[rows]),
            }
            for begin, end, rows in likely
        ],
        "tail": min(TAILS, key=lambda tail: _surprise(share_within(said, NEAR, SHARE, tail), near, weight)),
        "limits": [
            {
                "limit": limit,
                "kept": _mean(said <= limit, weight),
                "within": _mean(error[said <= limit] <= limit, weight[said <= limit]),
                "within_of_all": _mean(error <= limit, weight),
            }
            for limit in LIMITS
        ],
    }


def document(record: dict[str, Any]) -> Iterator[str]:
    """Lines of Markdown."""
    yield from markdown.head(["told e, px of 256", "share of answers", "within e"])
    for each in record["bins"]:
        up_to = f"above {each['above']:g}" if each["up_to"] is None else f"{each['above']:g} to {each['up_to']:g}"
        yield markdown.line([up_to, _percent(each["share_of_answers"]), _percent(each["within"])])
    yield markdown.line(["all", "100%", _percent(record["within"])])
    refined = record["refined"]
    yield markdown.line(["refined", _percent(refined["share_of_answers"]), _percent(refined["within"])])
    yield ""
    yield from markdown.head(["limit, px of 256", "answers kept", "of these within it", "of all within it"])
    for each in record["limits"]:
        cells = [_percent(each[key]) for key in ("kept", "within", "within_of_all")]
        yield markdown.line([f"{each['limit']:g}", *cells])
    yield ""
    yield from markdown.head(["chance to be near", "share of answers", "in the mean", f"within {NEAR:g}"])
    for each in record["chances"]:
        cells = [_percent(each[key]) for key in ("share_of_answers", "chance", "near")]
        yield markdown.line([f"{each['above']:g} to {each['up_to']:g}", *cells])
    yield f"\nThe power with the least log loss is {record['tail']:g}; {TAIL:g} is used.\n"
    yield from markdown.head(["clip, left out", "frames", "answers", "within e", "median error", "median e"])
    for each in record["models"]:
        cells = [each["clip"], each["frames"], str(each["answers"]), _percent(each["within"])]
        yield markdown.line([*cells, f"{each['median_error']:.2f}", f"{each['median_told']:.2f}"])


def diagram(record: dict[str, Any]) -> Figure:
    """Of answers told e, the share within e: a line for each clip, and one for all."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4), layout="constrained")
    axes = figure.subplots()
    labels = [f"{a:g}-{b:g}" if b < np.inf else f"> {a:g}" for a, b in pairwise(BINS)]
    for number, clip in enumerate(sorted({each["clip"] for each in record["models"]})):
        places = [place for place, each in enumerate(record["bins"]) if clip in each["by_clip"]]
        shares = [100 * record["bins"][place]["by_clip"][clip] for place in places]
        axes.plot(places, shares, marker=".", linewidth=1, color=f"C{number % 10}", alpha=0.6, label=clip)
    places = [place for place, each in enumerate(record["bins"]) if each["within"] is not None]
    shares = [100 * record["bins"][place]["within"] for place in places]
    axes.plot(places, shares, marker="o", color="black", linewidth=2, label="all")
    axes.axhline(100 * SHARE, color="black", linestyle="--", linewidth=1)
    axes.set_xticks(range(len(labels)), labels)
    axes.set(xlabel="told error e, pixels of 256", ylabel="answers within e, %", ylim=(0, 102))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", fontsize=8)
    return figure


def asked(paths: Sequence[Path], datasets: Sequence[Mapping[str, Video]]) -> Iterator[Answers]:
    """Of all models that have annotations; says which have none."""
    for path in paths:
        tracker = Tracker(path, threads=1)
        videos = videos_of(tracker, datasets)
        if not videos:
            click.echo(f"left out: {path}, no annotations of {tracker.clip_name} with {tracker.num_frames} frames")
            continue
        answers = ask(tracker, videos)
        click.echo(f"{answers.clip}: {len(answers.error)} answers of {path}")
        yield answers


def videos_of(tracker: Tracker, datasets: Sequence[Mapping[str, Video]]) -> list[Video]:
    """The annotations of the clip that a model was fitted to: those of its name and number of frames."""
    named = [dataset[tracker.clip_name] for dataset in datasets if tracker.clip_name in dataset]
    return [video for video in named if video.num_frames == tracker.num_frames and not video.occluded.all()]


def model_paths(paths: Sequence[Path]) -> list[Path]:
    """Files, and folders of windows, among `paths` and within folders among them."""
    found: list[Path] = []
    for path in paths:
        layouts = sorted(path.rglob(FILE_NAME)) if path.is_dir() else []
        found += [layout.parent for layout in layouts if any(layout.parent.glob("*.onnx"))]
        files = [] if (path / FILE_NAME).is_file() else model_files([path])
        found += [file for file in files if not (file.parent / FILE_NAME).is_file()]
    return found


def _weights(answers: Sequence[Answers]) -> list[Floats]:
    """Of each answer: those of a clip weigh 1 together."""
    total: dict[str, int] = {}
    for each in answers:
        total[each.clip] = total.get(each.clip, 0) + len(each.error)
    return [np.full(len(each.error), 1 / total[each.clip]) for each in answers]


def _quantile(values: Floats, weight: Floats) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(reached, SHARE * reached[-1])])


def _by_clip(told: Sequence[Told], begin: float, end: float) -> dict[str, float]:
    hits: dict[str, list[npt.NDArray[np.bool_]]] = {}
    for each in told:
        rows = (each.error > begin) & (each.error <= end)
        hits.setdefault(each.answers.clip, []).append(each.answers.error[rows] <= each.error[rows])
    joined = {clip: np.concatenate(parts) for clip, parts in hits.items()}
    return {clip: float(each.mean()) for clip, each in joined.items() if len(each) >= FEWEST}


def _mean(values: Floats | npt.NDArray[np.bool_], weight: Floats) -> float | None:
    return float(np.average(values, weights=weight)) if len(values) else None


def _surprise(chance: Floats, true: npt.NDArray[np.bool_], weight: Floats) -> float:
    """Log loss."""
    return float(np.average(-np.log(np.where(true, chance, 1 - chance)), weights=weight))


def _percent(share: float | None) -> str:
    return "" if share is None else f"{share:.0%}"


@click.command(context_settings={"show_default": True})
@click.argument("shared", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("models", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder of the record and its tables.")
@click.option("--diagram", "diagram_path", metavar="PNG", type=click.Path(path_type=Path), help="Draw it there.")
@click.option("--write", is_flag=True, help="Replace the runtime's numbers by those fitted to all clips.")
def main(shared: Path, models: tuple[Path, ...], out: Path, diagram_path: Path | None, write: bool) -> None:
    """Fit and judge the expected error by MODELS of clips that are annotated in SHARED."""
    with TemporaryDirectory() as pickles:
        datasets = [dict(read_dataset(shared / name)) for name in PICKLES]
        datasets += [full_length.annotated(shared, kind, Path(pickles)) for kind in KINDS]
        answers = list(asked(model_paths(models), datasets))
    if len({each.clip for each in answers}) < 2:
        raise click.UsageError("calibration leaves a clip out at a time; give models of two clips or more")
    record = report(left_out(answers)) | {"share": SHARE, **provenance()}
    out.mkdir(parents=True, exist_ok=True)
    with replacing(out / "calibration.json") as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    with replacing(out / "calibration.md") as temporary:
        temporary.write_text("\n".join(document(record)) + "\n", encoding="utf-8")
    click.echo("\n".join(document(record)))
    if diagram_path is not None:
        with replacing(diagram_path) as temporary:
            diagram(record).savefig(temporary, format="png", dpi=110)
    if write:
        with replacing(FILE) as temporary:
            fit(answers).save(temporary)
        click.echo(f"wrote {FILE}")


if __name__ == "__main__":
    sys.exit(run(main))
