"""Masks of few frames carried to all others, scored as DAVIS does: J and F at 854x480, a record for each clip.

    python benchmarks/propagation.py ../shared                        # fits what is not fitted, 10 minutes a clip
    python benchmarks/propagation.py ../shared --clips camel,dog --work /tmp/decomotion-footage
    python benchmarks/propagation.py ../shared --table

The model is the fit of the whole clip that `footage.py` makes, in the same `--work` folder; the records are beside its
own. Beside the mask of frame 0
with the clip's own frames (`first`) and without them (`model`), and three annotated frames (`three`: the first, the
middle and the last), it is carried by chained DIS flow (`chained`): each pixel goes back frame by frame to frame 0.
Scored are all frames but the first and the last, as DAVIS does, and of three those between them.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt

from decomo_eval.baselines import FlowBaseline
from decomo_runtime import Tracker, propagate
from decomo_runtime.propagation.shapes import Annotation, Kind, Shape, Thing
from decomotion.clip import read_clip
from decomotion.console import run
from decomotion.frames import AnyFrames
from harness.davis import contour, region
from harness.full_length import clip_folder, clip_names, object_masks
from harness.markdown import head, line
from harness.plan import Plan
from harness.records import Record

RESULTS = Path(__file__).parent / "results" / "footage"
PART = "propagation"
CHAINED, WAYS = "chained", ("first", "model", "three")
FIGURES = ("j", "f")

Mask = npt.NDArray[np.bool_]


def carried(model: Path, masks: Mask, annotated: list[int], frames: AnyFrames | None) -> Iterator[tuple[Mask, float]]:
    """The masks [H, W] of all frames, and their confidence, from those of the `annotated`."""
    shapes = tuple(Shape(0, frame, Kind.MASK, mask=masks[frame]) for frame in annotated)
    annotation = Annotation(masks.shape[1:], (Thing(255, "object"),), shapes)
    for shapes_there, findings in propagate(Tracker(model), annotation, frames):
        mask = next((each.mask for each in shapes_there if each.mask is not None), np.zeros(masks.shape[1:], bool))
        yield mask, findings[0].confidence


def chained(masks: Mask, frames: AnyFrames) -> Iterator[Mask]:
    """The masks [H, W] of all frames from that of the first, by flow from each frame to the one before it."""
    from decomotion.data.sampling import bilinear

    fields = FlowBaseline("chain").fields(frames)
    yield masks[0]
    height, width = masks.shape[1:]
    rows, columns = fields(1, 0).shape[:2]
    start = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(np.float32)
    place, scale = start, np.array([width / columns, height / rows], np.float32)
    for frame in range(1, len(masks)):
        there = (start + fields(frame, frame - 1)).reshape(-1, 2)
        place = bilinear(place, there).reshape(start.shape).astype(np.float32)
        full = _resized((place + 0.5) * scale - 0.5, (width, height))
        column, row = np.rint(full).astype(int).clip(0, (width - 1, height - 1)).transpose(2, 0, 1)
        yield masks[0][row, column]


def _resized(image: npt.NDArray[np.float32], size: tuple[int, int]) -> npt.NDArray[np.float32]:
    import cv2

    return cv2.resize(image, size, interpolation=cv2.INTER_LINEAR).astype(np.float32)


def figures(found: Iterator[Mask], masks: Mask, scored: list[int]) -> dict[str, list[float]]:
    """J and F of each frame that is scored."""
    each: dict[str, list[float]] = {name: [] for name in FIGURES}
    for frame, mask in enumerate(found):
        if frame in scored:
            each["j"].append(round(region(mask, masks[frame]), 4))
            each["f"].append(round(contour(mask, masks[frame]), 4))
    return each


def measure(model: Path, masks: Mask, frames: AnyFrames) -> Record:
    """Of a model: `ways`, by name J, F and confidence of each frame, and processor seconds a frame."""
    last = len(masks) - 1
    ways = {"first": ([0], frames), "model": ([0], None), "three": ([0, last // 2, last], frames)}
    told: dict[str, Record] = {}
    for name, (annotated, shown) in ways.items():
        scored = [frame for frame in range(1, last) if frame not in annotated]
        confidence: list[float] = []

        def noted(annotated: list[int] = annotated, shown: AnyFrames | None = shown) -> Iterator[Mask]:
            for mask, sure in carried(model, masks, annotated, shown):
                confidence.append(round(sure, 4))  # noqa: B023
                yield mask

        begin = time.process_time()
        each = figures(noted(), masks, scored)
        seconds = (time.process_time() - begin) / len(masks)
        told[name] = each | {"confidence": [confidence[t] for t in scored], "cpu_seconds_per_frame": round(seconds, 2)}
    return {"ways": told}


def read_all(folder: Path) -> dict[str, Record]:
    """The records of a folder, by clip."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}


def table(records: Mapping[str, Record], flows: Mapping[str, Record]) -> Iterator[str]:
    """J and F of each clip by each way, their means last."""
    ways = [(CHAINED, flows), *((way, records) for way in WAYS)]
    yield from head(["clip", *(f"{way} {name.upper()}" for way, _ in ways for name in FIGURES)])
    rows = []
    for clip in sorted(records.keys() & flows.keys()):
        rows.append([float(np.mean(of[clip]["ways"][way][name])) for way, of in ways for name in FIGURES])
        yield line([clip, *(f"{value:.3f}" for value in rows[-1])])
    if rows:
        yield line([f"mean of {len(rows)}", *(f"{value:.3f}" for value in np.mean(rows, axis=0))])


@click.command(context_settings={"show_default": True})
@click.argument("shared", type=click.Path(path_type=Path))
@click.option("--table", "print_table", is_flag=True, help="Print the table of the records instead.")
@click.option("--name", default="default", help="Of the folder of records and of fits.")
@click.option("--preset", default="cpu", help="Of the fits.")
@click.option("--time-budget", help="Of the fits.  [default: decomo-train's]")
@click.option("--clips", help="Names, separated by commas.  [default: all]")
@click.option(
    "--out", type=click.Path(path_type=Path), default=RESULTS, show_default="results/footage", help="Of records."
)
@click.option("--work", type=click.Path(path_type=Path), default=Path("/tmp/decomotion-footage"), help="Runs, models.")
def main(
    shared: Path,
    print_table: bool,
    name: str,
    preset: str,
    time_budget: str | None,
    clips: str | None,
    out: Path,
    work: Path,
) -> None:
    """Measure with the clips of SHARED, the folder of real data."""
    if print_table:
        click.echo("\n".join(table(read_all(out / name / PART), read_all(out / CHAINED / PART))))
        return
    known = clip_names(shared)
    wanted = clips.split(",") if clips else known
    if unknown := [clip for clip in wanted if clip not in known]:
        raise click.UsageError(f"{shared} has no clip {', '.join(unknown)}; it has {', '.join(known)}")
    plan = Plan(out, work, name, preset, (), ("--time-budget", time_budget) if time_budget else ())
    for clip in wanted:
        masks, frames = object_masks(shared, clip), read_clip(clip_folder(shared, clip)).frames
        scored = list(range(1, len(masks) - 1))
        flow = lambda m=masks, f=frames, s=scored: {"ways": {CHAINED: figures(chained(m, f), m, s)}}  # noqa: E731
        plan.record(PART, clip, {"tracker": "chain-dis"}, flow, name=CHAINED)
        ours = lambda c=clip, m=masks, f=frames: measure(plan.fit(c, clip_folder(shared, c)), m, f)  # noqa: E731
        plan.record(PART, clip, plan.facts, ours)
    if plan.failures:
        raise click.ClickException(f"{', '.join(plan.failures)} failed; the same command tries again")


if __name__ == "__main__":
    sys.exit(run(main))
