"""What every part of the configuration is made of."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Leaf(BaseModel):
    """A frozen part of the configuration that admits no unknown key, and no number that is not finite.

    A leaf stands in the room that reads it. The text below each field is its documentation; values live in
    `configs/*.yaml`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)
