"""From a run to one .onnx file that keeps the runtime's contract."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import onnx

from decomo_export.baking import Bake
from decomo_export.errors import ExportError
from decomo_export.graph import QueryGraph
from decomo_export.lazy import compute_on_demand
from decomo_export.parity import Parity, measure
from decomo_export.precision import LIMIT_PIXELS, Deviation, Precision, deviation, reduce_precision
from decomo_export.tracing import trace
from decomo_runtime import contract
from decomotion import checkpoint, windows
from decomotion.checkpoint import Checkpoint, ClipFacts
from decomotion.files import replacing
from decomotion.model.readout import OBJECT_SHARE
from decomotion.quality import Quality
from decomotion.source import code_version

OCCLUSION_THRESHOLD = 0.5
"""The score is built so that 0.5 is the decision: see `ModelConfig.occlusion_scale`."""


DEFAULT_BAKE: Bake = "depth"


SUFFIX = ".onnx"
LONGEST_LICENCE = 200


@dataclass(frozen=True)
class Exported:
    """A written model file."""

    path: Path
    bytes: int
    parity: Parity
    deviation: Deviation
    """From the same graph in float32."""
    thinned: str | None
    """What of the links there was no time for, in a line; None: nothing."""
    quality: Quality | None
    """How good the fit is; None where it was stopped before its end."""


def export(
    path: str | Path,
    run: str | Path | None = None,
    *,
    bake: Bake = DEFAULT_BAKE,
    precision: Precision = "fp32",
    licence: str | None = None,
    force: bool = False,
) -> Exported:
    """Exports the model of a run and compares the file with torch.

    Args:
        path: the .onnx file to write.
        run: the run's folder; default: the most recent one in `runs/`.
        bake: what of each frame's visible surface is rendered now and kept as a table: nothing, its pseudo-depth, or
            its canonical coordinates (`baking.py`).
        precision: of the weights in the file (`precision.py`).
        licence: of the clip, in a line, which the file is to tell.
        force: write the file even where its tracks deviate from float32 by more than `precision.LIMIT_PIXELS`, or
            from torch by more than `parity.LIMIT_PIXELS`.

    Raises:
        CheckpointError: there is no run.
        ExportError: `path` is not named `.onnx`, `licence` is no line of text, the run is of several windows or was
            stopped before its first step, or the file disagrees with torch, or with float32 by more than is allowed;
            then nothing is written.
    """
    if Path(path).suffix.lower() != SUFFIX:
        raise ExportError(f"{path} must end in {SUFFIX}")
    if licence is not None and not is_licence(licence):
        raise ExportError(f"the licence must be one line of 1 to {LONGEST_LICENCE} characters, got {licence[:40]!r}")
    folder = Path(run) if run is not None else checkpoint.latest_run()
    if (folder / windows.FILE_NAME).is_file():
        raise ExportError(f"{folder} is of several windows; export one of {folder / 'window-000'} and so on")
    loaded = checkpoint.load(folder / checkpoint.FILE_NAME)
    if loaded.training["step"] == 0:
        raise ExportError(
            f"{folder} was stopped before its first step; go on with decomo-train --resume --out {folder}, then export"
        )
    graph = QueryGraph(loaded.model.eval(), bake).eval()
    whole = trace(graph)
    parity = measure(graph, _on_demand(whole), force)
    proto = reduce_precision(whole, precision)
    differs = Deviation(0.0, 0.0)
    if precision != "fp32":
        clip = loaded.clip
        differs = deviation(proto, whole, clip.num_frames, clip.width, clip.height, graph.bytes_per_ray)
    if not differs.p99 <= LIMIT_PIXELS and not force:
        raise ExportError(
            f"with {precision} weights, tracks differ from float32's by {differs.mean:.2g} px in the mean and "
            f"{differs.p99:.2g} px at the 99th percentile (limit {LIMIT_PIXELS}); nothing was written; export with "
            "another --precision, or with --force"
        )
    proto = _on_demand(proto)
    _name_axes(proto)
    proto.ir_version = contract.IR_VERSION
    onnx.helper.set_model_props(proto, _metadata(loaded, graph, precision, differs, licence))
    onnx.checker.check_model(proto, full_check=True)
    with replacing(path) as temporary:
        onnx.save(proto, temporary)
    return Exported(Path(path), Path(path).stat().st_size, parity, differs, loaded.thinned, loaded.quality)


def is_licence(text: str) -> bool:
    """Whether it can be the licence of a clip: one line that is not empty."""
    return text.isprintable() and 0 < len(text.strip()) <= LONGEST_LICENCE


def _on_demand(whole: onnx.ModelProto) -> onnx.ModelProto:
    """A copy that computes what is asked for and no more."""
    proto = onnx.ModelProto()
    proto.CopyFrom(whole)
    compute_on_demand(proto)
    return proto


def _name_axes(proto: onnx.ModelProto) -> None:
    """The dynamic axes by the names of the contract: N queries, M frames."""
    axes = {value.name: value.type.tensor_type.shape.dim for value in (*proto.graph.input, *proto.graph.output)}
    for name, dims in axes.items():
        dims[0].dim_param = "M" if name == contract.FRAMES else "N"
        if name in (contract.TRACKS, contract.OCCLUSION):
            dims[1].dim_param = "M"


def _metadata(
    loaded: Checkpoint, graph: QueryGraph, precision: Precision, differs: Deviation, licence: str | None
) -> dict[str, str]:
    clip = loaded.clip
    return {
        contract.META_FORMAT_VERSION: str(contract.FORMAT_VERSION),
        contract.META_CLIP_NAME: clip.name,
        contract.META_NUM_FRAMES: str(clip.num_frames),
        contract.META_HEIGHT: str(clip.height),
        contract.META_WIDTH: str(clip.width),
        contract.META_FPS: repr(clip.fps),
        contract.META_PRESET: loaded.config.preset,
        contract.META_OCCLUSION_THRESHOLD: repr(OCCLUSION_THRESHOLD),
        contract.META_OBJECT_SHARE: repr(OBJECT_SHARE),
        contract.META_WRITER_VERSION: code_version(),
        contract.META_STEPS: str(loaded.training["step"]),
        contract.META_BUDGET: json.dumps(loaded.training["budget"]),
        contract.META_BAKE: graph.bake,
        contract.META_PRECISION: precision,
        contract.META_DEVIATION: f"{differs.mean:.4g} {differs.p99:.4g}",
        contract.META_BYTES_PER_RAY: str(graph.bytes_per_ray),
        contract.META_BYTES_PER_RENDERED_RAY: str(graph.bytes_per_rendered_ray),
        **unusual_metadata(clip),
        **({} if loaded.code is None else {contract.META_FITTED_BY: loaded.code}),
        **({} if licence is None else {contract.META_LICENCE: licence}),
        **({} if loaded.quality is None else {contract.META_QUALITY: loaded.quality.as_json()}),
    }


def unusual_metadata(clip: ClipFacts) -> dict[str, str]:
    """What most clips do without: times of frames at a variable rate, and pixels that are not square."""
    unusual = {}
    if clip.times is not None:
        unusual[contract.META_TIMES] = json.dumps([round(time, 6) for time in clip.times])
    if clip.pixel_aspect != 1:
        unusual[contract.META_PIXEL_ASPECT] = repr(clip.pixel_aspect)
    return unusual
