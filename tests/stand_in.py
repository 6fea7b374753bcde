"""Stands in for `decomo-train` and `decomo-export` where the page refits: quick, and as good as its corrections.

    python stand_in.py CONTROL train CLIP --run RUN --corrections FILE --time-budget 1m --out OUT
    python stand_in.py CONTROL export MODEL.onnx --run OUT

The fit begins, half done, with a process of its own, whose id it writes to CONTROL/child; it goes on when CONTROL/go is
there, and says that it has failed where that file holds a sentence. The model's points move so that the first placed
correction is met.
"""

from __future__ import annotations

import csv
import json
import shutil
import sys
import time
from pathlib import Path

import click

from children import sleeper
from decomotion.files import replacing

SECONDS = 600
"""After which a fit that nobody lets go on ends."""
_PATH = click.Path(path_type=Path)


@click.group()
@click.argument("control", type=_PATH)
@click.pass_context
def stand_in(context: click.Context, control: Path) -> None:
    """Both commands."""
    context.obj = control


@stand_in.command()
@click.argument("clip", type=click.Path(path_type=Path, exists=True))
@click.option("--run", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--corrections", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--time-budget", required=True)
@click.option("--out", type=_PATH, required=True)
@click.pass_obj
def train(control: Path, clip: Path, run: Path, corrections: Path, time_budget: str, out: Path) -> None:
    """A fit that ends when it is told to."""
    assert not any(out.iterdir())
    (out / "half").touch()
    with (control / "begun").open("a") as begun:
        print(clip, run, time_budget, file=begun)
    child = sleeper(SECONDS)
    with replacing(control / "child") as whole:  # who waits for it reads it at once
        whole.write_text(str(child.pid))
    for percent in (0, 42):
        sys.stderr.write(f"\rfit {percent:3d}%|████      | step {percent}  3.0/s  0.5 min left")
        sys.stderr.flush()
    end = time.monotonic() + SECONDS
    while not (control / "go").exists() and time.monotonic() < end:
        time.sleep(0.02)
    child.kill()
    child.wait(SECONDS)
    if failure := (control / "go").read_text():
        raise SystemExit(f"\nError: {failure}")
    rows = list(csv.DictReader(corrections.read_text().splitlines()))
    first = next(row for row in rows if row["target_x"])
    elapsed = int(first["target_t"]) - int(first["t"])
    velocity = [(float(first[f"target_{axis}"]) - float(first[axis])) / elapsed for axis in ("x", "y")]
    (out / "half").unlink()
    (out / "checkpoint.pt").write_text(json.dumps({"velocity": velocity, "rows": rows}))
    (control / "go").unlink()


@stand_in.command()
@click.argument("model", type=_PATH)
@click.option("--run", type=click.Path(path_type=Path, exists=True), required=True)
@click.pass_obj
def export(control: Path, model: Path, run: Path) -> None:
    """The tiny model of `control/model.json`, with the velocity of the run; of a folder, a copy of `control/models`."""
    if not model.suffix:
        shutil.copytree(control / "models", model)
        return
    from tiny_model import write_tiny_model

    x, y = json.loads((run / "checkpoint.pt").read_text())["velocity"]
    options = json.loads((control / "model.json").read_text())
    write_tiny_model(model, rename={"{1.5, -0.5}": f"{{{x:.6f}, {y:.6f}}}"}, **options)
    print(f"wrote {model}")


if __name__ == "__main__":
    stand_in()
