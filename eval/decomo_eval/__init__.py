"""Scoring of point tracks against ground truth, TAP-Vid's and other datasets': numpy, OpenCV and click, no torch.

    report = decomo_eval.evaluate("tapvid_davis.pkl", models="models/", query_mode="strided")
    report.mean["average_jaccard"]

Nothing is loaded before a name is used, so that `decomo-eval --help` is instant.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from decomo_eval.baselines import FlowBaseline
    from decomo_eval.dataset import read_dataset
    from decomo_eval.metrics import tapvid_metrics, temporal_coherence
    from decomo_eval.predictions import Prediction
    from decomo_eval.redetection import redetection
    from decomo_eval.scoring import Report, evaluate
    from decomo_eval.tapvid import sample_queries

__all__ = [
    "FlowBaseline",
    "Prediction",
    "Report",
    "evaluate",
    "read_dataset",
    "redetection",
    "sample_queries",
    "tapvid_metrics",
    "temporal_coherence",
]

_HOMES = {
    "FlowBaseline": "decomo_eval.baselines",
    "Prediction": "decomo_eval.predictions",
    "Report": "decomo_eval.scoring",
    "evaluate": "decomo_eval.scoring",
    "read_dataset": "decomo_eval.dataset",
    "redetection": "decomo_eval.redetection",
    "sample_queries": "decomo_eval.tapvid",
    "tapvid_metrics": "decomo_eval.metrics",
    "temporal_coherence": "decomo_eval.metrics",
}


def __getattr__(name: str) -> object:
    """Loads a public name's module at its first use (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
