"""Checkpoints: all that rebuilds a model, and all that continues its training, in one file without code."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from pydantic import PositiveFloat, PositiveInt, TypeAdapter

from decomotion import config as configuration
from decomotion.clip import Clip
from decomotion.config import Config
from decomotion.errors import CheckpointError, ConfigError
from decomotion.files import replacing
from decomotion.geometry import ImagePlane
from decomotion.model.fusion import DecoMotion
from decomotion.quality import Quality, parse
from decomotion.record import CHECKPOINT
from decomotion.source import code_version
from decomotion.times import is_steady

FORMAT_VERSION = 2
FILE_NAME = CHECKPOINT


@dataclass(frozen=True)
class ClipFacts:
    """What a model must know of the clip that it was fitted to."""

    name: str
    digest: str
    num_frames: PositiveInt
    height: PositiveInt
    width: PositiveInt
    fps: PositiveFloat
    """Frames a second, in the mean."""
    times: tuple[float, ...] | None = None
    """Seconds of each frame, from 0; None where `fps` says them, and in older files."""
    pixel_aspect: PositiveFloat = 1.0
    """Width of a pixel over its height."""

    @staticmethod
    def of(clip: Clip) -> ClipFacts:
        """The facts of `clip`."""
        times = None if is_steady(clip.times, clip.fps) else tuple(clip.times.tolist())
        return ClipFacts(
            clip.name, clip.digest(), len(clip), clip.height, clip.width, clip.fps, times, clip.pixel_aspect
        )


@dataclass(frozen=True)
class Checkpoint:
    """A loaded checkpoint."""

    config: Config
    clip: ClipFacts
    model: DecoMotion
    training: dict[str, Any]
    """State of the optimisation: see `decomotion.run`."""
    thinned: str | None = None
    """What of the links there was no time for, in a line; None: nothing, or the file does not say."""
    quality: Quality | None = None
    """How good the fit is; None where it was stopped, or the file does not say."""
    code: str | None = None
    """Version of the code that wrote it (`decomotion.source`); None where the file does not say."""


def save(
    path: Path,
    config: Config,
    clip: ClipFacts,
    model: DecoMotion,
    training: dict[str, Any],
    thinned: str | None = None,
    quality: Quality | None = None,
) -> None:
    """Writes a checkpoint; a kill at any moment leaves the former one whole."""
    content = {
        "format_version": FORMAT_VERSION,
        "config": config.model_dump(mode="json"),
        "clip": asdict(clip),
        "feature_size": model.feature_size,
        "model": model.state_dict(),
        "training": training,
        "thinned": thinned,
        "quality": None if quality is None else quality.as_json(),
        "code": code_version(),
    }
    write(path, content)


def write(path: Path, content: dict[str, Any]) -> None:
    """A `torch.save` file, whole or not at all; `OSError`, naming it, where the disk is full."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        torch.save(content, file)  # an open file: of a path, torch does not tell why it cannot be written


def load(path: Path, device: torch.device | str = "cpu") -> Checkpoint:
    """Reads a checkpoint and rebuilds its model.

    Raises `CheckpointError` where the file is missing, damaged or of another format.
    """
    if not path.is_file():
        raise CheckpointError(f"{path} does not exist; train first with decomo-train")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        version = int(content["format_version"])
        found = _rebuilt(content, str(path)) if version == FORMAT_VERSION else None
    except ConfigError as error:
        raise CheckpointError(f"the configuration in {error}; fit the clip again") from error
    except Exception as error:  # torch's reader and the model raise what damaged content brings them to
        raise CheckpointError(f"{path} is not a decomotion checkpoint, or is damaged; train again") from error
    if found is None:
        remedy = "upgrade it" if version > FORMAT_VERSION else "fit the clip again"
        raise CheckpointError(f"{path} has format {version} but this decomotion reads {FORMAT_VERSION}; {remedy}")
    found.model.to(device)
    return found


def _rebuilt(content: dict[str, Any], source: str) -> Checkpoint:
    config = configuration.parse(content["config"], source)
    clip = TypeAdapter(ClipFacts).validate_python(content["clip"])
    state, training = content["model"], dict(content["training"])
    identity = torch.eye(3, 4).expand(clip.num_frames, 3, 4)  # of a volume that is not there
    starts = (state.get("static.affine.start", identity), state.get("dynamic.affine.start", identity))
    if any(len(start) != clip.num_frames for start in starts):
        raise ValueError("model and clip are of different lengths")
    model = DecoMotion(config.model, ImagePlane(clip.height, clip.width), starts, content["feature_size"])
    model.load_state_dict(state)
    thinned, quality, code = (content.get(key) for key in ("thinned", "quality", "code"))
    if not all(each is None or isinstance(each, str) for each in (thinned, code)):
        raise ValueError("what is thinned, or the code's version, is no text")
    return Checkpoint(config, clip, model, training, thinned, None if quality is None else parse(quality), code)


def latest_run(root: Path = Path("runs")) -> Path:
    """The run whose checkpoint was written last; of a clip of several windows, the folder of all of them."""
    checkpoints = [*root.glob(f"*/{FILE_NAME}"), *root.glob(f"*/window-*/{FILE_NAME}")]
    if not checkpoints:
        raise CheckpointError(f"there is no run in {root.resolve()}; train first with decomo-train, or give --run")
    folder = max(checkpoints, key=lambda file: file.stat().st_mtime).parent
    return folder if folder.parent == root else folder.parent
