"""Settings of flow: what every estimator has, and each one's own."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from decomotion.leaf import Leaf


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
    coarse_from: int = Field(8, ge=1)
    """Frames this far apart or farther are compared at half the size: they differ in looks more than in fine detail."""
    guided: bool = True
    """Search a second time from matches or from the flow over shorter gaps, and keep what returns nearer."""
    alone: bool = True
    """Search what moves by itself as well, without what is around it: what given masks hold, or those of `auto`."""


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


AnyFlowConfig = Annotated[DisFlowConfig | RaftFlowConfig | FolderFlowConfig, Field(discriminator="kind")]
"""One entry for each estimator, told apart by `kind`."""
ESTIMATORS = ("dis", "raft-small", "raft-large")
"""Kinds that can be asked for by name; what each has of its own is in `configs/flow/<kind>.yaml`."""
