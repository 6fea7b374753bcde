"""What preparation costs and how good it is: processor seconds by part, disk and memory, links and masks against truth.

    python benchmarks/preparation.py ../shared/data/clips/apple.mp4 --frames 100 --size 854x480 --out OUT
    python benchmarks/preparation.py ../shared/data/davis480p/frames/{camel,goat} --frames 24 \
        --truth ../shared/data/davis480p --code before=../before --code now=. --out OUT

A clip is brought to that size and, where it is shorter, played back and forth to that length. `--code` names states of
the code beside each other, folders with a checkout each. One JSON record for each clip and state; those that are there
are not made again. Each is made by a process of its own with a cache of its own, which is removed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import fmean
from typing import Any

import click
import cv2
import numpy as np

from decomotion.clip import read_clip
from decomotion.files import replacing
from decomotion.images import png
from harness.markdown import head, line

HERE = Path(__file__).resolve().parent
CHILD = HERE / "harness" / "prepare_once.py"
ANNOTATED = 32
"""Frames that TAP-Vid's tracks of `davis480p` are annotated in."""
PARTS = ("reading", "frames", "matches", "flow", "links", "features", "motion", "all")
FIGURES = ("linked", "median", "within_1", "within_2", "within_4", "linked_within_2", "confidence_of_hidden")


def write_frames(clip: Path, frames: int, size: tuple[int, int], folder: Path) -> None:
    """Writes PNG files of the clip at (width, height), played back and forth until it has so many frames."""
    content = read_clip(clip).frames
    there_and_back = [*range(len(content)), *range(len(content) - 2, 0, -1)]
    for number in range(frames):
        frame = content[there_and_back[number % len(there_and_back)]]
        if frame.shape[1::-1] != size:
            frame = np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), np.uint8)
        (folder / f"{number:05}.png").write_bytes(png(frame))


def write_truth(davis: Path, name: str, frames: int, size: tuple[int, int], file: Path) -> None:
    """Writes the tracks of a clip of `davis480p` in pixels, and its masks, for its first frames."""
    annotated = min(frames, ANNOTATED)
    with np.load(davis / "annotations.npz") as content:
        xy = content[f"{name}/first32/points"][:, :annotated] * np.array(size) - 0.5
        occluded = content[f"{name}/first32/occluded"][:, :annotated]
    files = sorted((davis / "masks" / name).iterdir())[:frames]
    masks = [cv2.imread(str(each), cv2.IMREAD_UNCHANGED) for each in files]
    drawn = [(mask if mask is None or mask.ndim == 2 else mask.max(axis=-1)) for mask in masks]
    np.savez_compressed(file, xy=xy, occluded=occluded, masks=np.stack([np.asarray(each) > 0 for each in drawn]))


def record_of(clip: Path, code: Path, truth: Path | None, settings: dict[str, Any], size: tuple[int, int]) -> str:
    """What a process with the code in `code` says of the clip."""
    if place := os.environ.get("DECOMO_CACHE"):
        Path(place).mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=place) as name:
        folder = Path(name)
        for part in ("clip", "cache"):
            (folder / part).mkdir()
        write_frames(clip, settings["frames"], size, folder / "clip")
        if truth is not None:
            write_truth(truth, clip.name, settings["frames"], size, folder / "truth.npz")
            settings = {**settings, "truth": str(folder / "truth.npz")}
        environment = {**os.environ, "PYTHONPATH": str(code.resolve()), "DECOMO_CACHE": str(folder / "cache")}
        command = [sys.executable, str(CHILD), str(folder / "clip"), str(folder / "record.json"), json.dumps(settings)]
        subprocess.run(command, env=environment, check=True)
        return (folder / "record.json").read_text(encoding="utf-8")


def table(out: Path) -> str:
    """Markdown: of each clip and state of the code the seconds by part, then links and masks; and the means."""
    files = sorted(out.glob("*.json"))
    records = [(*file.stem.rsplit(".", 1), json.loads(file.read_text(encoding="utf-8"))) for file in files]
    rows = [(clip, code, record) for clip, code, record in records if "links" in record]
    lines = [*head(["clip", "code", "frames", *PARTS, "MiB of memory"])]
    for clip, code, record in records:
        seconds = [f"{record['cpu_seconds'].get(part, 0):.1f}" for part in PARTS]
        lines.append(line([clip, code, str(record["frames"]), *seconds, f"{record['memory_mib']['peak']:.0f}"]))
    lines += ["", *head(["clip", "code", *FIGURES, "masks"])]
    for clip, code, record in rows:
        lines.append(line([clip, code, *_figures([record])]))
    for frames, code in sorted({(record["frames"], code) for _, code, record in rows}):
        group = [record for _, other, record in rows if (record["frames"], other) == (frames, code)]
        lines.append(line([f"**mean of {frames} frames**", code, *_figures(group)]))
    return "\n".join(lines)


def _figures(records: list[dict[str, Any]]) -> list[str]:
    """Means of what `FIGURES` names, and of the masks."""
    links = [fmean(record["links"][figure] for record in records) for figure in FIGURES]
    return [f"{value:.3f}" for value in (*links, fmean(record["masks"] for record in records))]


@click.command(context_settings={"show_default": True})
@click.argument("clips", type=click.Path(exists=True, path_type=Path), nargs=-1)
@click.option("--frames", default=100)
@click.option("--size", default="854x480")
@click.option("--preset", default="cpu")
@click.option("--set", "overrides", multiple=True, default=["data.flow.intervals=[1,2,4,8]"])
@click.option("--truth", type=click.Path(exists=True, path_type=Path), help="The folder davis480p, for clips of it.")
@click.option("--code", "codes", multiple=True, default=["now=."], help="NAME=FOLDER, any number of times.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the records.")
def main(
    clips: tuple[Path, ...],
    frames: int,
    size: str,
    preset: str,
    overrides: tuple[str, ...],
    truth: Path | None,
    codes: tuple[str, ...],
    out: Path,
) -> None:
    width, height = (int(side) for side in size.split("x"))
    settings = {"frames": frames, "preset": preset, "overrides": overrides}
    for clip in clips:
        for name, _, code in (each.partition("=") for each in codes):
            file = out / f"{clip.stem}-{frames}.{name}.json"
            if not file.is_file():
                with replacing(file) as temporary:
                    record = record_of(clip, Path(code), truth, settings, (width, height))
                    temporary.write_text(record, encoding="utf-8")
    click.echo(table(out))


if __name__ == "__main__":
    main()
