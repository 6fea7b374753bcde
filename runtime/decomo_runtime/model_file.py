"""Opens an exported .onnx file and checks that it keeps the contract (`contract.py`) before anything is asked of it."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from decomo_runtime import contract
from decomo_runtime.errors import ModelFileError, SessionError
from decomo_runtime.metadata import parsed, text
from decomo_runtime.origin import Origin, read_origin
from decomotion import quality
from decomotion.memory import give_back
from decomotion.quality import Quality

if TYPE_CHECKING:
    import onnxruntime

Providers = Sequence[str | tuple[str, dict[str, Any]]]
"""Execution providers in order of preference, as onnxruntime takes them: names, or (name, options)."""

_ERRORS_ONLY = 3
_WRITE_ONE = "write one with 'decomo-export'"


@dataclass(frozen=True)
class ModelFacts:
    """What the file says about itself and the clip that it was fitted to."""

    clip_name: str
    num_frames: int
    height: int
    """Pixels, of the clip's own resolution; so is `width`."""
    width: int
    fps: float
    """Frames a second, in the mean."""
    preset: str
    occlusion_threshold: float
    """A point is occluded where its occlusion score is above this."""
    object_share: float = 0.5
    """A point is one of an object where 1 - its static confidence is above this; the default is for older files."""
    bytes_per_ray: int = 16384
    """Working memory, roughly, of one query in one frame; the default is for files that do not say."""
    bytes_per_rendered_ray: int = 16384
    """Likewise, of one query's own ray."""
    times: tuple[float, ...] | None = None
    """Seconds of each frame, from 0; None where `fps` says them, and in older files."""
    pixel_aspect: float = 1.0
    """Width of a pixel over its height; 1 in files that do not say."""
    quality: Quality | None = None
    """How good the fit is; None in files that do not say."""
    origin: Origin = field(default_factory=Origin)
    """How the file came to be."""


def open_session(
    path: Path, providers: Providers | str | None = None, threads: int | None = None
) -> onnxruntime.InferenceSession:
    """An onnxruntime session on `path`, with its own settings; `ModelFileError` where the file does not open.

    `providers` defaults to the CPU, `threads` (within one operator) to onnxruntime's own choice. Positions are products
    too: CUDA multiplies in whole float32 unless its options say otherwise (`use_tf32`).
    """
    import onnxruntime
    from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors  # pyright: ignore[reportAttributeAccessIssue]

    _check_file(path)
    options = onnxruntime.SessionOptions()
    options.log_severity_level = _ERRORS_ONLY
    options.enable_mem_reuse = (
        False  # planning it is most of the time to open a file; arrays return to the arena anyway
    )
    if threads is not None:
        if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
            raise SessionError(f"threads must be a whole number of at least 1, got {threads!r}")
        options.intra_op_num_threads = threads
    if providers is None or isinstance(providers, str):
        providers = [providers or "CPUExecutionProvider"]
    providers = [_exact(provider) for provider in providers]
    _check_providers(providers, onnxruntime.get_available_providers())
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=providers)
    except (ort_errors.InvalidProtobuf, ort_errors.InvalidArgument, UnicodeDecodeError) as error:
        raise ModelFileError(
            f"{path} is not an ONNX file, or it is damaged or cut short; copy it again, or {_WRITE_ONE}"
        ) from error
    except (ort_errors.Fail, ort_errors.InvalidGraph, ort_errors.NotImplemented, ort_errors.RuntimeException) as error:
        raise ModelFileError(
            f"{path} does not run in onnxruntime {onnxruntime.__version__} ({_reason(error)}); upgrade with "
            f"'pip install -U onnxruntime', or export the model again"
        ) from error
    give_back()  # reading the graph takes twice what the session then keeps
    return session


def read_facts(session: onnxruntime.InferenceSession, path: Path) -> ModelFacts:
    """The session's metadata, checked: `ModelFileError` where the file is not ours, newer, or contradicts itself."""
    metadata = session.get_modelmeta().custom_metadata_map
    if contract.META_FORMAT_VERSION not in metadata:
        raise ModelFileError(f"{path} is an ONNX file but holds no decomotion model; {_WRITE_ONE}")
    version = parsed(metadata, contract.META_FORMAT_VERSION, path, int, lambda value: value >= 1)
    if version > contract.FORMAT_VERSION:
        raise ModelFileError(
            f"{path} has format version {version} but this decomotion reads up to {contract.FORMAT_VERSION}; "
            f"upgrade with 'pip install -U decomotion', or export the model again"
        )
    _check_names("input", contract.INPUTS, [port.name for port in session.get_inputs()], path)
    _check_names("output", contract.REQUIRED_OUTPUTS, [port.name for port in session.get_outputs()], path)
    bytes_per_ray = _bytes(metadata, contract.META_BYTES_PER_RAY, path, ModelFacts.bytes_per_ray)
    rendered = max(bytes_per_ray, ModelFacts.bytes_per_rendered_ray)
    num_frames = parsed(metadata, contract.META_NUM_FRAMES, path, int, _countable)
    return ModelFacts(
        clip_name=text(metadata, contract.META_CLIP_NAME, path),
        num_frames=num_frames,
        height=parsed(metadata, contract.META_HEIGHT, path, int, _countable),
        width=parsed(metadata, contract.META_WIDTH, path, int, _countable),
        fps=parsed(metadata, contract.META_FPS, path, float, lambda value: 0 < value < math.inf),
        preset=text(metadata, contract.META_PRESET, path),
        occlusion_threshold=parsed(
            metadata, contract.META_OCCLUSION_THRESHOLD, path, float, lambda value: 0 <= value <= 1
        ),
        object_share=parsed(
            {contract.META_OBJECT_SHARE: repr(ModelFacts.object_share), **metadata},
            contract.META_OBJECT_SHARE,
            path,
            float,
            lambda value: 0 <= value < 1,
        ),
        bytes_per_ray=bytes_per_ray,
        bytes_per_rendered_ray=_bytes(metadata, contract.META_BYTES_PER_RENDERED_RAY, path, rendered),
        times=_times(metadata, num_frames, path),
        pixel_aspect=parsed(
            {contract.META_PIXEL_ASPECT: repr(ModelFacts.pixel_aspect), **metadata},
            contract.META_PIXEL_ASPECT,
            path,
            float,
            lambda value: 0 < value < math.inf,
        ),
        quality=_quality(metadata, path),
        origin=read_origin(metadata, path),
    )


def _check_file(path: Path) -> None:
    if path.is_dir():
        raise ModelFileError(f"{path} is a folder; give the .onnx file inside it")
    if not path.exists():
        raise ModelFileError(f"{path} does not exist; {_WRITE_ONE}")
    try:
        path.open("rb").close()
    except OSError as error:
        raise ModelFileError(f"{path} cannot be read ({error.strerror}); check its permissions") from error
    if path.stat().st_size == 0:
        raise ModelFileError(f"{path} is empty; copy it again, or {_WRITE_ONE}")


def _exact(provider: str | tuple[str, dict[str, Any]]) -> str | tuple[str, dict[str, Any]]:
    """CUDA's TF32, its default, has ten bits: too few for a pixel or for a row of a table."""
    name, options = (provider, {}) if isinstance(provider, str) else provider
    return (name, {"use_tf32": "0", **options}) if name == "CUDAExecutionProvider" else provider


def _check_providers(providers: Providers, available: Sequence[str]) -> None:
    for provider in providers:
        name = provider if isinstance(provider, str) else provider[0]
        if name not in available:
            raise SessionError(
                f"this onnxruntime has no provider {name!r}; choose from {', '.join(available)}, "
                f"or install the onnxruntime build that brings it"
            )


def _check_names(kind: str, required: Sequence[str], present: Sequence[str], path: Path) -> None:
    missing = [name for name in required if name not in present]
    if missing:
        raise ModelFileError(f"{path} lacks the {kind} {', '.join(missing)}; export the model again")


def _times(metadata: Mapping[str, str], num_frames: int, path: Path) -> tuple[float, ...] | None:
    """None where the file does not say."""
    if contract.META_TIMES not in metadata:
        return None
    listed = metadata[contract.META_TIMES]
    try:
        times = np.array(json.loads(listed), np.float64)
    except (ValueError, TypeError, RecursionError):
        times = np.empty(0)
    if times.shape != (num_frames,) or times[0] != 0 or not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise ModelFileError(
            f"{path} has the impossible metadata {contract.META_TIMES} = {listed[:40]!r}: it must be a list of "
            f"{num_frames} rising seconds from 0; export the model again"
        )
    return tuple(times.tolist())


def _quality(metadata: Mapping[str, str], path: Path) -> Quality | None:
    """None where the file does not say."""
    if contract.META_QUALITY not in metadata:
        return None
    try:
        return quality.parse(metadata[contract.META_QUALITY])
    except ValueError as error:
        raise ModelFileError(
            f"{path} has the impossible metadata {contract.META_QUALITY} ({error}); export the model again"
        ) from error


def _countable(value: int) -> bool:
    """Queries are float32, which holds every whole number up to 2^24."""
    return 1 <= value <= 2**24


def _bytes(metadata: Mapping[str, str], key: str, path: Path, otherwise: int) -> int:
    """`otherwise` where the file does not say."""
    return parsed({key: str(otherwise), **metadata}, key, path, int, lambda value: value >= 1)


def _reason(error: Exception) -> str:
    """The last sentence of onnxruntime's message, without the source location that may come before it."""
    return re.split(r"\) |\. ", str(error).strip())[-1].strip(" ,.")
