"""Records summed up: values by clip, seeds averaged; means over clips; differences over the clips in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from harness.records import Record


@dataclass(frozen=True)
class Column:
    """One figure of a record."""

    title: str
    path: tuple[str, ...]
    """Keys from the record down, the query mode after the first left out."""
    scale: float = 100
    digits: int = 1

    def of(self, record: Record, query_mode: str) -> float | None:
        """The figure, scaled; None where the record does not have it or it is not defined."""
        value = record.get(self.path[0], {}).get(query_mode, {})
        for key in self.path[1:]:
            value = value.get(key) if isinstance(value, dict) else None
        return None if value is None or isinstance(value, dict) else self.scale * value

    def text(self, value: float | None, *, signed: bool = False) -> str:
        """The figure as a table shows it."""
        return "" if value is None else f"{value:{'+' if signed else ''}.{self.digits}f}"


DELTA = "average_pts_within_thresh"
AJ = Column("AJ", ("metrics", "average_jaccard"))
POSITION = Column("< delta_avg", ("metrics", DELTA))
OA = Column("OA", ("metrics", "occlusion_accuracy"))
TC = Column("TC px", ("metrics", "temporal_coherence"), scale=1, digits=2)
SPLITS = tuple(
    Column(f"< delta_avg {split}", ("splits", split, DELTA)) for split in ("static", "dynamic", "reappeared")
)
COLUMNS = (AJ, POSITION, OA, TC, *SPLITS)

ClipValues = Mapping[str, Mapping[Column, float | None]]
"""By clip and column, seeds averaged."""


def by_clip(records: Sequence[Record], query_mode: str) -> ClipValues:
    """The figures of each clip, clips in alphabetic order."""
    clips = sorted({record["clip"] for record in records})
    return {
        clip: {
            column: mean([column.of(record, query_mode) for record in records if record["clip"] == clip])
            for column in COLUMNS
        }
        for clip in clips
    }


def by_seed(records: Sequence[Record], column: Column, query_mode: str) -> dict[int, float | None]:
    """The column's mean over clips, seed by seed."""
    seeds = sorted({record.get("seed") or 0 for record in records})
    return {
        seed: mean([column.of(record, query_mode) for record in records if (record.get("seed") or 0) == seed])
        for seed in seeds
    }


def mean(values: Sequence[float | None]) -> float | None:
    """Over the values that are defined; None where none is."""
    defined = [value for value in values if value is not None]
    return fmean(defined) if defined else None


def means(values: ClipValues) -> dict[Column, float | None]:
    """Over clips, column by column."""
    return {column: mean([figures[column] for figures in values.values()]) for column in COLUMNS}


def differences(values: ClipValues, baseline: ClipValues) -> ClipValues:
    """`values` minus `baseline`, over the clips that both have."""
    found = {}
    for clip, figures in values.items():
        if clip in baseline:
            pairs = {column: (figures[column], baseline[clip][column]) for column in COLUMNS}
            found[clip] = {
                column: mine - its if mine is not None and its is not None else None
                for column, (mine, its) in pairs.items()
            }
    return found


def worst(values: ClipValues, column: Column) -> tuple[str, float] | None:
    """The clip of the least value."""
    defined = [(value, clip) for clip, figures in values.items() if (value := figures[column]) is not None]
    return (min(defined)[1], min(defined)[0]) if defined else None
