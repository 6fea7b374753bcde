"""`decomo-eval`: a tracker's score on a dataset of true tracks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from decomo_eval.columns import COLUMNS
from decomo_eval.names import BASELINES, FLOWS, ORIGINAL, RESOLUTIONS
from decomo_eval.options import dataset_option, listed, query_mode_option
from decomotion import console

if TYPE_CHECKING:
    from decomo_eval.scoring import Report, Scored


@click.group()
def cli() -> None:
    """Score point tracks against ground truth."""


@cli.command(context_settings={"show_default": True})
@click.argument("dataset", type=click.Path(path_type=Path))
@dataset_option
@click.option(
    "--models",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Folder of <video>.onnx, one fitted model a video, or folders <video> of windows.",
)
@click.option(
    "--predictions",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Folder of <video>.npz, answers of any tracker to the same queries, as its own code returns them.",
)
@click.option(
    "--baseline",
    type=click.Choice(BASELINES),
    help="Track by optical flow alone: chained, direct from the query, or over several gaps. Needs '.[train]'.",
)
@click.option("--flow", type=click.Choice(FLOWS), default=FLOWS[0], help="Of --baseline.")
@click.option("--flow-weights", metavar="FILE", help="RAFT's.  [default: torchvision's, by download]")
@click.option(
    "--resolution",
    type=click.Choice(RESOLUTIONS),
    help="Of the frames that --baseline sees, as stored or brought to TAP-Vid's 256x256.  [default: original]",
)
@query_mode_option
@click.option("--videos", metavar="A,B", help="Score these videos only.  [default: all that have a file]")
@click.option(
    "--object-masks",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help=".npz of masks [T, H, W] by video: --json and --report have what moves apart.",
)
@click.option("--json", "json_path", type=click.Path(dir_okay=False, path_type=Path), help="Write all metrics there.")
@click.option(
    "--report",
    "report_folder",
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Write a page, index.html, and the same as JSON, CSV (by video, by track) and a LaTeX row there.",
)
@click.option(
    "--plots",
    "plots_folder",
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Write the report's plots there alone, as SVG: by video, by threshold, by time.",
)
@click.option(
    "--overlay",
    "overlay_folder",
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Write <video>.mp4 there: predicted tracks on the left, true ones on the right.",
)
def tapvid(
    dataset: Path,
    dataset_name: str | None,
    models: Path | None,
    predictions: Path | None,
    baseline: str | None,
    flow: str,
    flow_weights: str | None,
    resolution: str | None,
    query_mode: str | None,
    videos: str | None,
    object_masks: Path | None,
    json_path: Path | None,
    report_folder: Path | None,
    plots_folder: Path | None,
    overlay_folder: Path | None,
) -> None:
    """Score a tracker on DATASET, a TAP-Vid pickle or a dataset's folder; distances are pixels at 256x256."""
    import json

    from decomo_eval.dataset import chosen_reader
    from decomo_eval.scoring import evaluate
    from decomotion.files import replacing
    from decomotion.outputs import check_folder, check_output

    if resolution is not None and baseline is None:
        raise click.UsageError("--resolution is for --baseline; files say themselves what they were tracked at")
    if json_path is not None:
        check_output("--json", json_path)
    for option, folder in (("--report", report_folder), ("--plots", plots_folder), ("--overlay", overlay_folder)):
        if folder is not None:
            check_folder(option, folder)
    query_mode = query_mode or chosen_reader(dataset, dataset_name).query_mode
    tracker = None
    if baseline is not None:
        from decomo_eval.baselines import FlowBaseline

        tracker = FlowBaseline(baseline, flow, flow_weights)
    watching: list[Callable[[Scored], object]] = []
    plots = None
    if plots_folder is not None:
        from decomo_eval.report.plots import Plots

        plots = Plots(query_mode)
        watching.append(plots.see)
    if overlay_folder is not None:
        from decomo_eval.report.films import write_film

        watching.append(partial(write_film, folder=overlay_folder))
    with ExitStack() as stack:
        writer = None
        if report_folder is not None:
            from decomo_eval.report.writer import ReportWriter

            writer = stack.enter_context(ReportWriter(report_folder, query_mode))
            watching.append(writer.see)
        report = evaluate(
            dataset,
            models,
            predictions,
            query_mode,
            listed(videos),
            tracker=tracker,
            resolution=resolution or ORIGINAL,
            object_masks=object_masks,
            watch=lambda scored: [look(scored) for look in watching],
            dataset_name=dataset_name,
        )
        page = None if writer is None else writer.write(report)
    click.echo(_table(report))
    for line in (*_remarks(report), *_more(report)):
        click.echo(line)
    if json_path is not None:
        with replacing(json_path) as temporary:
            temporary.write_text(json.dumps(report.to_json(), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    click.echo(_summary(report))
    if json_path is not None:
        click.echo(f"wrote {json_path}")
    for path in plots.write(plots_folder, report) if plots is not None and plots_folder is not None else ():
        click.echo(f"wrote {path}")
    for path in (page, overlay_folder):
        if path is not None:
            click.echo(f"wrote {path}")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    return console.run(cli, argv)


def _table(report: Report) -> str:
    rows = [*report.videos.items(), ("mean", report.mean)]
    width = max(len(name) for name, _ in rows)
    head = " " * width + "".join(f"  {column.title:>11}" for column in COLUMNS)
    lines = [f"{name:<{width}}" + "".join(f"  {cell:>11}" for cell in _cells(metrics)) for name, metrics in rows]
    return "\n".join([head, *lines])


def _cells(metrics: Mapping[str, float]) -> list[str]:
    return [column.cell(metrics) for column in COLUMNS]


def _remarks(report: Report) -> list[str]:
    remarks = []
    if report.missing:
        remarks.append(f"not scored, no file in the folder ({len(report.missing)}): {', '.join(report.missing)}")
    if report.undefined:
        remarks.append(
            f"left out of the mean where -, no point to count ({len(report.undefined)}): {', '.join(report.undefined)}"
        )
    if report.without_masks:
        remarks.append(f"without object masks ({len(report.without_masks)}): {', '.join(report.without_masks)}")
    return remarks


def _more(report: Report) -> Iterator[str]:
    """What the table has no column for, means over videos."""
    from decomo_eval.measure import told

    again = told("redetection_jaccard", report.splits["reappeared"]["redetection_jaccard"])
    survival, error = (told(name, report.mean[name]) for name in ("survival", "median_trajectory_error"))
    yield f"AJ after re-detection {again}, survival {survival}, median trajectory error {error}"
    if report.figures:
        figures = ", ".join(f"{name} {told(name, report.mean[name])}" for name in report.figures)
        yield f"as the benchmark's own code counts: {figures}"


def _summary(report: Report) -> str:
    scored, total = len(report.videos), len(report.videos) + len(report.missing)
    aj, within, accuracy, coherence = _cells(report.mean)
    return (
        f"{report.query_mode}, mean over {scored} of {total} videos: "
        f"AJ {aj}, < delta_avg {within}, OA {accuracy}, TC {coherence} px"
    )
