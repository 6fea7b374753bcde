"""The report's plots, drawn by matplotlib: each function gives one as the text of an SVG file."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any

from decomo_eval.errors import EvalError
from decomo_eval.metrics import THRESHOLDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_BARS = 40
"""A benchmark of a thousand videos is a table; the plot shows its lower end."""
LONGEST_NAME = 24
"""Characters of a video's name."""
WIDTH, HEIGHT, ROW = 6.4, 3.2, 0.22
"""Inches; the last of one bar."""
STYLE: Any = {
    "svg.fonttype": "none",  # text remains text
    "svg.hashsalt": "decomotion",  # no chance in names
    "text.parse_math": False,  # names may have dollars
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.3,
    "font.size": 9,
}


def check_drawing() -> None:
    """Raises `EvalError` where what they need is not installed."""
    for library in ("jinja2", "matplotlib", "yaml"):
        try:
            import_module(library)
        except ModuleNotFoundError as error:
            raise EvalError(f"reports and plots need {library}; run: pip install 'decomotion[report]'") from error


def video_bars(values: Mapping[str, float], mean: float, title: str) -> str:
    """Horizontal bars of shares 0..1, least first, with a line at the mean; undefined values are left out."""
    defined = sorted((value, name) for name, value in values.items() if not math.isnan(value))[:MOST_BARS]
    with _drawn(title, 0.7 + ROW * len(defined)) as (axes, svg):
        bars = axes.barh(range(len(defined)), [100 * value for value, _ in defined], gid="bars")
        axes.bar_label(bars, fmt="%.1f", padding=3)
        axes.set_yticks(range(len(defined)), [_short(name) for _, name in defined])
        axes.invert_yaxis()
        axes.set(xlim=(0, 100), xlabel="%")
        axes.grid(visible=False, axis="y")
        if not math.isnan(mean):
            axes.axvline(100 * mean, color="C1", label=f"mean {100 * mean:.1f}")
            axes.figure.legend(loc="outside upper right")
    return svg.getvalue()


def threshold_curves(metrics: Mapping[str, float], title: str) -> str:
    """Share of points within each threshold and Jaccard at it, over the thresholds, which double from 1 to 16."""
    with _drawn(title) as (axes, svg):
        axes.set_xscale("log", base=2)
        axes.set_xticks(THRESHOLDS, [f"{threshold}" for threshold in THRESHOLDS])
        axes.set(xlabel="pixels at 256x256", ylabel="%", ylim=(0, 100))
        for kind, label in (("pts_within", "within"), ("jaccard", "Jaccard")):
            shares = [100 * metrics[f"{kind}_{threshold}"] for threshold in THRESHOLDS]
            if not all(map(math.isnan, shares)):
                axes.plot(THRESHOLDS, shares, marker="o", label=f"{label} {shares[-1]:.1f}", gid=kind)
        if axes.lines:
            axes.legend()
    return svg.getvalue()


def error_over_time(errors: Sequence[float], title: str) -> str:
    """Error in pixels at 256x256 over the frames between query and answer, `errors[0]` at none; nan is left out."""
    shown = [(gap, float(error)) for gap, error in enumerate(errors) if not math.isnan(error)]
    with _drawn(title) as (axes, svg):
        axes.set(xlabel="frames from the query", ylabel="pixels at 256x256")
        if shown:
            axes.plot(*zip(*shown, strict=True), label=f"in the end {shown[-1][1]:.2f} px", gid="error")
            axes.legend()
        axes.set_xlim(0, max(4, len(errors) - 1))
        axes.set_ylim(bottom=0)
    return svg.getvalue()


@contextmanager
def _drawn(title: str, height: float = HEIGHT) -> Iterator[tuple[Axes, io.StringIO]]:
    """Axes to draw on, and where the SVG is once that is done. Nothing of matplotlib's own settings stays changed."""
    import matplotlib
    from matplotlib.figure import Figure

    svg = io.StringIO()
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph ")  # in a name; who opens the file has a font with it
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        yield figure.subplots(), svg
        figure.savefig(svg, format="svg", metadata={"Title": title, "Date": None, "Creator": None})


def _short(name: str) -> str:
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"
