"""The development clips' full table by one command: our fits, a single volume, and flow alone by DIS and RAFT-small.

    python benchmarks/development.py ../shared

runs the programs below, each as a user would, and writes `development.md`, the table of their records. What has a
record is not run again: the same command goes on after an interruption and, where all is there, makes the table anew.
The fits take more than twenty minutes a clip; nothing else may run beside them.

    baselines.py    chained, direct and linked by fine DIS and by RAFT-small    OUT/baselines/<row>
    accuracy.py     cpu and omnimotion, ten minutes each                        OUT/10m/<row>
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import click

import accuracy
import baselines
from decomo_eval.query_mode import QUERY_MODES
from decomotion.console import run
from decomotion.files import replacing
from harness.records import Record, read_records
from harness.summary import by_clip
from table import clip_table, row_table

DATASET, MASKS, WEIGHTS = "data/tapvid_davis32_dev.pkl", "data/davis32_dev_mask.npz", "weights/raft-small.pth"
FITS, BASELINES = "10m", "baselines"
FINE = "data.flow.gradient_weight=10"
"""Of DIS alone: with it the records of `benchmarks/results/baselines` were made."""
NOT_ENLARGED = "data.flow.upsample=1"
"""Of RAFT-small alone: enlarged frames take it four to five times as long."""
REFERENCE, OURS = "chained-dis", "cpu"


def document(rows: dict[str, list[Record]], command: str) -> Iterator[str]:
    """Lines of Markdown: what was measured and how, the rows, and our fits clip by clip."""
    yield "# TAP-Vid-DAVIS, ten development clips, first 32 frames only, 256x256"
    yield ""
    yield f"Made by `{command}` from the records in `{FITS}` and `{BASELINES}` beside this file."
    yield "Published figures are for full-length clips and not comparable."
    yield from ("", "| row | date | commit | settings | machine | threads |", "|---|---|---|---|---|---|")
    for name, row in rows.items():
        machines = [record["machine"] for record in row]
        facts = (
            [record["date"] for record in row],
            [record["commit"] for record in row],
            [" ".join(record["overrides"]) for record in row],
            [f"{machine['cores']} cores of {machine['processor']}" for machine in machines],
            [machine.get("threads", "not noted") for machine in machines],
        )
        yield "| " + " | ".join([name, *(", ".join(sorted(set(values))) for values in facts)]) + " |"
    for query_mode in QUERY_MODES:
        reference = by_clip(rows[REFERENCE], query_mode) if REFERENCE in rows else None
        yield from ("", f"## {query_mode}", "", *row_table(rows, query_mode, reference))
        if OURS in rows:
            yield from ("", f"`{OURS}`, clip by clip:", "", *clip_table(rows[OURS], query_mode, reference))


@click.command(context_settings={"show_default": True})
@click.argument("shared", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--clips", help="Names, separated by commas.  [default: all]")
@click.option("--only", type=click.Choice([FITS, BASELINES, "table"]), help="One part, and the table of what is there.")
@click.option("--out", type=click.Path(path_type=Path), default=accuracy.RESULTS, help="Folder of records and table.")
def main(shared: Path, clips: str | None, only: str | None, out: Path) -> None:
    """Regenerate the table from SHARED/data, the clips and their masks, and SHARED/weights, RAFT-small's."""
    data = [str(shared / DATASET), "--object-masks", str(shared / MASKS)]
    chosen = ["--clips", clips] if clips else []
    flow, fits = ["--out", str(out / BASELINES), *chosen], ["--out", str(out / FITS), *chosen]
    raft = ["--flows", "raft-small", "--raft-weights", str(shared / WEIGHTS), "--set", NOT_ENLARGED]
    parts = [
        (BASELINES, baselines.main, [*flow, "--flows", "dis", "--set", FINE]),
        (BASELINES, baselines.main, [*flow, *raft]),
        (FITS, accuracy.main, [*fits, "--preset", "cpu", "--preset", "omnimotion", "--time-budget", "10m"]),
    ]
    try:
        for part, program, options in parts:
            if only in (None, part):
                program.main([*data, *options], standalone_mode=False)
    finally:
        rows = {name: row for part in (FITS, BASELINES) for name, row in read_records(out / part).items()}
        if rows:
            path, command = out / "development.md", f"python benchmarks/development.py {shared}"
            with replacing(path) as temporary:
                temporary.write_text("\n".join(document(rows, command)) + "\n", encoding="utf-8")
            click.echo(f"wrote {path}")


if __name__ == "__main__":
    sys.exit(run(main))
