"""How good a fit is, as far as links that were held out of it can tell: what is kept of it, read and said.

Lengths are in units (`decomotion.units`: pixels of a frame whose longer side is 256) where they are not named pixels,
which are the clip's own. `decomotion.held_out` measures; `docs/quality.md` says what these figures can tell.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from typing import Any

FILE_NAME = "quality.json"
"""In the run's folder: `docs/formats-model.md`."""
FEW_STEPS = 300
"""A fit that took fewer is short of them."""
ENOUGH_STEPS = 3000
"""Steps that a starved fit is advised to take, where the time for them is not too far from what was given."""
WELL_ABOVE, SLACK = 3.0, 0.5
"""A median deviation is well above what links allow from so many times their own error, and so many units more."""
TELLING = 50
"""Fewer links than these say too little to complain about."""
MOST = 1e12
"""No figure is so large."""


@dataclass(frozen=True)
class Figures:
    """How far held-out links of one kind end from where the model leads."""

    links: int
    """How many were looked at, at least 1."""
    median: float
    """Deviation in units."""
    p90: float
    """Its 90th percentile."""
    median_pixels: float
    p90_pixels: float
    within_1: float
    """Share of the links, 0 to 1, that end less than 1 unit from it; the next two: 2 and 4."""
    within_2: float
    within_4: float
    own_error: float
    """Median error of the links themselves in units, by their way there and back, which sees about half of it: a
    perfect model would deviate from them at least so far."""


@dataclass(frozen=True)
class GapFigures:
    """Of links between frames that are `shortest` to `longest` apart."""

    shortest: int
    longest: int
    figures: Figures


@dataclass(frozen=True)
class Quality:
    """How good a fit is: see the module."""

    steps: int
    """That it took."""
    thinned: str | None
    """What of the links there was no time for, in a line; None: nothing."""
    all: Figures
    """Links between any two frames."""
    static: Figures | None
    """Those whose point the static volume owns; None where there are none."""
    dynamic: Figures | None
    """Those whose point the dynamic volume owns."""
    gaps: tuple[GapFigures, ...]
    """By frame gap, ascending; gaps without links are left out."""

    def rows(self) -> list[tuple[str, Figures]]:
        """All figures there are, each with the name of its kind of link."""
        found = [("all", self.all), ("static", self.static), ("dynamic", self.dynamic)]
        found += [(_named(each), each.figures) for each in self.gaps]
        return [(name, each) for name, each in found if each is not None]

    def warning(self) -> str | None:
        """What is wrong with the fit, a sentence to which what to do may be added; None: nothing that can be told."""
        few = self.steps < FEW_STEPS
        starved = [f"it took {self.steps} step{'s' if self.steps > 1 else ''}, which is few"] if few else []
        if self.thinned is not None:
            starved.append(f"its links are thinned ({self.thinned})")
        missed = [
            f"held-out links{'' if name == 'all' else f' ({name})'} are missed by {each.median:.2g} px of 256 in the "
            f"median where they are good to {each.own_error:.2g}, so that the flow it came from may be better"
            for name, each in self.rows()
            if each.links >= TELLING and each.median > WELL_ABOVE * each.own_error + SLACK
        ]
        if not starved and not missed:
            return None
        what = "the fit is starved" if starved else "the fit falls short of its links"
        return f"{what}: {', '.join(starved + missed[:1])}"

    def summary(self) -> str:
        """The figures of all links in a line."""
        each = self.all
        return (
            f"held-out links are missed by {each.median:.2f} px of 256 in the median ({each.median_pixels:.2f} px of "
            f"the clip), {each.p90:.2f} ({each.p90_pixels:.2f}) at the 90th percentile; {each.within_1:.0%} are met "
            f"within 1 px of 256, {each.within_2:.0%} within 2, {each.within_4:.0%} within 4"
        )

    def table(self) -> str:
        """All figures, a line for each kind of link under one of titles; lengths in units."""
        titles = ("links", "median", "90 %", "< 1 px", "< 2", "< 4", "own error")
        lines = [f"{'px of 256':14}" + "".join(f"{title:>10}" for title in titles)]
        for name, each in self.rows():
            shares = "".join(f"{share:10.0%}" for share in (each.within_1, each.within_2, each.within_4))
            lines.append(f"{name:14}{each.links:10d}{each.median:10.2f}{each.p90:10.2f}{shares}{each.own_error:10.2f}")
        return "\n".join(lines)

    def as_json(self) -> str:
        """What `parse` reads."""
        return json.dumps(asdict(self))


def worst(qualities: Iterable[Quality | None]) -> Quality | None:
    """Of several windows', that which misses its held-out links the most in the median; None where none tells."""
    return max((each for each in qualities if each is not None), key=lambda each: each.all.median, default=None)


def parse(text: str) -> Quality:
    """Reads what `Quality.as_json` wrote; keys that it does not know are left out.

    Raises `ValueError` where something is missing or impossible, which it names.
    """
    try:
        content = json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    thinned = _entry(content, "thinned")
    if not (thinned is None or isinstance(thinned, str)):
        raise ValueError(f"thinned = {thinned!r}")
    gaps = _entry(content, "gaps")
    if not isinstance(gaps, list):
        raise ValueError(f"gaps = {gaps!r}")
    return Quality(
        steps=_count(content, "steps"),
        thinned=thinned,
        all=_figures(_entry(content, "all")),
        static=None if _entry(content, "static") is None else _figures(content["static"]),
        dynamic=None if _entry(content, "dynamic") is None else _figures(content["dynamic"]),
        gaps=_ascending(
            tuple(
                GapFigures(_count(each, "shortest"), _count(each, "longest"), _figures(_entry(each, "figures")))
                for each in gaps
            )
        ),
    )


def _figures(content: Any) -> Figures:
    read = {each.name: _number(content, each.name) for each in fields(Figures) if each.name != "links"}
    found = Figures(links=_count(content, "links"), **read)
    if found.median > found.p90 or found.median_pixels > found.p90_pixels:
        raise ValueError("a median above its 90th percentile")
    if not found.within_1 <= found.within_2 <= found.within_4 <= 1:
        raise ValueError("shares that are none")
    return found


def _ascending(gaps: tuple[GapFigures, ...]) -> tuple[GapFigures, ...]:
    ends = [end for each in gaps for end in (each.shortest, each.longest + 0.5)]
    if ends != sorted(ends):
        raise ValueError("gaps that overlap")
    return gaps


def _count(content: Any, name: str) -> int:
    return int(_checked(content, name, lambda value: isinstance(value, int) and 1 <= value < MOST))


def _number(content: Any, name: str) -> float:
    return float(_checked(content, name, lambda value: isinstance(value, int | float) and 0 <= value < MOST))


def _checked(content: Any, name: str, possible: Callable[[Any], bool]) -> Any:
    value = _entry(content, name)
    if isinstance(value, bool) or not possible(value):
        raise ValueError(f"{name} = {value!r}")
    return value


def _entry(content: Any, name: str) -> Any:
    if not isinstance(content, dict) or name not in content:
        raise ValueError(f"no {name}")
    return content[name]


def _named(each: GapFigures) -> str:
    """`gap 1`, `gap 2 to 4`."""
    return f"gap {each.shortest}" + (f" to {each.longest}" if each.longest > each.shortest else "")
