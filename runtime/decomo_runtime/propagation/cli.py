"""`decomo-propagate`: what is drawn on a few frames, carried to all others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from decomo_runtime.options import file_and_frame
from decomotion.console import run

_PATH = click.Path(path_type=Path)


@click.command(context_settings={"show_default": True})
@click.argument("model", type=_PATH)
@click.option(
    "--from",
    "annotations",
    required=True,
    multiple=True,
    metavar="FILE[@T]",
    help="What is drawn, on frame T where the file does not say; several times for several files of one format: label "
    "PNGs, COCO, labelme, CVAT for video, Label Studio.",
)
@click.option("--out", required=True, metavar="DIR", type=_PATH, help="A new folder: the same format, and report.csv.")
@click.option(
    "--clip", "clip_path", metavar="CLIP", type=_PATH, help="Frames or video that the model was fitted to: finer rims."
)
def propagate(model: Path, annotations: Sequence[str], out: Path, clip_path: Path | None) -> None:
    """Carries masks, polygons, boxes and keypoints that are drawn on one or several frames to all frames.

    MODEL is a file, or the folder of a clip of several windows, written by decomo-export. Frames count from 0. Each
    annotated frame speaks where it is seen best; report.csv has a confidence for each frame and object, gaps, and where
    annotated frames disagree.
    """
    import time

    from decomo_runtime.propagation.folder import propagate_files
    from decomo_runtime.tracker import Tracker
    from decomotion.outputs import check_new_folder

    check_new_folder("--out", out)
    tracker = Tracker(model)
    start = time.perf_counter()
    report = propagate_files(
        tracker, [file_and_frame(each) for each in annotations], out, clip=clip_path, progress=True
    )
    number, drawn = len(report.things), len({each.frame for each in report.findings if each.drawn})
    gaps = len(report.gaps)
    click.echo(
        f"{number} object{'s' * (number != 1)} of {drawn} annotated frame{'s' * (drawn != 1)} in "
        f"{tracker.num_frames} frames of {tracker.clip_name}, {gaps} gap{'s' * (gaps != 1)}, "
        f"{time.perf_counter() - start:.2f} s"
    )
    for region in (True, False):
        for each in report.worst(region):
            amount = f"{each.disagreement:.0%} of the area" if region else f"{each.disagreement:.1f} pixels"
            first, second = each.between or (0, 0)
            click.echo(
                f"{report.things[each.thing].name}: annotations of frames {first} and {second} disagree the most in "
                f"frame {each.frame}, by {amount}"
            )
    click.echo(f"wrote {out}")


def main(argv: Sequence[str] | None = None) -> int:
    """Runs `decomo-propagate` on `argv` and returns its exit code."""
    return run(propagate, argv)
