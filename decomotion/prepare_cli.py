"""`decomo-prepare`: makes a clip's supervision ahead of the fit, and shows what the fit will learn from."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from decomotion.console import run
from decomotion.options import Supervision, seed_option, supervision_options, window_options

if TYPE_CHECKING:
    from decomotion.clip import Clip
    from decomotion.data.prepare import Preparation


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("clip", type=click.Path(path_type=Path))
@supervision_options
@click.option("--preview", metavar="PNG", type=click.Path(path_type=Path), help="Write a sheet of pictures of it.")
@click.option("--rebuild-cache", is_flag=True, help="Prepare anew what is there already.")
@click.option("--device", default="auto", help="auto, cpu, cuda or cuda:N.")
@seed_option
@window_options
def command(
    clip: Path,
    preview: Path | None,
    rebuild_cache: bool,
    device: str,
    seed: int,
    shots: str,
    window: int | str,
    **options: Any,
) -> None:
    """Prepare the supervision of CLIP, a folder of frames or a video file; CLIP@A:B takes frames A up to but without B.

    decomo-train with the same options finds it, and so does a second call of this command after the first was stopped.
    Of a long clip each window is prepared, one after the other; previews are then named after their windows.
    """
    from decomotion.clip import read_clip
    from decomotion.outputs import check_output

    if preview is not None:
        check_output("--preview", preview, (".png",))
    frames = read_clip(clip)

    from decomotion.data.prepare import prepare_in_stages
    from decomotion.device import choose_device
    from decomotion.long_clip import check_no_files, lay_out
    from decomotion.memory import kept_memory

    device = choose_device(device)
    config = Supervision(**options).config()
    layout = lay_out(frames, window, shots)
    if len(layout.windows) > 1:
        check_no_files(config.data)
    for part in layout.windows:
        piece, sheet = frames, preview
        if len(layout.windows) > 1:
            piece = frames.part(part.begin, part.end, part.name)
            sheet = None if preview is None else preview.with_stem(f"{preview.stem}-{part.name}")
        with kept_memory():
            prepared = prepare_in_stages(piece, config.data, seed=seed, rebuild=rebuild_cache, device=device)
        _tell(piece, prepared)
        if sheet is not None:
            from decomotion.data.preview import write_sheet

            write_sheet(piece, prepared.pool, prepared.grid, sheet)
            click.echo(f"wrote {sheet}")


def _tell(clip: Clip, prepared: Preparation) -> None:
    for stage in prepared.stages:
        seconds = ", ".join(f"{part} {each:.1f} s" for part, each in stage.seconds.items())
        click.echo(f"{stage.name}: {stage.bytes / 2**20:.0f} MiB, {f'cached ({seconds})' if stage.cached else seconds}")
    facts = prepared.stages[0].facts
    kept = next(stage.facts["kept"] for stage in reversed(prepared.stages) if "kept" in stage.facts)
    click.echo(
        f"prepared {clip.name} ({len(clip)} frames of {clip.width}x{clip.height}): {prepared.pool.num_points} points a "
        f"frame, {kept:.0%} of their links known, flow at gaps {', '.join(map(str, facts['intervals']))}: "
        f"{prepared.folder}"
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run(command, argv)


if __name__ == "__main__":
    sys.exit(main())
