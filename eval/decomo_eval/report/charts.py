"""Plots as SVG text: no library, no script. `STYLE` goes into a page's style sheet; `standalone` makes a file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from html import escape

from decomo_eval.metrics import THRESHOLDS

ROW, LABEL, BAR = 18, 170, 420
"""Pixels: height of a bar's row, width of the labels, length of a bar of 100 %."""
MOST_BARS = 40
"""A benchmark of a thousand videos is a table; the plot shows its lower end."""

STYLE = """
  svg text { font: 12px system-ui, sans-serif; fill: currentColor; }
  .bar { fill: var(--one); } .mean { stroke: var(--two); stroke-width: 1.5; } .grid { stroke: var(--rule); }
  polyline { fill: none; stroke-width: 2; }
  polyline.pts_within { stroke: var(--one); } polyline.jaccard { stroke: var(--two); }
  circle.pts_within { fill: var(--one); } circle.jaccard { fill: var(--two); }
"""
"""CSS of all plots; the page chooses the colours `--one`, `--two` and `--rule`."""
COLOURS = {"--one": "#2b6cb0", "--two": "#c05621", "--rule": "#d7dce1"}
"""Where there is no page."""

_LEFT, _TOP, _WIDTH, _HEIGHT = 44, 12, 380, 200


def video_bars(values: Mapping[str, float], mean: float, title: str) -> str:
    """Horizontal bars of shares 0..1, least first, with a line at the mean; undefined values are left out."""
    defined = sorted((value, name) for name, value in values.items() if not math.isnan(value))[:MOST_BARS]
    height = ROW * len(defined) + 24
    parts = [_open(LABEL + BAR + 60, height, title)]
    for row, (value, name) in enumerate(defined):
        y = ROW * row + 4
        parts.append(f'<text x="{LABEL - 8}" y="{y + 10}" text-anchor="end">{escape(_short(name))}</text>')
        parts.append(f'<rect class="bar" x="{LABEL}" y="{y}" width="{value * BAR:.1f}" height="{ROW - 6}"/>')
        parts.append(f'<text x="{LABEL + value * BAR + 5:.1f}" y="{y + 10}">{100 * value:.1f}</text>')
    if not math.isnan(mean):
        x = LABEL + mean * BAR
        parts.append(f'<line class="mean" x1="{x:.1f}" y1="0" x2="{x:.1f}" y2="{height - 18}"/>')
        parts.append(f'<text x="{x:.1f}" y="{height - 5}" text-anchor="middle">mean {100 * mean:.1f}</text>')
    return "".join([*parts, "</svg>"])


def threshold_curves(metrics: Mapping[str, float], title: str) -> str:
    """Share of points within each threshold and Jaccard at it, over the thresholds, which double from 1 to 16."""
    parts = [_open(_LEFT + _WIDTH + 130, _TOP + _HEIGHT + 40, title)]
    for percent in range(0, 101, 25):
        y = _y(percent / 100)
        parts.append(f'<line class="grid" x1="{_LEFT}" y1="{y:.1f}" x2="{_LEFT + _WIDTH}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{percent}</text>')
    for position, threshold in enumerate(THRESHOLDS):
        parts.append(f'<text x="{_x(position):.1f}" y="{_TOP + _HEIGHT + 16}" text-anchor="middle">{threshold}</text>')
    middle = _LEFT + _WIDTH / 2
    parts.append(f'<text x="{middle}" y="{_TOP + _HEIGHT + 34}" text-anchor="middle">pixels at 256x256</text>')
    for kind, label in (("pts_within", "within"), ("jaccard", "Jaccard")):
        parts.extend(_curve([metrics[f"{kind}_{threshold}"] for threshold in THRESHOLDS], kind, label))
    return "".join([*parts, "</svg>"])


def error_over_time(errors: Sequence[float], title: str) -> str:
    """Error in pixels at 256x256 over the frames between query and answer, `errors[0]` at none; nan is left out."""
    shown = [(gap, float(error)) for gap, error in enumerate(errors) if not math.isnan(error)]
    most = _round_up(max((error for _, error in shown), default=1.0))
    longest = _round_up(max(4, len(errors) - 1))
    parts = [_open(_LEFT + _WIDTH + 130, _TOP + _HEIGHT + 40, title)]
    for quarter in range(5):
        y, x = _y(quarter / 4), _LEFT + _WIDTH * quarter / 4
        parts.append(f'<line class="grid" x1="{_LEFT}" y1="{y:.1f}" x2="{_LEFT + _WIDTH}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{most * quarter / 4:g}</text>')
        parts.append(
            f'<text x="{x:.1f}" y="{_TOP + _HEIGHT + 16}" text-anchor="middle">{longest * quarter / 4:g}</text>'
        )
    middle = _LEFT + _WIDTH / 2
    parts.append(f'<text x="{middle}" y="{_TOP + _HEIGHT + 34}" text-anchor="middle">frames from the query</text>')
    places = [(_LEFT + _WIDTH * gap / longest, _y(error / most)) for gap, error in shown]
    if places:
        parts.extend(_line(places, "pts_within", f"{shown[-1][1]:.2f} px"))
    return "".join([*parts, "</svg>"])


def standalone(svg: str) -> str:
    """A plot as a file of its own, on white."""
    style = re.sub(r"var\((--\w+)\)", lambda name: COLOURS[name[1]], STYLE)
    head, body = svg.split(">", 1)
    ground = '<rect width="100%" height="100%" fill="#fff"/>'
    return f'{head} xmlns="http://www.w3.org/2000/svg" color="#1b1f24"><style>{style}</style>{ground}{body}\n'


def _curve(shares: Sequence[float], kind: str, label: str) -> list[str]:
    places = [(_x(position), _y(share)) for position, share in enumerate(shares) if not math.isnan(share)]
    if not places:
        return []
    marks = [f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="3"/>' for x, y in places]
    return [*_line(places, kind, f"{label} {100 * shares[-1]:.1f}"), *marks]


def _line(places: Sequence[tuple[float, float]], kind: str, label: str) -> list[str]:
    """A line, with its label at the end."""
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    x, y = places[-1]
    return [
        f'<polyline class="{kind}" points="{line}"/>',
        f'<text x="{x + 8:.1f}" y="{y + 4:.1f}">{label}</text>',
    ]


def _round_up(value: float) -> float:
    """The next of 1, 2, 4, 8, 10, 20, ... (times a power of ten): four equal parts of it are legible."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-3)))
    return next(step * power for step in (1, 2, 4, 8, 10) if step * power >= value * (1 - 1e-9))


def _x(position: int) -> float:
    return _LEFT + _WIDTH * position / (len(THRESHOLDS) - 1)


def _y(share: float) -> float:
    return _TOP + _HEIGHT * (1 - share)


def _open(width: int, height: int, title: str) -> str:
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    return f'<svg role="img" {size}><title>{escape(title)}</title>'


def _short(name: str) -> str:
    return name if len(name) <= 24 else f"{name[:23]}…"
