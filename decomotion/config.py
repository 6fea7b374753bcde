"""The configuration: one typed tree from one YAML file. Unknown keys stop the load, by name.

The text below each field is its documentation. Values live in `configs/*.yaml`, not here.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from decomotion.errors import ConfigError

PRESETS = ("cpu", "omnimotion", "paper")
EXTENDS = "extends"
"""Key of a file that builds on a preset."""
ESTIMATORS = {"dis": "cpu", "raft-small": "paper", "raft-large": "paper"}
"""Flow estimators, and the preset whose file holds each one's settings."""


Cells = Annotated[int, Field(ge=1)]


class Leaf(BaseModel):
    """A frozen part of the configuration that admits no unknown key."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


class Schedule(Leaf):
    """A number that changes linearly over a part of the run."""

    value: float
    """Before `begin`."""
    to: float
    """After `end`."""
    begin: float = Field(ge=0, le=1)
    """Fraction of the run at which the change begins."""
    end: float = Field(ge=0, le=1)
    """Fraction of the run at which it is complete."""


class FlowConfig(Leaf):
    """Optical flow between frames: what every estimator has."""

    field_side: int = Field(ge=32)
    """Longer side in pixels that the kept fields may have at most."""
    intervals: Literal["geometric", "all"] | tuple[int, ...]
    """Frame gaps at which flow is computed directly, both ways; all longer ones are linked from these. `geometric`: 1,
    2, 4, … as many as the budget affords; `all`: every gap where it affords that; or a list, which is never cut short
    and has to hold 1."""
    longest_interval: int = Field(ge=1)
    """`geometric` stops here."""

    @field_validator("intervals")
    @classmethod
    def _steps_of_one(cls, intervals: str | tuple[int, ...]) -> str | tuple[int, ...]:
        if not isinstance(intervals, str) and (1 not in intervals or min(intervals) < 1):
            raise ValueError("gaps must be positive and one of them 1, to reach every frame")
        return intervals


class DisFlowConfig(FlowConfig):
    """OpenCV's DIS."""

    kind: Literal["dis"]
    upsample: float = Field(gt=0)
    """Factor by which frames are enlarged first: DIS loses small displacements at its native resolution."""
    max_side: int = Field(ge=32)
    """Longer side in pixels that the enlarged frames may have at most."""
    patch_stride: int = Field(ge=1)
    """Pixels between patches."""
    descent_iterations: int = Field(ge=1)
    """Gradient descent iterations per patch."""
    refinement_iterations: int = Field(ge=0)
    """Variational refinement iterations."""
    gradient_weight: float = Field(10.0, ge=0)
    """Weight of constant image gradients in the refinement, whose weight of constant brightness is 5 (OpenCV's: 10)."""
    guided: bool = True
    """Search a second time from matches or from the flow over shorter gaps, and keep what returns nearer."""


class RaftFlowConfig(FlowConfig):
    """RAFT (torchvision's)."""

    kind: Literal["raft-small", "raft-large"]
    upsample: float = Field(gt=0)
    """Factor by which frames are enlarged first."""
    max_side: int = Field(ge=128)
    """Longer side in pixels that the enlarged frames may have at most."""
    iterations: int = Field(ge=1)
    """Updates of the flow."""
    weights: str | None
    """File of weights, torchvision's or the original checkpoint; null: torchvision's default, by download."""


class FolderFlowConfig(FlowConfig):
    """The user's own fields."""

    kind: Literal["folder"]
    path: str
    """Folder of `<i>_<j>.npy` or `<i>_<j>.flo`: the field from frame i to frame j."""


class PoolConfig(Leaf):
    """The pool of correspondences that the fit draws from."""

    points_per_frame: int = Field(ge=16)
    """Points of each frame that are linked to all other frames."""
    disk_limit: int = Field(ge=1)
    """MiB that the pool may take on disk: a long clip gets fewer points a frame."""
    cycle_threshold: float = Field(gt=0)
    """Forward-backward error in pixels of a 256-pixel frame above which a hop counts as an occlusion."""
    max_gap: int = Field(ge=1)
    """Longest frame gap that is linked."""


class MatchingConfig(Leaf):
    """Matches by appearance, for what flow loses (`decomotion/data/matching.py`)."""

    intervals: tuple[int, ...]
    """Frame gaps that are matched; empty: none."""
    supporters: int = Field(ge=0, le=24)
    """Of the 24 cells around a match, how many have to move likewise for it to be trusted."""


class FilterConfig(Leaf):
    """Second thoughts about the links, as in OmniMotion (`decomotion/data/filtering.py`)."""

    cycle: float | None = Field(gt=0)
    """Links whose way there and back misses by more than this, in pixels of a 256-pixel frame, go; null: none."""
    appearance: float | None = Field(ge=-1, le=1)
    """Links to a place whose feature has a smaller cosine similarity are dropped; null: none."""
    appearance_gap: int = Field(ge=1)
    """The shortest frame gap at which `appearance` looks."""
    second_look: float | None = Field(gt=0, le=1)
    """Confidence given to links onto hidden places that a second cycle confirms; null: they stay unknown."""
    second_look_gap: int = Field(ge=1)
    """The longest frame gap of these."""


class DataConfig(Leaf):
    """What is prepared from the clip before the fit."""

    prepare_budget: float = Field(gt=0)
    """Seconds that preparation should take at most: decides at how many gaps flow is computed."""
    flow: DisFlowConfig | RaftFlowConfig | FolderFlowConfig = Field(discriminator="kind")
    pool: PoolConfig
    matching: MatchingConfig
    filters: FilterConfig
    tracks: str | None
    """File of tracks from any tracker (`docs/formats.md`), as further correspondences; null: none."""
    features: Literal["densesift", "aliked", "dino", "none"]
    """Dense features to render: kornia's dense SIFT, which needs no weights, its ALIKED, DINO (timm), or none."""
    feature_weights: str | None
    """File of weights for `aliked` or `dino`; null: their publishers', by download."""
    feature_size: int = Field(ge=0)
    """Features are reduced by PCA to this many channels; 0 keeps them all."""
    masks: str
    """`auto` (what the camera's motion does not explain), `rigid-first` (what a static volume does not), `none`, or a
    folder of mask images (white: moving)."""

    @model_validator(mode="after")
    def _consistent(self) -> DataConfig:
        if self.feature_weights is not None and self.features not in ("aliked", "dino"):
            raise ValueError(f"feature_weights go with features aliked or dino, not {self.features}")
        if self.filters.appearance is not None and self.features == "none":
            raise ValueError("filters.appearance compares features, but features are none")
        return self


class TimeCodeConfig(Leaf):
    """Frame codes from normalised time through a network."""

    kind: Literal["time"]
    size: int = Field(ge=1)
    """Length of a code."""
    hidden: int = Field(ge=1)
    """Channels of the two hidden layers."""
    frequencies: int = Field(ge=0)
    """Octaves of the positional encoding of time."""


class TableCodeConfig(Leaf):
    """Frame codes learned freely, one a frame."""

    kind: Literal["table"]
    size: int = Field(ge=1)
    """Length of a code."""
    frequencies: int = Field(ge=0)
    """Octaves of the smooth functions of time that the codes start as."""


class MlpConditionerConfig(Leaf):
    """Coupling layers conditioned by an MLP."""

    kind: Literal["mlp"]
    frequencies: int = Field(ge=0)
    """Octaves of the positional encoding of the two fixed coordinates."""
    encoding: int = Field(ge=1)
    """Channels into which that encoding is projected."""
    hidden: int = Field(ge=1)
    """Channels of the hidden layers."""
    layers: int = Field(ge=1)
    """Hidden layers."""


class GridConditionerConfig(Leaf):
    """Coupling layers conditioned by grids."""

    kind: Literal["grid"]
    cells: tuple[Cells, ...] = Field(min_length=1)
    """Cells along the image's longer side, level by level; the finest last."""
    rank: int = Field(ge=1)
    """Grids that are mixed into each frame's."""
    slope: float = Field(gt=0)
    """How much a level's log-scale or shift changes at most over a unit of length; approached smoothly."""


class GaborFieldConfig(Leaf):
    """A GaborNet."""

    kind: Literal["gabor"]
    width: int = Field(ge=1)
    """Channels."""
    layers: int = Field(ge=1)
    """Linear layers between filters."""
    input_scale: float = Field(gt=0)
    """Scale of the filters' frequencies."""
    alpha: float = Field(gt=0)
    """Shape of the Gamma distribution that the filters' inverse widths start from."""


class GridFieldConfig(Leaf):
    """Feature planes and a small MLP."""

    kind: Literal["grid"]
    width: int = Field(ge=1)
    """Channels of the MLP."""
    channels: int = Field(ge=1)
    """Channels of each plane."""
    image_cells: tuple[Cells, ...] = Field(min_length=1)
    """Cells of the x-y planes along the image's longer side, plane by plane."""
    depth_cells: int = Field(ge=2)
    """Cells of the x-z and y-z planes, likewise."""


class SurfaceConfig(Leaf):
    """The sheet of density that a volume starts with."""

    depth: float
    """Pseudo-depth of the sheet."""
    thickness: float = Field(gt=0)
    """Distance from its middle at which the prior on the raw density crosses 0."""
    peak: float
    """Raw density (before the softplus) in its middle."""


class VolumeConfig(Leaf):
    """One canonical volume and its transforms."""

    start: Literal["identity", "camera", "object"]
    """Affine maps that the fit starts with: none, the closed-form camera motion, or that of what moves."""
    affine_hidden: int = Field(ge=1)
    """Channels of the 2-layer MLP that corrects them."""
    couplings: int = Field(ge=0)
    """Number of invertible coupling layers after the affine map."""
    directions: tuple[tuple[float, float, float], ...] = Field(min_length=1)
    """The direction along which each coupling layer moves points, repeated as needed."""
    conditioner: MlpConditionerConfig | GridConditionerConfig = Field(discriminator="kind")
    field: GaborFieldConfig | GridFieldConfig = Field(discriminator="kind")
    surface: SurfaceConfig | None
    """The sheet to start with; null: none, as in the paper."""

    @field_validator("directions")
    @classmethod
    def _lead_somewhere(cls, directions: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        if not all(any(direction) for direction in directions):
            raise ValueError("a direction of zeros leads nowhere")
        return directions


class ModelConfig(Leaf):
    """The model: two volumes and their fusion, or one of them alone."""

    volumes: Literal["fused", "static", "dynamic"]
    """Both volumes, or one that explains everything, as in OmniMotion; losses of the other are then not computed."""
    samples: int = Field(ge=2)
    """Samples on a ray."""
    deferred: bool = False
    """Carry one point of each ray to the other frames, that at its samples' mean depth, instead of carrying every
    sample and averaging there (Eq. 2 and 5); features are looked up at it too."""
    normalise_weights: bool
    """Divide composited positions by the ray's total weight, so that they are unbiased where it is below 1."""
    frame_code: TimeCodeConfig | TableCodeConfig = Field(discriminator="kind")
    static: VolumeConfig
    dynamic: VolumeConfig
    feature_field: GaborFieldConfig | GridFieldConfig = Field(discriminator="kind")
    occlusion_scale: float = Field(gt=0)
    """Cycle error at which the occlusion score is 0.5, in pixels of a 256-pixel frame."""


class OptimConfig(Leaf):
    """The optimisation."""

    steps: int = Field(ge=1)
    """Optimisation steps where neither --steps nor --time-budget says otherwise."""
    pairs: int = Field(ge=1)
    """Frame pairs in a batch."""
    points: int = Field(ge=1)
    """Correspondences of each pair in a batch."""
    lr_field: float
    """Adam's learning rate of the fields."""
    lr_transform: float
    """Of the transforms."""
    lr_code: float
    """Of the frame codes."""
    warmup: float = Field(ge=0, le=1)
    """Fraction of the run over which the learning rates rise from zero."""
    decay: Literal["cosine", "step"]
    """How they fall: half a cosine to zero, or by `decay_factor` every `decay_every` of the run."""
    decay_every: float = Field(gt=0, le=1)
    decay_factor: float = Field(gt=0, le=1)
    gap: Schedule
    """Longest frame gap of a pair, as a fraction of the clip's length."""
    hard_mining: float = Field(ge=0, le=1)
    """Share of the correspondences that are drawn by their last known error."""
    smooth_share: float = Field(ge=0, le=1)
    """Share of the correspondences at which scene-flow smoothness is evaluated."""
    candidates: int = Field(ge=1)
    """Points drawn for each that a batch takes: those whose target is known are taken first."""
    moving_share: float = Field(ge=0, le=0.9)
    """Least share of the correspondences that is drawn from what moves; 0: as much as it covers."""
    count_maps: bool
    """Draw points that are linked to few frames more often (OmniMotion's count maps)."""
    micro_batch: int = Field(ge=0)
    """Pairs whose graph is held in memory at once (gradients are accumulated; the mathematics is the same); 0: all."""
    clip_norm: float = Field(gt=0)
    """Norm to which the whole model's gradient is cut where it is larger."""
    autocast: Literal["none", "bf16"]
    """Precision of the products of MLPs' hidden layers (`decomotion/model/precision.py`); all else is float32."""


class LogConfig(Leaf):
    """What a run records."""

    scalars_every: int = Field(ge=1)
    """Steps between TensorBoard scalars."""
    previews: int = Field(ge=0)
    """Preview pictures over a run."""
    checkpoint_seconds: float = Field(gt=0)
    """Time between checkpoints."""


class Config(Leaf):
    """Everything that decides a fit, apart from the clip, the seed and the budget."""

    preset: str
    """The name that the exported model carries."""
    data: DataConfig
    model: ModelConfig
    loss: dict[str, float | Schedule]
    """Weight of each loss by its name in `decomotion/losses`; 0 switches it off."""
    optim: OptimConfig
    log: LogConfig


def load(
    preset: str = "cpu",
    file: str | Path | None = None,
    overrides: tuple[str, ...] = (),
    flow: str | None = None,
) -> Config:
    """Reads a preset (or `file`, in the same form) and applies `overrides` of the form `a.b.c=value`.

    A file with the key `extends` names a preset and holds only what differs from it.

    `flow` exchanges the estimator first: `dis` with the settings of the `cpu` preset, `raft-small` or `raft-large`
    with those of `paper`, or a folder of fields.

    Raises `ConfigError` naming the key that is unknown, missing or of the wrong type.
    """
    tree, source = _read(preset, file)
    if flow is not None:
        _exchange_flow(tree, flow, source)
    for override in overrides:
        _apply(tree, override)
    return parse(tree, source)


def _read(preset: str, file: str | Path | None) -> tuple[dict[str, Any], str]:
    source = Path(file) if file is not None else files("decomotion") / "configs" / f"{preset}.yaml"
    if file is None and preset not in PRESETS:
        raise ConfigError(f"preset {preset!r} is unknown; choose one of {', '.join(PRESETS)}")
    if not source.is_file():
        raise ConfigError(f"config file {source} does not exist; copy one of decomotion/configs/ to start from")
    try:
        tree = yaml.safe_load(source.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"config file {source} is not YAML: {error}") from error
    if not isinstance(tree, dict):
        raise ConfigError(f"config file {source} does not hold a mapping of keys")
    if EXTENDS in tree:
        base, _ = _read(str(tree.pop(EXTENDS)), None)
        tree = _merged(base, tree)
    return tree, str(source)


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`base` with the values of `changes`, mapping by mapping; a mapping of another `kind` takes the place whole."""
    merged = dict(base)
    for key, value in changes.items():
        former = base.get(key)
        if (
            isinstance(value, dict)
            and isinstance(former, dict)
            and value.get("kind", former.get("kind")) == former.get("kind")
        ):
            value = _merged(former, value)
        merged[key] = value
    return merged


def _exchange_flow(tree: dict[str, Any], flow: str, source: str) -> None:
    former = tree.get("data", {}).get("flow") if isinstance(tree.get("data"), dict) else None
    if not isinstance(former, dict):
        raise ConfigError(f"{source}: data.flow: field required; see decomotion/config.py for the keys")
    if flow in (former.get("kind"), ""):
        return
    if flow in ESTIMATORS:
        preset, _ = _read(ESTIMATORS[flow], None)
        own = {**preset["data"]["flow"], "kind": flow}
    else:
        own = {"kind": "folder", "path": flow}
    common = {key: former[key] for key in FlowConfig.model_fields if key in former}
    tree["data"]["flow"] = {**own, **common}


def parse(tree: Any, source: str) -> Config:
    """The typed configuration of a plain mapping; `source` is what error messages call it."""
    try:
        return Config.model_validate(tree)
    except ValidationError as error:
        first = max(error.errors(), key=lambda each: len(each["loc"]))  # of a union, the form that was meant
        key = ".".join(_path_in(tree, first["loc"]))
        raise ConfigError(f"{source}: {key}: {first['msg'].lower()}; see decomotion/config.py for the keys") from error


def _path_in(tree: Any, location: tuple[int | str, ...]) -> list[str]:
    """The keys that lead to an error's place: pydantic's location without the kinds of the leaves on the way."""
    path: list[str] = []
    for part in location:
        if isinstance(tree, dict) and part not in tree and part == tree.get("kind"):
            continue
        path.append(str(part))
        tree = tree.get(part) if isinstance(tree, dict) else None
    return path


def _apply(tree: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    path = key.strip().split(".")
    if not equals or not all(path):
        raise ConfigError(f"--set {override} is not of the form key=value, for example optim.steps=500")
    branch: Any = tree
    for depth, part in enumerate(path[:-1], start=1):
        if not isinstance(branch, dict) or part not in branch:
            raise ConfigError(f"--set {override}: there is no key {'.'.join(path[:depth])}")
        branch = branch[part]
    if not isinstance(branch, dict) or path[-1] not in branch:
        raise ConfigError(f"--set {override}: there is no key {key.strip()}")
    try:
        branch[path[-1]] = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"--set {override}: the value is not YAML") from error
