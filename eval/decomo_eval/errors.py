"""What scoring refuses, each with one sentence that says what to do."""

from __future__ import annotations

from decomotion.errors import InputError


class EvalError(InputError):
    """A score cannot be computed from what was given."""


class DatasetError(EvalError):
    """The dataset has no form that is read, or holds no such video."""


class UnsafePickleError(DatasetError):
    """The pickle names something other than numpy arrays and plain containers; nothing of it was executed."""


class PredictionError(EvalError):
    """Predictions are absent, or do not answer the dataset's queries."""
