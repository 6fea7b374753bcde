"""The four figures by which trackers are compared, as every table here shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """One metric of a table."""

    title: str
    metric: str
    latex: str
    factor: float = 100
    decimals: int = 1

    def cell(self, metrics: Mapping[str, float]) -> str:
        """The metric as shown; a `-` where it is undefined."""
        return self.text(metrics[self.metric])

    def text(self, value: float) -> str:
        """A value of the metric as shown."""
        return "-" if math.isnan(value) else f"{value * self.factor:.{self.decimals}f}"


COLUMNS = (
    Column("AJ", "average_jaccard", r"AJ $\uparrow$"),
    Column("< delta_avg", "average_pts_within_thresh", r"$<\delta^x_{avg} \uparrow$"),
    Column("OA", "occlusion_accuracy", r"OA $\uparrow$"),
    Column("TC px", "temporal_coherence", r"TC $\downarrow$", factor=1, decimals=2),
)
"""As in the paper's table of point tracking."""
