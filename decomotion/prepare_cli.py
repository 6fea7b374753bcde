"""`decomo-prepare`: makes a clip's supervision ahead of the fit, and shows what the fit will learn from."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from decomotion.console import run
from decomotion.options import Supervision, seed_option, supervision_options


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.argument("clip", type=click.Path(path_type=Path))
@supervision_options
@click.option("--preview", metavar="PNG", type=click.Path(path_type=Path), help="Write a sheet of pictures of it.")
@click.option("--rebuild-cache", is_flag=True, help="Prepare anew what is there already.")
@click.option("--device", default="auto", help="auto, cpu, cuda or cuda:N.")
@seed_option
def command(clip: Path, preview: Path | None, rebuild_cache: bool, device: str, seed: int, **options: Any) -> None:
    """Prepare the supervision of CLIP, a folder of frames or a video file; CLIP@A:B takes frames A up to but without B.

    decomo-train with the same options finds it, and so does a second call of this command after the first was stopped.
    """
    from decomotion.clip import read_clip
    from decomotion.outputs import check_output

    if preview is not None:
        check_output("--preview", preview, (".png",))
    frames = read_clip(clip)

    from decomotion.data.cuts import find_cuts
    from decomotion.data.prepare import prepare_in_stages
    from decomotion.device import choose_device
    from decomotion.memory import kept_memory

    device = choose_device(device)
    config = Supervision(**options).config()
    with kept_memory():
        prepared = prepare_in_stages(frames, config.data, seed=seed, rebuild=rebuild_cache, device=device)
    for stage in prepared.stages:
        seconds = ", ".join(f"{part} {each:.1f} s" for part, each in stage.seconds.items())
        click.echo(f"{stage.name}: {stage.bytes / 2**20:.0f} MiB, {f'cached ({seconds})' if stage.cached else seconds}")
    pool, facts = prepared.pool, prepared.stages[0].facts
    kept = next(stage.facts["kept"] for stage in reversed(prepared.stages) if "kept" in stage.facts)
    click.echo(
        f"prepared {frames.name} ({len(frames)} frames of {frames.width}x{frames.height}): {pool.num_points} points a "
        f"frame, {kept:.0%} of their links known, flow at gaps {', '.join(map(str, facts['intervals']))}: "
        f"{prepared.folder}"
    )
    cuts = find_cuts(frames.frames)
    if cuts:
        click.echo(f"the clip cuts to another shot at {', '.join(map(str, cuts))}: see decomo-train --shots")
    if preview is not None:
        from decomotion.data.preview import write_sheet

        write_sheet(frames, pool, prepared.grid, preview)
        click.echo(f"wrote {preview}")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run(command, argv)


if __name__ == "__main__":
    sys.exit(main())
