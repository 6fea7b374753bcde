"""`decomo-track`: asks an exported model where points go, writes their tracks and, if wanted, a video of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from decomo_runtime.options import CAMERA, check_clip_asked, check_drawing, drawing_options
from decomo_runtime.point_options import Asked, point_options
from decomotion.console import run

if TYPE_CHECKING:
    import numpy as np

_PATH = click.Path(path_type=Path)


@click.command(context_settings={"show_default": True})
@click.argument("model", type=_PATH)
@point_options
@click.option(
    "--frames",
    "frame_range",
    metavar="A:B",
    show_default="all",
    help="Frames in which to look for the points: from A up to but without B.",
)
@click.option("--out", required=True, metavar="FILE", type=_PATH, help="Where to write the tracks: .npz, .csv, ….")
@click.option("--to", metavar="NAME", show_default="by its ending", help="Format of --out; decomo-convert lists them.")
@click.option("--overlay", metavar="MP4", type=_PATH, help="Also draw the tracks on the clip; needs --clip.")
@click.option("--refine", is_flag=True, help="Register what is in sight on the clip's own pixels; needs --clip.")
@click.option(
    "--max-error", metavar="PIXELS", type=float, help="Mark answers hidden that may be farther off than this."
)
@click.option("--clip", "clip_path", metavar="CLIP", type=_PATH, help="Frames or video that the model was fitted to.")
@drawing_options
def track(
    model: Path,
    asked: Asked,
    frame_range: str | None,
    out: Path,
    to: str | None,
    overlay: Path | None,
    refine: bool,
    max_error: float | None,
    clip_path: Path | None,
    mark: str,
    trails: str,
) -> None:
    """Follows points through the clip that MODEL was fitted to.

    MODEL is a file, or the folder of a clip of several windows, written by decomo-export. Give the points in one way:
    --point, --queries, --grid, --mask, --polygon, --box or --points-from. Frames count from 0; x and y are pixels of
    the clip, pixel centres at whole numbers.
    """
    import time

    import numpy as np

    from decomo_runtime.formats.about import About
    from decomo_runtime.formats.registry import format_of
    from decomo_runtime.overlay import check_clip, draw_tracks
    from decomo_runtime.pictures import VIDEO_SUFFIXES, write_video
    from decomo_runtime.queries import parse_frames
    from decomo_runtime.scene_motion import follow_scene
    from decomo_runtime.tracker import Tracker
    from decomotion.clip import read_clip
    from decomotion.outputs import check_new_folder, check_not_input, check_output

    asked.check()
    check_clip_asked(clip_path, overlay, refine, asked.points_from)
    check_drawing(overlay, mark, trails)
    form = format_of(out, to)
    (check_new_folder if form.folder else check_output)("--out", out)
    read = (model, *asked.files, clip_path)
    check_not_input("--out", out, *read)
    if overlay is not None:
        check_output("--overlay", overlay, VIDEO_SUFFIXES)
        check_not_input("--overlay", overlay, *read)

    tracker = Tracker(model)
    queries, names = asked.queries(tracker, clip_path)
    frames = None if frame_range is None else parse_frames(frame_range, tracker.num_frames)
    about = replace(About.of(tracker.facts, clip_path), points=names)
    form.check(len(queries), np.arange(tracker.num_frames) if frames is None else frames, about)
    clip = None
    if clip_path is not None:
        clip = read_clip(clip_path)
        check_clip(clip, tracker.facts)

    start = time.perf_counter()
    tracks = tracker.track(queries, frames)
    if refine and clip is not None:
        tracks = tracker.refine(tracks, clip.frames)
    seconds = time.perf_counter() - start
    model_hidden, marked = tracks.occluded, ""
    if max_error is not None:
        tracks = tracks.within(max_error)
        marked = f"{_share(tracks.occluded & ~model_hidden)} marked hidden for their error, "
    form.write(tracks, out, about)
    if overlay is not None and clip is not None:
        motion = follow_scene(tracker) if trails == CAMERA else None
        drawn = draw_tracks(clip.frames, tracks, mark=mark, motion=motion)
        write_video(overlay, drawn, tracker.fps, times=tracker.times[tracks.frames], pixel_aspect=tracker.pixel_aspect)

    number, length = tracks.occluded.shape
    refined = "" if tracks.refined is None else f"{_share(tracks.refined)} refined, "
    click.echo(
        f"{number} point{'s' * (number != 1)} of {tracker.clip_name} in {length} frame{'s' * (length != 1)}, "
        f"{_share(model_hidden)} occluded, {refined}{marked}{seconds:.2f} s"
    )
    for path in (out, overlay):
        if path is not None:
            click.echo(f"wrote {path}")


def _share(mask: np.ndarray) -> str:
    return f"{mask.mean():.0%}" if mask.size else "none"


def main(argv: Sequence[str] | None = None) -> int:
    """Runs `decomo-track` on `argv` and returns its exit code."""
    return run(track, argv)
