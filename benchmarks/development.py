"""The development clips' tables by one command: fits, the links that they learn from, flow alone, and whole clips.

    python benchmarks/development.py ../shared
    python benchmarks/development.py ../shared --only table

runs the programs below, each as a user would, and writes `development.md`, the tables of their records. What has a
record is not run again: the same command goes on after an interruption and, where all is there, makes the tables anew.
The fits take eight hours and more of one core; nothing else may run beside them.

    baselines   baselines.py: chained, direct and linked by fine DIS    OUT/baselines/<row>
    prepared    baselines.py: the links of a fit by themselves          OUT/prepared/<row>
    fits        accuracy.py: the series of `SERIES`                     OUT/<series>/<row>
    footage     footage.py: the parts of `WHOLE`, ten minutes a clip    OUT/footage
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import click

import accuracy
import baselines
import footage
from decomo_eval.query_mode import QUERY_MODES, STRIDED
from decomotion.console import run
from decomotion.files import replacing
from harness.footage_table import table
from harness.markdown import head, line
from harness.records import Record, read_records
from harness.summary import AJ, COLUMNS, by_clip, by_seed
from table import clip_table, row_table

TEN, FIVE = "dev", "dev2"
"""Groups of so many clips; of each `DATASET` and `MASKS` lie in SHARED/data."""
DATASET, MASKS = "tapvid_davis32_{}.pkl", "davis32_{}_mask.npz"
PARTS = BASELINES, PREPARED, FITS, FOOTAGE = "baselines", "prepared", "fits", "footage"
SERIES = {"like-steps": (TEN, FIVE), "seeds": (TEN,)}
"""And the groups that they are of."""
MORE_SEEDS = "pole"
"""A series of one clip, beside those of `seeds`; it has no part in means over clips."""
METHODS = {TEN: "chained,direct,linked", FIVE: "chained"}
WHOLE = ("joints", "ends", "first32")
FINE = "data.flow.gradient_weight=10"
"""Of DIS alone: with it the records of `benchmarks/results/baselines` were made."""
GAPS = "data.flow.intervals=[1,2,4,8]"
"""Of the series' links."""
REFERENCE, SHORT, LONG = "chained-dis", "steps-1200", "cpu"
POLE = "car-shadow"
"""Its fits differ most from seed to seed: a pole of it is hidden for ten frames, and found again in some."""

Rows = dict[str, list[Record]]


def document(rows: Rows, seeds: list[Record], whole: list[str], command: str) -> Iterator[str]:
    """Lines of Markdown: what was measured and how, the rows, the fits clip by clip, the pole, whole clips.

    `seeds` are all fits of the row that has several, `whole` the lines of `footage.py`.
    """
    yield "# TAP-Vid-DAVIS, fifteen development clips, first 32 frames only, 256x256"
    yield ""
    yield f"Made by `{command}` from the records beside this file."
    yield "Published figures are for full-length clips and not comparable."
    yield from ("", *head(["row", "date", "commit", "settings", "machine", "threads"]))
    for name, row in rows.items():
        machines = [record["machine"] for record in row]
        facts = (
            [record["date"] for record in row],
            [record["commit"] for record in row],
            [_settings(record) for record in row],
            [f"{machine['cores']} cores of {machine['processor']}" for machine in machines],
            [machine.get("threads", "not noted") for machine in machines],
        )
        yield line([name, *(", ".join(sorted(set(values))) for values in facts)])
    for title, group in (("ten clips", TEN), ("five further clips", FIVE)):
        some = _of(group, rows)
        for query_mode in QUERY_MODES if some else ():
            reference = by_clip(some[REFERENCE], query_mode) if REFERENCE in some else None
            yield from ("", f"## {title}, {query_mode}", "", *row_table(some, query_mode, reference))
    for name in (SHORT, LONG):
        if name in rows:
            reference = by_clip(rows[REFERENCE], STRIDED) if REFERENCE in rows else None
            yield from ("", f"## {name}, clip by clip, {STRIDED}", "", *clip_table(rows[name], STRIDED, reference))
    if pole := [record for record in seeds if record["clip"] == POLE]:
        yield from ("", f"## {POLE}, seed by seed, {STRIDED}", "", *head(["seed", *(each.title for each in COLUMNS)]))
        for seed in by_seed(pole, AJ, STRIDED):
            of_seed = by_clip([record for record in pole if record["seed"] == seed], STRIDED)[POLE]
            yield line([str(seed), *(each.text(of_seed[each]) for each in COLUMNS)])
    yield from ("", "## Whole clips of 854x480, ten minutes each", "", *whole)


def _of(group: str, rows: Rows) -> Rows:
    """What the rows have of a group of clips; rows that have nothing are left out."""
    dataset = DATASET.format(group)
    some = {name: [record for record in row if record["dataset"] == dataset] for name, row in rows.items()}
    return {name: row for name, row in some.items() if row}


def _settings(record: Record) -> str:
    budget = f"{record['steps']} steps" if record.get("steps") else record.get("time_budget") or ""
    return " ".join(filter(None, [budget, *record["overrides"]]))


def rows_of(out: Path) -> Rows:
    """The records of all rows, but for those of `MORE_SEEDS`."""
    return {name: row for folder in (*SERIES, PREPARED, BASELINES) for name, row in read_records(out / folder).items()}


@click.command(context_settings={"show_default": True})
@click.argument("shared", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--only", type=click.Choice([*PARTS, "table"]), help="One part, and the tables of what is there.")
@click.option("--out", type=click.Path(path_type=Path), default=accuracy.RESULTS, help="Folder of records and tables.")
def main(shared: Path, only: str | None, out: Path) -> None:
    """Regenerate the tables from SHARED/data: the clips of both datasets, whole clips, and their masks."""
    folder = shared / "data"
    data = {
        group: [str(folder / DATASET.format(group)), "--object-masks", str(folder / MASKS.format(group))]
        for group in METHODS
    }
    work: list[tuple[str, click.Command, list[str]]] = []
    for group, methods in METHODS.items():
        flow = ["--methods", methods, "--set", FINE, "--out", str(out / BASELINES)]
        links = ["--methods", "prepared", "--set", GAPS, "--out", str(out / PREPARED)]
        work += [(BASELINES, baselines.main, [*data[group], *flow]), (PREPARED, baselines.main, [*data[group], *links])]
    for series, groups in (SERIES | {MORE_SEEDS: (TEN,)}).items():
        options = ["--series", str(Path(__file__).parent / "series" / f"{series}.yaml"), "--out", str(out / series)]
        work += [(FITS, accuracy.main, [*data[group], *options]) for group in groups]
    asked = [option for part in WHOLE for option in ("--part", part)]
    work.append((FOOTAGE, footage.main, [str(shared), *asked, "--out", str(out / FOOTAGE)]))
    try:
        for part, program, options in work:
            if only in (None, part):
                program.main(options, standalone_mode=False)
    finally:
        if rows := rows_of(out):
            seeds = [*rows.get(LONG, []), *read_records(out / MORE_SEEDS).get(LONG, [])]
            whole = list(table(out / FOOTAGE / "default", out / FOOTAGE / "chained", out / "seeds" / LONG))
            command = f"python benchmarks/development.py {shared}"
            with replacing(path := out / "development.md") as temporary:
                content = document(rows, seeds, whole, command)
                temporary.write_text("\n".join(content) + "\n", encoding="utf-8")
            click.echo(f"wrote {path}")


if __name__ == "__main__":
    sys.exit(run(main))
