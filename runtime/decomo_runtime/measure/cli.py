"""`decomo-measure`: displacement, velocity, acceleration and strain, out of an exported model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from decomo_runtime.options import check_clip_asked
from decomo_runtime.point_options import Asked, point_options
from decomotion.console import run

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from decomo_runtime.measure.following import MeasureSettings
    from decomo_runtime.measure.maps import Raster, StrainMap
    from decomo_runtime.measure.picture import Colours
    from decomo_runtime.measure.points import PointMotion
    from decomo_runtime.measure.region import RegionMotion
    from decomo_runtime.tracker import Tracker
    from decomotion.clip import Clip

    Image = npt.NDArray[np.uint8]

_PATH = click.Path(path_type=Path)
FORMATS = ("npz", "csv", "exr")
SIGNED = ("_x", "_y", "_xx", "_yy", "_xy", "principal_1", "principal_2", "rotation", "area_change")
"""Ends of the names of what is below 0 as often as above."""
LOOKED_AT = 5
"""Frames of a map by which its colours are chosen."""


@click.command(context_settings={"show_default": True})
@click.argument("model", type=_PATH)
@point_options
@click.option("--map", "as_map", is_flag=True, help="A map of all pixels, or of those in the region.")
@click.option(
    "--gauge", metavar="PIXELS", type=float, show_default="32", help="Of a --map: side of the square of each strain."
)
@click.option(
    "--reference",
    metavar="T",
    type=int,
    help="Frame that displacement and strain are against.  [default: that of the points; of a map of all, 0]",
)
@click.option(
    "--frames", "frame_range", metavar="A:B", show_default="all", help="Frames to measure: from A up to but without B."
)
@click.option("--scale", metavar="LENGTH/px", help="Length of a pixel, such as 0.12mm/px.  [default: pixels]")
@click.option("--fps", type=float, help="Frames a second as the camera recorded them.  [default: the clip's own times]")
@click.option(
    "--smooth", metavar="FRAMES,ORDER", default="7,2", help="Of velocity and acceleration: window and polynomial."
)
@click.option("--out", required=True, metavar="FILE|DIR", type=_PATH, help=".csv or .npz; of a --map a new folder.")
@click.option("--format", type=click.Choice(FORMATS), help="Of a --map's files.  [default: npz]")
@click.option("--refine", is_flag=True, help="Register what is in sight on the clip's own pixels; needs --clip.")
@click.option("--overlay", metavar="MP4", type=_PATH, help="Also draw it in colours on the clip; needs --clip.")
@click.option(
    "--show", metavar="NAME", help="What the colours mean.  [default: speed; of regions and maps principal_1]"
)
@click.option("--limit", type=float, help="Value of the last colour.  [default: 98 of 100 values are within]")
@click.option("--clip", "clip_path", metavar="CLIP", type=_PATH, help="Frames or video that the model was fitted to.")
def measure(
    model: Path,
    asked: Asked,
    as_map: bool,
    gauge: float | None,
    reference: int | None,
    frame_range: str | None,
    scale: str | None,
    fps: float | None,
    smooth: str,
    out: Path,
    format: str | None,
    refine: bool,
    overlay: Path | None,
    show: str | None,
    limit: float | None,
    clip_path: Path | None,
) -> None:
    """Measures how points move and regions deform in the clip that MODEL was fitted to.

    MODEL is a file, or the folder of a clip of several windows, written by decomo-export. Points (--point, --queries,
    --grid, --points-from) give displacement, velocity and acceleration; a region (--box, --polygon, --mask) gives its
    strain, rotation and change of area too; --map gives these around every node of a raster. x goes right, y down.
    """
    import numpy as np

    from decomo_runtime.errors import MeasureError, OverlayError
    from decomo_runtime.measure.files import TABLES, check_format
    from decomo_runtime.measure.following import MeasureSettings, check_reference
    from decomo_runtime.measure.maps import GAUGE, raster_over
    from decomo_runtime.measure.smoothing import Smoothing
    from decomo_runtime.measure.units import Scale
    from decomo_runtime.overlay import check_clip
    from decomo_runtime.pictures import VIDEO_SUFFIXES
    from decomo_runtime.queries import parse_frames
    from decomo_runtime.regions import SPACING
    from decomo_runtime.tracker import Tracker
    from decomotion.clip import read_clip
    from decomotion.outputs import check_new_folder, check_not_input, check_output

    if as_map:
        if asked.given and not asked.is_region:
            raise MeasureError("--map is of all pixels, or of a --box, --polygon or --mask; leave out single points")
        if asked.on is not None:
            raise MeasureError("--map measures objects and scene apart already; leave out --on")
        check_format(format or FORMATS[0])
        check_new_folder("--out", out)
    else:
        asked.check()
        if format is not None or gauge is not None:
            raise MeasureError("--format and --gauge go with --map; a file's ending is its format, a region its gauge")
        check_output("--out", out, tuple(TABLES))
    check_clip_asked(clip_path, overlay, refine, asked.points_from)
    if overlay is None and (show is not None or limit is not None):
        raise OverlayError("--show and --limit say how an --overlay is drawn; give one, or leave them out")
    if limit is not None and not 0 < limit < np.inf:
        raise OverlayError(f"--limit {limit:g} must be above 0")
    read = (model, *asked.files, clip_path)
    check_not_input("--out", out, *read)
    if overlay is not None:
        check_output("--overlay", overlay, VIDEO_SUFFIXES)
        check_not_input("--overlay", overlay, *read)
    settings = MeasureSettings(Scale() if scale is None else Scale.parse(scale), fps, Smoothing.parse(smooth), True)

    tracker = Tracker(model)
    settings.times(tracker)
    frames = None if frame_range is None else parse_frames(frame_range, tracker.num_frames)
    if reference is not None:
        check_reference(reference, tracker)
    clip = None
    if clip_path is not None:
        clip = read_clip(clip_path)
        check_clip(clip, tracker.facts)
    pixels = clip.frames if clip is not None and refine else None
    shown = None if overlay is None else (overlay, show, limit)
    if as_map:
        region = _region(asked, tracker, reference)
        start = (0 if region is None else region.frame) if reference is None else reference
        raster = raster_over(
            tracker,
            start,
            spacing=SPACING if asked.spacing is None else asked.spacing,
            gauge=GAUGE if gauge is None else gauge,
            region=None if region is None else region.mask,
        )
        told = _write_maps(tracker, raster, frames, pixels, settings, out, format or FORMATS[0], clip, shown)
    else:
        told = _write_motion(tracker, asked, clip_path, reference, frames, pixels, settings, out, clip, shown)
    click.echo(f"{tracker.clip_name}: {told}; lengths in {settings.scale.unit}")
    for path in (out, overlay):
        if path is not None:
            click.echo(f"wrote {path}")


def _region(asked: Asked, tracker: Tracker, reference: int | None) -> Any:
    """The region that a map is of; `MeasureError` where it is of another frame than that of reference."""
    from decomo_runtime.errors import MeasureError
    from decomo_runtime.regions import REGIONS

    if not asked.given:
        return None
    asked.check()
    ((option, text),) = asked.given.items()
    region = REGIONS[option](text, tracker.facts)
    if reference not in (None, region.frame):
        raise MeasureError(
            f"{option} {text} is of frame {region.frame} but a map is of the frame of reference, {reference}; "
            "give the region there, or leave out --reference"
        )
    return region


def _write_motion(
    tracker: Tracker,
    asked: Asked,
    clip_path: Path | None,
    reference: int | None,
    frames: npt.NDArray[np.int64] | None,
    pixels: Any,
    settings: MeasureSettings,
    out: Path,
    clip: Clip | None,
    shown: tuple[Path, str | None, float | None] | None,
) -> str:
    """Of points, or of a region: what is told of it."""
    from decomo_runtime.measure.files import TABLES
    from decomo_runtime.measure.points import measure_points
    from decomo_runtime.measure.region import measure_region
    from decomo_runtime.pictures import write_video
    from decomo_runtime.regions import SPACING
    from decomotion.files import replacing

    queries, _ = asked.queries(tracker, clip_path)
    ask = measure_region if asked.is_region else measure_points
    motion = ask(tracker, queries, frames=frames, reference=reference, clip=pixels, settings=settings)
    measured = motion.measured()
    colours = None if shown is None else _colours(measured, *shown[1:], "principal_1" if asked.is_region else "speed")
    number = len(queries)
    apart = (asked.spacing or SPACING) if asked.is_region else (tracker.height * tracker.width / number) ** 0.5 / 2
    with replacing(out) as temporary:
        TABLES[out.suffix.lower()](measured, temporary, tracker.pixel_aspect)
    if shown is not None and clip is not None and colours is not None:
        times = tracker.times[motion.tracks.frames]
        drawn = _drawn_points(motion, colours, tracker, clip, apart)
        write_video(shown[0], drawn, tracker.fps, times=times, pixel_aspect=tracker.pixel_aspect)
    length = len(motion.times)
    kind = f"a region of {number} points" if asked.is_region else f"{number} point{'s' * (number != 1)}"
    return f"{kind} in {length} frame{'s' * (length != 1)}, {motion.hidden.mean():.0%} occluded"


def _drawn_points(
    motion: PointMotion | RegionMotion, colours: Colours, tracker: Tracker, clip: Clip, apart: float
) -> Iterator[Image]:
    """Of points that are about `apart` pixels apart."""
    import numpy as np

    from decomo_runtime.measure.picture import Chart

    chart = Chart(colours, (tracker.height, tracker.width), motion.settings.scale, tracker.pixel_aspect)
    values = np.broadcast_to(motion.measured().named(colours.name).values, motion.tracks.occluded.shape)
    for column, frame in enumerate(motion.tracks.frames.tolist()):
        hidden = motion.tracks.occluded[:, column]
        yield chart.points(clip.frames[frame], motion.tracks.xy[:, column], values[:, column], hidden, apart)


def _write_maps(
    tracker: Tracker,
    raster: Raster,
    frames: npt.NDArray[np.int64] | None,
    pixels: Any,
    settings: MeasureSettings,
    out: Path,
    format: str,
    clip: Clip | None,
    shown: tuple[Path, str | None, float | None] | None,
) -> str:
    """A file for each frame: what is told of them."""
    from contextlib import ExitStack
    from dataclasses import replace

    import numpy as np

    from decomo_runtime.measure.files import MAPS
    from decomo_runtime.measure.maps import measure_maps
    from decomo_runtime.pictures import write_video
    from decomotion.files import new_folder

    numbers = np.arange(tracker.num_frames) if frames is None else frames
    colours = None
    if shown is not None:
        few = numbers[np.unique(np.linspace(0, len(numbers) - 1, LOOKED_AT).round().astype(int))]
        quiet = replace(settings, progress=False)
        looked_at = [each.measured() for each in measure_maps(tracker, raster, frames=few, settings=quiet)]
        colours = _colours(looked_at, *shown[1:], "principal_1")
    hidden = []

    def written(folder: Path) -> Iterator[StrainMap]:
        for each in measure_maps(tracker, raster, frames=numbers, clip=pixels, settings=settings):
            MAPS[format](each.measured(), folder / f"{each.frame:05d}.{format}", tracker.pixel_aspect)
            hidden.append(float(each.hidden[raster.inside].mean()))
            yield each

    with ExitStack() as stack:
        maps = written(stack.enter_context(new_folder(out)))
        if shown is not None and clip is not None and colours is not None:
            drawn = _drawn_maps(maps, colours, tracker, clip)
            times = tracker.times[numbers]
            write_video(shown[0], drawn, tracker.fps, times=times, pixel_aspect=tracker.pixel_aspect)
        else:
            for _ in maps:
                pass
    height, width = raster.inside.shape
    along, down = raster.gauge
    return (
        f"{len(numbers)} map{'s' * (len(numbers) != 1)} of {width}x{height} nodes against frame {raster.reference}, "
        f"gauge {along:.3g}x{down:.3g} px, {np.mean(hidden):.0%} occluded"
    )


def _drawn_maps(maps: Iterator[StrainMap], colours: Colours, tracker: Tracker, clip: Clip) -> Iterator[Image]:
    from decomo_runtime.measure.picture import Chart

    chart = None
    for each in maps:
        if chart is None:
            size = tracker.height, tracker.width
            chart = Chart(colours, size, each.settings.scale, tracker.pixel_aspect)
        values = each.measured().named(colours.name).values
        yield chart.cells(clip.frames[each.frame], each.xy, values, each.hidden, each.raster.on_object)


def _colours(measured: Any, show: str | None, limit: float | None, usual: str) -> Colours:
    """Of what is shown; `measured` is one or several."""
    import numpy as np

    from decomo_runtime.errors import MeasureError
    from decomo_runtime.measure.picture import Colours, limit_of

    all_of_it = measured if isinstance(measured, list) else [measured]
    places = ("x", "y")
    kinds = [each for each in all_of_it[0].quantities if each.values.dtype.kind == "f" and each.name not in places]
    names = [each.name for each in kinds]
    name = show or usual
    if name not in names:
        raise MeasureError(f"--show {name} is nothing that is measured here; choose from {', '.join(names)}")
    values = np.concatenate([each.named(name).values.ravel() for each in all_of_it])
    hidden = np.concatenate([each.named("occluded").values.ravel() for each in all_of_it])
    found = limit_of(values, hidden) if limit is None else limit
    return Colours(name, all_of_it[0].named(name).unit, found, name.endswith(SIGNED))


def main(argv: Sequence[str] | None = None) -> int:
    """Runs `decomo-measure` on `argv` and returns its exit code."""
    return run(measure, argv)
