"""What is known of each object in each frame, as a table: `report.csv`."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from decomo_runtime.propagation.carrying import Finding
from decomo_runtime.propagation.shapes import Thing

FILE = "report.csv"
HEAD = ("frame", "object", "name", "kind", "state", "confidence", "in_sight", "disagreement", "between")
DRAWN, CARRIED, GAP = "drawn", "carried", "gap"


@dataclass(frozen=True)
class Report:
    """What came of carrying an annotation."""

    things: tuple[Thing, ...]
    findings: tuple[Finding, ...]
    """Frame by frame."""

    @property
    def gaps(self) -> list[Finding]:
        """Where an object has no place."""
        return [finding for finding in self.findings if finding.gap]

    def worst(self, region: bool, most: int = 3) -> list[Finding]:
        """Where annotated frames disagree the most, of each pair and object the worst frame: of regions, or of points
        and boxes.
        """
        told = [each for each in self.findings if each.disagreement is not None and each.kind.is_region == region]
        told.sort(key=lambda each: -(each.disagreement or 0))
        firsts: dict[object, Finding] = {}
        for each in told:
            firsts.setdefault((each.thing, each.kind, each.between), each)
        return list(firsts.values())[:most]

    def write(self, path: Path) -> None:
        """As csv, a line for each finding."""
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(HEAD)
            writer.writerows(_row(each, self.things[each.thing]) for each in self.findings)


def _row(finding: Finding, thing: Thing) -> Sequence[object]:
    state = DRAWN if finding.drawn else GAP if finding.gap else CARRIED
    apart = "" if finding.disagreement is None else f"{finding.disagreement:.4f}"
    between = "" if finding.between is None else "-".join(map(str, finding.between))
    sure = (f"{finding.confidence:.4f}", f"{finding.in_sight:.4f}")
    return finding.frame, thing.id, thing.name, finding.kind, state, *sure, apart, between
