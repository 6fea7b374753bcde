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
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click
import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import read_dataset
from decomo_runtime.expected_error import FILE, NEAR, TAIL, share_within
from decomotion.console import run
from decomotion.files import replacing
from harness import full_length, markdown
from harness.answers import Floats, asked, model_paths
from harness.records import provenance
from harness.told_errors import SHARE, Told, fit, left_out, weights

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def report(told: Sequence[Told]) -> dict[str, Any]:
    """What told errors are worth: by model, by bin of told errors, and as a limit."""
    weight = np.concatenate(weights([each.answers for each in told]))
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
