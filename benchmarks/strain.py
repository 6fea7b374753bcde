"""Errors of strain on deformations known in closed form: the model, the model refined, chained flow, correlation.

    python benchmarks/strain.py run --work runs/strain --out benchmarks/results/strain --correlation dic/bin/python
    python benchmarks/strain.py table benchmarks/results/strain

Each clip of `harness/deformations.py` is drawn, and a model fitted to it in few steps; what exists in `--work` is not
made again. Squares of several sizes are measured by `measure_region` in every frame against frame 0, of every tracker
in the same way, so that only displacements differ. `chained-dis` is DIS flow, frame by frame, accumulated;
`--correlation` is the Python of an environment with PyPI's `al-dic`, in both of its modes.

Errors are root mean squares over squares and frames, of the components of the Green-Lagrange tensor at the square's
middle, and of rotations in degrees; magnitudes are of the greatest true principal strain there, and of the true
rotation. Squares are not counted in frames where they come near to the border.
"""

from __future__ import annotations

import json
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
import numpy.typing as npt

from decomo_eval.baselines import FINE, Fields, linked
from decomo_runtime import ModelFacts, Tracker, Tracks, measure_region
from decomo_runtime.measure.strain import strain_of
from harness.deformations import DEFORMATIONS, Deformed, bins
from harness.image_correlation import __file__ as correlation_file
from harness.records import Record, provenance, write_record

_PATH = click.Path(path_type=Path)
SIDES = (8, 16, 32, 64)
"""Pixels, of the squares."""
SPACING = 4
RIM = 12
"""Pixels along the frame's borders, of which no square counts that comes there: a correlation's subset is as wide."""
SQUARES_ALONG = 4
STRAINS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3)
ROTATIONS = (0.0, 1.0, 3.0, 10.0, 30.0)
FPS = 24.0


@dataclass(frozen=True)
class GivenTracker:
    """Answers of places in frame 0 that something else has followed."""

    facts: ModelFacts
    places: Any
    """A function of places [N, 2]: [N, T, 2] in all frames."""

    @property
    def times(self) -> npt.NDArray[np.float64]:
        """[T], seconds."""
        return np.arange(self.facts.num_frames) / self.facts.fps

    def track(self, queries: npt.ArrayLike, frames: npt.ArrayLike | None = None) -> Tracks:
        """Of queries in frame 0; nothing is hidden."""
        asked = np.asarray(queries, np.float32)
        numbers = np.arange(self.facts.num_frames) if frames is None else np.asarray(frames)
        xy = self.places(asked[:, 1:].astype(np.float64))[:, numbers].astype(np.float32)
        hidden = ~np.isfinite(xy).all(-1)
        return Tracks(xy, hidden, hidden.astype(np.float32), asked, numbers)

    def on_object(self, queries: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Nothing is."""
        return np.zeros(len(np.asarray(queries)), bool)


@click.group()
def main() -> None:
    """Measure strain on deformations known in closed form."""


@main.command(context_settings={"show_default": True})
@click.option("--frames", default=24, help="Of each clip.")
@click.option("--width", default=224)
@click.option("--height", default=176)
@click.option("--steps", default=300, help="Of a fit.")
@click.option("--seed", default=0, help="Of texture and noise.")
@click.option("--only", multiple=True, help="Deformations.  [default: all]")
@click.option("--correlation", type=_PATH, help="Python with al-dic.  [default: leave it out]")
@click.option("--work", type=_PATH, required=True, help="Folder for clips, runs and models.")
@click.option("--out", type=_PATH, required=True, help="Folder of the records.")
def run(
    frames: int,
    width: int,
    height: int,
    steps: int,
    seed: int,
    only: tuple[str, ...],
    correlation: Path | None,
    work: Path,
    out: Path,
) -> None:
    """Draw, fit and measure: a record for each deformation."""
    cv2.setNumThreads(1)
    for deformation in DEFORMATIONS:
        if only and deformation.name not in only:
            continue
        clip = Deformed(deformation, frames, height, width, seed)
        pictures = clip.frames()
        model, fitted = _fitted(clip, pictures, steps, work)
        tracker = Tracker(model, threads=1)
        methods = {
            "model": (tracker, None),
            "model-refined": (tracker, pictures),
            "chained-dis": (GivenTracker(tracker.facts, _chained(pictures)), None),
        }
        if correlation is not None:
            for mode in ("accumulative", "incremental"):
                places = _correlated(correlation, pictures, mode, work / f"{deformation.name}-{mode}.npz")
                methods[f"al-dic-{mode}"] = (GivenTracker(tracker.facts, places), None)
        found = {}
        for name, (each, refined_on) in methods.items():
            begin = time.process_time()
            found[name] = errors_of(clip, each, refined_on)
            found[name]["cpu_seconds"] = time.process_time() - begin
            click.echo(f"{deformation.name} {name}: {_told(found[name])}")
        facts = {
            "clip": deformation.name,
            "frames": frames,
            "size": [width, height],
            "steps": steps,
            "seed": seed,
            "fit_cpu_seconds": fitted,
        }
        write_record(out / f"{deformation.name}.json", facts | {"methods": found} | provenance())


@main.command()
@click.argument("records", type=_PATH)
def table(records: Path) -> None:
    """Print errors of strain by the squares' size and, of those of 32 pixels, by magnitude, as markdown."""
    for path in sorted(records.glob("*.json")):
        record = json.loads(path.read_text())
        methods: Record = record["methods"]
        bins_known = next(iter(methods.values()))["32"]["by_strain"]
        names = [
            *(f"{side} px" for side in SIDES),
            *(f"32 px, strain {name}" for name in bins_known),
            "rotation, 32 px",
        ]
        click.echo(f"\n| {record['clip']} | {' | '.join(names)} |\n|{'---|' * (len(names) + 1)}")
        for method, found in methods.items():
            cells = [found[str(side)]["strain"] for side in SIDES]
            cells += [found["32"]["by_strain"][name]["error"] for name in bins_known]
            told = [*(_cell(each) for each in cells), f"{found['32']['rotation']:.2f} deg"]
            click.echo(f"| {method} | {' | '.join(told)} |")


def _cell(error: float | None) -> str:
    return "" if error is None else f"{error:.4f}"


def _fitted(clip: Deformed, pictures: npt.NDArray[np.uint8], steps: int, work: Path) -> tuple[Path, float | None]:
    """The model, and the CPU seconds of its fit where it was made now."""
    from decomo_export.cli import main as export
    from decomotion.cli import main as train

    name = clip.deformation.name
    folder, run, model = work / name, work / f"{name}-run", work / f"{name}.onnx"
    if model.is_file():
        return model, None
    folder.mkdir(parents=True, exist_ok=True)
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"{number:05d}.png"), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    begin = time.process_time()
    fit = [folder, "--out", run, "--steps", steps, "--shots", "ignore", "--seed", clip.seed]
    for command, arguments in ((train, fit), (export, [model, "--run", run, "--force"])):
        if command([str(argument) for argument in arguments]):
            raise SystemExit(1)
    return model, time.process_time() - begin


def _chained(pictures: npt.NDArray[np.uint8]) -> Any:
    from decomotion.config import load
    from decomotion.data.flow import build_flow
    from decomotion.device import choose_device

    data = load("cpu", overrides=FINE, flow="dis").data
    fields = Fields(pictures, build_flow(data.flow, choose_device("cpu")))  # type: ignore[arg-type]
    height, width = fields(0, 1).shape[:2]
    scale = np.array([width / pictures.shape[2], height / pictures.shape[1]])

    def places(start: npt.NDArray[np.float64]) -> npt.NDArray[np.floating]:
        asked = np.column_stack([np.zeros(len(start)), (start + 0.5) * scale - 0.5]).astype(np.float32)
        xy, _ = linked(asked, fields, (1,), np.inf, fields.num_frames)
        return (xy + 0.5) / scale - 0.5

    return places


def _correlated(python: Path, pictures: npt.NDArray[np.uint8], mode: str, out: Path) -> Any:
    if not out.is_file():
        greys = out.with_suffix(".npy")
        np.save(greys, np.stack([cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in pictures]))
        one_thread = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
        subprocess.run([str(python), correlation_file, str(greys), str(out), mode], check=True, env=one_thread)
    from scipy.interpolate import LinearNDInterpolator

    with np.load(out) as file:
        nodes, moved = file["nodes"], file["moved"]
    between = LinearNDInterpolator(nodes, moved.transpose(1, 0, 2))
    return lambda start: start[:, None] + between(start)


def errors_of(clip: Deformed, tracker: Any, refined_on: npt.NDArray[np.uint8] | None) -> Record:
    """By the side of the squares: errors by magnitude."""
    margin = max(SIDES) / 2 + RIM
    x, y = (np.linspace(margin, side - 1 - margin, SQUARES_ALONG) for side in (clip.width, clip.height))
    middles = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    numbers = np.arange(1, clip.num_frames)
    corner = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) / 2
    records: Record = {}
    for side in SIDES:
        along = np.arange(0, side + 1, SPACING) - side / 2
        offsets = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
        rows = []
        for middle in middles:
            queries = np.column_stack([np.zeros(len(offsets)), middle + offsets])
            region = measure_region(tracker, queries, frames=numbers, reference=0, clip=refined_on)
            for index, frame in enumerate(numbers.tolist()):
                ends = clip.follow(middle + corner * side, frame)
                if ((ends < RIM) | (ends > np.array([clip.width, clip.height]) - 1 - RIM)).any():
                    continue
                truth = strain_of(clip.gradient(middle, frame))
                error = region.strain.green_lagrange[index] - truth.green_lagrange
                turned = region.strain.rotation[index] - truth.rotation
                rows.append(
                    (
                        np.abs(truth.principal).max(),
                        abs(truth.rotation),
                        (error**2).mean(),
                        turned**2,
                        region.hidden[index],
                    )
                )
        strain, rotation, squared, turned, hidden = np.array(rows, np.float64).T
        known = np.isfinite(squared)
        records[str(side)] = {
            "count": len(rows),
            "unknown": float((~known).mean()),
            "hidden": float(hidden.mean()),
            "strain": _root(squared[known]),
            "rotation": _root(turned[known]),
            "by_strain": {
                name: {"count": int(each.sum()), "error": _root(squared[each & known])}
                for name, each in bins(STRAINS, strain).items()
                if each.any()
            },
            "by_rotation": {
                name: {"count": int(each.sum()), "error": _root(turned[each & known])}
                for name, each in bins(ROTATIONS, rotation).items()
                if each.any()
            },
        }
    return records


def _root(squares: npt.NDArray[np.floating]) -> float:
    return float(np.sqrt(squares.mean())) if len(squares) else float("nan")


def _told(record: Record) -> str:
    return ", ".join(
        f"{side} px {record[str(side)]['strain']:.4f} ({record[str(side)]['rotation']:.2f} deg)" for side in SIDES
    )


if __name__ == "__main__":
    main()
