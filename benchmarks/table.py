"""Makes a Markdown table of the records that `benchmarks/accuracy.py` wrote: `python benchmarks/table.py FOLDER`."""

from __future__ import annotations

import json
from pathlib import Path
from statistics import fmean

import click

COLUMNS = {
    "AJ": ("average_jaccard", 100),
    "< delta_avg": ("average_pts_within_thresh", 100),
    "OA": ("occlusion_accuracy", 100),
    "TC px": ("temporal_coherence", 1),
}


@click.command()
@click.argument("folder", type=click.Path(exists=True, path_type=Path))
@click.option("--query-mode", type=click.Choice(["strided", "first"]), default="strided", show_default=True)
def main(folder: Path, query_mode: str) -> None:
    records = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    click.echo("| clip | " + " | ".join(COLUMNS) + " | train s | peak GiB | model MiB |")
    click.echo("|---" * (len(COLUMNS) + 4) + "|")
    rows = []
    for record in records:
        values = [record["metrics"][query_mode][key] * scale for key, scale in COLUMNS.values()]
        rows.append(values)
        train = record["stages"]["train"]
        cells = [
            f"{value:.2f}" if name == "TC px" else f"{value:.1f}" for name, value in zip(COLUMNS, values, strict=True)
        ]
        size = record["model_bytes"] / 2**20
        click.echo(
            f"| {record['clip']} | "
            + " | ".join(cells)
            + f" | {train['seconds']} | {train['peak_rss_gib']} | {size:.1f} |"
        )
    if rows:
        means = [fmean(column) for column in zip(*rows, strict=True)]
        click.echo("| **mean** | " + " | ".join(f"{value:.2f}" for value in means) + " | | | |")


if __name__ == "__main__":
    main()
