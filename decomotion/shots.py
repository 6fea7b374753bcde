"""Clips of several shots: one run and one model for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, Field, ValidationError

from decomotion.clip import Clip
from decomotion.data.config import DataConfig
from decomotion.data.cuts import find_cuts
from decomotion.data.flow.config import FolderFlowConfig
from decomotion.errors import CheckpointError, ClipError, ConfigError
from decomotion.files import replacing

FILE_NAME = "shots.json"
"""In the folder of the clip's runs: `docs/formats.md`."""


@dataclass(frozen=True)
class Shot:
    """Some frames of a clip, which is fitted as a clip of its own, numbered from 0."""

    name: Annotated[str, Field(pattern="^shot-[0-9]+$")]
    """Of the run's folder: `shot-000`, …"""
    begin: int
    """First frame in the clip."""
    end: int
    """The frame after its last."""


class _Shots(BaseModel):
    """`shots.json`."""

    clip: str
    num_frames: int
    shots: list[Shot]


def check_one_shot(clip: Clip) -> None:
    """Raises `ClipError` where the clip has cuts."""
    cuts = find_cuts(clip.frames)
    if cuts:
        many = "s" if len(cuts) > 1 else ""
        raise ClipError(
            f"{clip.name} cuts to another shot at frame{many} {', '.join(map(str, cuts))}, and no motion leads across; "
            "fit each shot by itself with --shots split, or take it as one shot with --shots ignore"
        )


def shots_of(clip: Clip) -> list[Shot]:
    """The clip's shots; one where it has no cut.

    Raises `ClipError` where one has a single frame.
    """
    bounds = [0, *find_cuts(clip.frames), len(clip)]
    shots = [Shot(f"shot-{number:03d}", begin, end) for number, (begin, end) in enumerate(pairwise(bounds))]
    for shot in shots:
        if shot.end - shot.begin < 2:
            raise ClipError(
                f"{clip.name} has a shot of one frame, {shot.begin}, and motion needs at least two; "
                "leave that frame out, or take the clip as one shot with --shots ignore"
            )
    return shots


def check_no_files(config: DataConfig) -> None:
    """Raises `ConfigError` where flow, masks or tracks are the user's own, which go with the frames of the clip."""
    given = {
        "--flow": isinstance(config.flow, FolderFlowConfig),
        "--masks": config.masks not in ("auto", "none"),
        "--tracks": config.tracks is not None,
    }
    named = " and ".join(option for option, is_given in given.items() if is_given)
    if named:
        raise ConfigError(
            f"{named} with --shots split: files of the whole clip do not fit its shots; fit CLIP@A:B one by one, "
            "each with files of its own"
        )


def each_shot(clip: Clip, folder: Path, fit: Callable[[Clip, Path, float], Path]) -> list[Path]:
    """Calls `fit` with each shot's clip, run folder and share of the clip's frames; returns the run folders.

    Writes `shots.json` into `folder` first, which tells where each shot lies in the clip.
    """
    shots = shots_of(clip)
    with replacing(folder / FILE_NAME) as file:
        content = _Shots(clip=clip.name, num_frames=len(clip), shots=shots)
        file.write_text(content.model_dump_json(indent=1), encoding="utf-8")
    return [
        fit(clip.part(shot.begin, shot.end, shot.name), folder / shot.name, (shot.end - shot.begin) / len(clip))
        for shot in shots
    ]


def runs_of_shots(folder: Path) -> list[Path]:
    """The run folders of a clip that was split; empty where `folder` is not the folder of one.

    Raises `CheckpointError` where its `shots.json` is damaged.
    """
    file = folder / FILE_NAME
    if not file.is_file():
        return []
    try:
        content = _Shots.model_validate_json(file.read_bytes())
    except ValidationError as error:
        raise CheckpointError(f"{file} does not tell where the clip's shots are; train again") from error
    return [folder / shot.name for shot in content.shots]
