"""Settings of the model: its volumes, their transforms and their fields."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from decomotion.leaf import Leaf

Cells = Annotated[int, Field(ge=1)]


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
    motion_mask: Literal["fused", "static"] = "fused"
    """What the segmentation loss looks at, B: the share of the fused weight that is static; or, as in the paper, the
    static volume's confidence rendered in that volume alone."""
    frame_code: TimeCodeConfig | TableCodeConfig = Field(discriminator="kind")
    static: VolumeConfig
    dynamic: VolumeConfig
    feature_field: GaborFieldConfig | GridFieldConfig = Field(discriminator="kind")
    occlusion_scale: float = Field(gt=0)
    """Cycle error at which the occlusion score is 0.5, in pixels of a 256-pixel frame."""
