"""`decomo-render`: a clip's layers as an exported model has them, and the clip itself, changed by what the model knows:
without its objects, with an edit of one frame shown in all, or held still.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from decomo_runtime.contract import LAYERS
from decomo_runtime.edit_cli import EditOptions, edit_options
from decomo_runtime.options import CAMERA, check_drawing, drawing_options
from decomo_runtime.stabilise_cli import StabiliseOptions, stabilise_options
from decomotion.console import run

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from decomo_runtime.tracker import Tracker
    from decomotion.clip import Clip

    Image = npt.NDArray[np.uint8]
    Draw = Callable[[Image, int], Image]

_PATH = click.Path(path_type=Path)
ALL = "all"


@click.command(context_settings={"show_default": True})
@click.argument("model", type=_PATH)
@click.option(
    "--layer",
    type=click.Choice([*LAYERS, ALL]),
    help=f"What to render.  [default: {LAYERS[0]}]",
)
@click.option("--remove-objects", is_flag=True, help="Instead: the clip, behind its objects what other frames show.")
@edit_options
@stabilise_options
@click.option("--clip", "clip_path", metavar="CLIP", type=_PATH, help="Frames or video that the model was fitted to.")
@click.option(
    "--frames", "frame_range", metavar="A:B", show_default="all", help="Frames to render: from A up to but without B."
)
@click.option(
    "--size",
    metavar="PIXELS",
    type=int,
    help="Of the longer side.  [default: the clip's, enlarged for an --overlay where small]",
)
@click.option(
    "--out",
    required=True,
    metavar="FILE|DIR",
    type=_PATH,
    help="A video, .mp4 (H.264), .webm (VP9, keeps alpha) or .mov (ProRes 4444, keeps alpha); without one of these "
    "endings a new folder of PNGs.",
)
@click.option("--overlay", metavar="TRACKS.npz", type=_PATH, help="Draw these tracks, of decomo-track, on it.")
@drawing_options
def render(
    model: Path,
    layer: str | None,
    remove_objects: bool,
    clip_path: Path | None,
    frame_range: str | None,
    size: int | None,
    out: Path,
    overlay: Path | None,
    mark: str,
    trails: str,
    **given: Any,
) -> None:
    """Renders the clip that MODEL was fitted to, decomposed into static scene and moving objects.

    Objects alone, and the static scene where it was never seen, are transparent; in .mp4, with --overlay and in the
    video of all layers they lie on chequers.
    All layers make one video side by side, or a folder for each.

    With --clip and one of --remove-objects, --edit and --stabilise it is the clip itself, changed.
    """
    import numpy as np
    from tqdm import tqdm

    from decomo_runtime.errors import RenderError
    from decomo_runtime.layers import raster_size
    from decomo_runtime.layers import render as render_layers
    from decomo_runtime.pictures import ALPHA_SUFFIXES, VIDEO_SUFFIXES, on_black, write_sequence, write_video
    from decomo_runtime.queries import parse_frames
    from decomo_runtime.removal import remove_objects as remove
    from decomo_runtime.tracker import Tracker
    from decomotion.memory import returned_memory
    from decomotion.outputs import check_new_folder, check_not_input, check_output

    edits, still = EditOptions.of(given), StabiliseOptions.of(given)
    asked = {"--remove-objects": remove_objects, "--edit": edits.edit, "--stabilise": still.stabilise is not None}
    changes = [option for option, wanted in asked.items() if wanted]
    if len(changes) > 1:
        raise RenderError(f"{' and '.join(changes)} each make a clip of their own; give one, and the other its result")
    if changes and (layer is not None or size is not None):
        raise RenderError(f"{changes[0]} keeps the clip's own pixels and size; leave out --layer and --size")
    if changes and clip_path is None:
        raise RenderError(f"{changes[0]} and --clip go together: the clip's own pixels are kept")
    if clip_path is not None and not changes:
        raise RenderError(f"--clip goes together with one of {', '.join(asked)}; give one, or leave it out")
    if still.stabilise is not None and overlay is not None:
        raise RenderError("--overlay draws where points are in the clip, and --stabilise moves it; leave one out")
    edits.check()
    still.check(model, clip_path, out)
    check_drawing(overlay, mark, trails)
    is_video = out.suffix != ""
    if is_video:
        check_output("--out", out, (*VIDEO_SUFFIXES, *ALPHA_SUFFIXES))
        check_not_input("--out", out, model, clip_path, overlay, *edits.files)
    else:
        check_new_folder("--out", out)

    tracker = Tracker(model)
    raster_size(tracker.facts, size)
    frames = np.arange(tracker.num_frames) if frame_range is None else parse_frames(frame_range, tracker.num_frames)
    layers = LAYERS if layer == ALL else (layer or LAYERS[0],)
    draw = None if overlay is None else _drawing(tracker, overlay, frames, size, mark, trails)
    done = None
    if clip_path is None:
        rendered = (render_layers(tracker, int(frame), layers, long_side=size) for frame in frames)
    else:
        clip = _clip(tracker, clip_path)
        if remove_objects:
            layers, changed = ("without objects",), remove(tracker, clip.frames, frames.tolist())
        elif edits.edit:
            layers, changed = ("edits",), edits.pictures(tracker, clip, frames)
        else:
            done, changed = still.pictures(tracker, clip, frames)
            layers = (f"stabilised {done.still.what}",)
            if is_video and out.suffix.lower() not in ALPHA_SUFFIXES:
                changed = map(on_black, changed)
        rendered = ([picture] for picture in changed)
    progress = tqdm(rendered, "render", total=len(frames), leave=False)
    with returned_memory(), progress as bar:  # which is gone before a failure is told
        pictures = zip(frames.tolist(), bar, strict=True)
        if draw is not None:
            pictures = ((frame, [draw(layer, frame) for layer in each]) for frame, each in pictures)
        if is_video:
            keeps_alpha = out.suffix.lower() in ALPHA_SUFFIXES and len(layers) == 1
            layout = (_side_by_side(each, keeps_alpha) for _, each in pictures)
            write_video(out, layout, tracker.fps, times=tracker.times[frames], pixel_aspect=tracker.pixel_aspect)
        else:
            write_sequence(out, _named(pictures, layers))
    click.echo(f"{', '.join(layers)} of {tracker.clip_name}, {len(frames)} frame{'s' * (len(frames) != 1)}")
    click.echo(f"wrote {out}")
    if done is not None and clip_path is not None:
        for line in still.save(done, tracker, clip_path):
            click.echo(line)


def _clip(tracker: Tracker, path: Path) -> Clip:
    from decomo_runtime.overlay import check_clip
    from decomotion.clip import read_clip

    clip = read_clip(path)
    check_clip(clip, tracker.facts)
    return clip


def _drawing(
    tracker: Tracker, path: Path, frames: npt.NDArray[np.int64], long_side: int | None, mark: str, trails: str
) -> Draw:
    """Draws the tracks of the file at `path` on a picture of a frame; the file must have all `frames`."""
    from decomo_runtime.errors import OverlayError
    from decomo_runtime.layers import raster_size
    from decomo_runtime.overlay import Painter
    from decomo_runtime.pictures import flattened
    from decomo_runtime.scene_motion import follow_scene
    from decomo_runtime.tracks import Tracks

    tracks = Tracks.load(path)
    if tracks.size not in (None, (tracker.height, tracker.width)):
        height, width = tracks.size
        raise OverlayError(
            f"{path} has tracks in frames of {width}x{height} but the model was fitted to frames of "
            f"{tracker.width}x{tracker.height}; give tracks of this model"
        )
    columns = {frame: column for column, frame in enumerate(tracks.frames.tolist())}
    missing = [frame for frame in frames.tolist() if frame not in columns]
    if missing or max(columns) >= tracker.num_frames:
        wrong = f"lacks frame {missing[0]}" if missing else f"has a frame {max(columns)}"
        raise OverlayError(f"{path} {wrong} of {tracker.num_frames}; give tracks of this model for the frames rendered")
    motion = follow_scene(tracker) if trails == CAMERA else None
    canvas = None if long_side is None else raster_size(tracker.facts, long_side)
    painter = Painter(tracks, (tracker.height, tracker.width), canvas=canvas, mark=mark, motion=motion)
    return lambda picture, frame: painter.draw(flattened(picture), columns[frame])


def _side_by_side(pictures: Sequence[Image], keep_alpha: bool) -> Image:
    """The pictures of one frame as one of a video, three in a row."""
    from decomo_runtime.pictures import evened, flattened, tiled

    return evened(tiled([each if keep_alpha else flattened(each) for each in pictures], min(3, len(pictures))))


def _named(pictures: Iterator[tuple[int, list[Image]]], layers: Sequence[str]) -> Iterator[tuple[str, Image]]:
    """Each picture with its file's name: the frame's number, of several layers in a folder for each."""
    for frame, each in pictures:
        for layer, picture in zip(layers, each, strict=True):
            yield f"{layer}/{frame:05d}" if len(layers) > 1 else f"{frame:05d}", picture


def main(argv: Sequence[str] | None = None) -> int:
    """Runs `decomo-render` on `argv` and returns its exit code."""
    return run(render, argv)
