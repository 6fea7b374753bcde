"""The drawings of docs/how-it-works.md: volumes, links, occlusion and windows.

python benchmarks/diagrams.py docs/images
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch, Polygon, Rectangle

INK, SOFT = "#222831", "#8a94a3"
SCENE, OBJECT, POINT = "#3f7d58", "#d9822b", "#c0392b"


def volumes(axes: Axes) -> None:
    """One pixel's way: its ray, the volume that owns it, canonical space, the other frame."""
    frame(axes, 0, 0.9, "frame 0")
    frame(axes, 9.3, 0.9, "frame 30", shift=0.75)
    box(axes, 4.4, 2.55, OBJECT, "objects", "a chain of coupling layers, its own in each frame")
    box(axes, 4.4, -0.45, SCENE, "static scene", "an affine camera and a few coupling layers")
    axes.plot([1.0, 3.3], [1.8, 2.35], color=SOFT, lw=1.2, zorder=2)
    axes.text(2.95, 1.75, "its ray", color=SOFT, ha="center", fontsize=9)
    for depth in np.linspace(0.2, 1, 6):
        mark(axes, 1.0 + 2.3 * depth, 1.8 + 0.55 * depth, SOFT, size=4)
    dot(axes, 1.0, 1.8)
    arrow(axes, (3.3, 2.4), (5.05, 3.4), OBJECT)
    arrow(axes, (3.3, 2.25), (5.0, 0.6), SCENE, faint=True)
    dot(axes, 5.2, 3.5)
    arrow(axes, (5.4, 3.47), (10.6, 1.95), OBJECT)
    dot(axes, 10.8, 1.8)
    axes.text(3.3, 3.2, "to canonical space", ha="center", fontsize=9.5, color=OBJECT)
    axes.text(9.55, 3.6, "and out of it, by the map of frame 30", ha="center", fontsize=9.5, color=OBJECT)
    axes.text(1.25, 0.55, "the pixel asked for", ha="center", fontsize=9, color=POINT)
    axes.text(10.55, 0.55, "where it is there", ha="center", fontsize=9, color=POINT)
    axes.set(xlim=(-0.2, 12.0), ylim=(-1.05, 4.65))


def links(axes: Axes) -> None:
    """Hops over several gaps, the best chain of them, and a match across where the point is hidden."""
    hidden = range(7, 12)
    for t in range(17):
        color = SOFT if t in hidden else INK
        mark(axes, t, 0, color, size=9, filled=t not in hidden)
        axes.text(t, -0.72, str(t), ha="center", fontsize=9, color=color)
    for gap, color in ((1, "#b9c2cf"), (2, "#9fb3d1"), (4, "#7d9bc9")):
        for t in range(0, 7 - gap, gap):
            arc(axes, t, t + gap, color, 0.9)
    for t in range(12, 16):
        arc(axes, t, t + 1, "#b9c2cf", 0.9)
    arc(axes, 12, 16, "#7d9bc9", 0.9)
    for begin, end in ((0, 4), (4, 6)):
        arc(axes, begin, end, SCENE, 2.6)
    arc(axes, 12, 16, SCENE, 2.6)
    arc(axes, 6, 12, OBJECT, 2.6, dashed=True)
    axes.axvspan(6.55, 11.45, color="#f1f3f6", zorder=0)
    axes.text(9, -1.4, "hidden: flow ends here", ha="center", fontsize=10, color=SOFT)
    axes.text(
        2.6, 2.0, "flow at gaps 1, 2, 4 and 8:\nthe best hops make the link", ha="center", fontsize=10, color=SCENE
    )
    axes.text(9, 2.0, "a match by its looks\nfinds the point again", ha="center", fontsize=10, color=OBJECT)
    axes.text(14, 2.0, "and flow goes on", ha="center", fontsize=10, color=SCENE)
    axes.text(-0.9, 0, "frame", ha="right", va="center", fontsize=10)
    axes.set(xlim=(-2.4, 16.8), ylim=(-1.8, 2.95))


def occlusion(axes: Axes) -> None:
    """There and back: a point that is seen comes home, one that is hidden does not."""
    for left, title, seen in ((0, "in sight", True), (8.2, "hidden", False)):
        frame(axes, left, 0, "frame 0", plain=True)
        frame(axes, left + 4.1, 0, "frame 30", plain=True)
        home, there = (left + 1.0, 1.0), (left + 5.1, 1.15)
        if not seen:
            axes.add_patch(Rectangle((left + 4.75, 0.35), 0.8, 1.35, color=SCENE, alpha=0.85, zorder=2))
            axes.text(left + 5.3, 0.1, "in front of it", ha="center", fontsize=8.5, color=SCENE)
        curve(axes, home, there, POINT, 0.28)
        back = (home[0] + 0.16, home[1] - 0.12) if seen else (left + 1.95, 0.5)
        curve(axes, there, back, SOFT, 0.28)
        dot(axes, *home)
        dot(axes, *there)
        mark(axes, *back, INK, size=7, filled=False)
        if not seen:
            axes.plot([home[0], back[0]], [home[1], back[1]], color=INK, lw=1, ls=":", zorder=5)
            axes.text(left + 1.32, 0.48, "e", fontsize=11, style="italic")
        words = "comes back to itself: e is small" if seen else "comes back elsewhere: e is large"
        axes.text(left + 3.3, -0.55, words, ha="center", fontsize=10)
        axes.text(left + 3.3, 2.6, title, ha="center", fontsize=12, weight="bold")
    axes.text(
        7.4, -1.15, "score = e / (e + 4), e in units; above 0.5 the point counts as hidden", ha="center", fontsize=10
    )
    axes.set(xlim=(-0.3, 15.1), ylim=(-1.4, 3.0))


def windows(axes: Axes) -> None:
    """A long clip: windows that share frames, a point that crosses, a cut that nothing crosses."""
    spans = ((0, 104, 2), (92, 196, 1), (196, 300, 2))
    for number, (begin, end, row) in enumerate(spans):
        color = ("#7d9bc9", "#9fb3d1", "#c9b79f")[number]
        axes.add_patch(Rectangle((begin, row), end - begin, 0.65, facecolor=color, edgecolor="white", zorder=2))
        axes.text((begin + end) / 2 - 4, row + 0.44, f"window-{number:03d}", ha="center", va="center", fontsize=10)
    axes.axvspan(92, 104, color="#f1f3f6", zorder=0)
    axes.text(98, 3.0, "12 shared frames", ha="center", fontsize=10, color=SOFT)
    axes.plot([196, 196], [0.55, 3.1], color=POINT, lw=1.5, ls="--")
    axes.text(196, 3.2, "a cut: no point crosses", ha="center", fontsize=10, color=POINT)
    axes.plot([40, 97, 97, 170], [2.16, 2.16, 1.16, 1.16], color=INK, lw=2, zorder=3)
    for x, y in ((40, 2.16), (170, 1.16)):
        mark(axes, x, y, POINT, size=8)
    for y in (2.16, 1.16):
        mark(axes, 97, y, INK, size=7, filled=False)
    axes.text(40, 2.72, "asked here", ha="center", fontsize=9, color=POINT)
    axes.text(170, 0.68, "answered here", ha="center", fontsize=9, color=POINT)
    axes.text(60, 1.12, "crosses where it is\nbest in sight", ha="center", fontsize=9.5, color=INK)
    for t in range(0, 301, 50):
        axes.plot([t, t], [0.2, 0.3], color=SOFT, lw=1)
        axes.text(t, -0.12, str(t), ha="center", fontsize=9, color=SOFT)
    axes.plot([0, 300], [0.3, 0.3], color=SOFT, lw=1)
    axes.text(-6, 0.3, "frame", ha="right", va="center", fontsize=10)
    axes.set(xlim=(-26, 306), ylim=(-0.35, 3.55))


DRAWINGS: dict[str, tuple[Callable[[Axes], None], tuple[float, float]]] = {
    "volumes": (volumes, (8.2, 4.0)),
    "links": (links, (8.2, 2.5)),
    "occlusion": (occlusion, (8.2, 2.7)),
    "windows": (windows, (8.2, 2.5)),
}


def frame(axes: Axes, x: float, y: float, name: str, *, shift: float = 0.0, plain: bool = False) -> None:
    """A picture with a house of the scene and a ball that moves."""
    axes.add_patch(Rectangle((x, y), 2.5, 1.9, facecolor="#f6f8fa", edgecolor=INK, lw=1.4, zorder=1))
    axes.text(x + 1.25, y + 2.02, name, ha="center", fontsize=10)
    if not plain:
        left = x + 1.75 - shift * 0.6
        axes.add_patch(
            Polygon([(left - 0.45, y + 0.9), (left, y + 1.4), (left + 0.45, y + 0.9)], color=SCENE, alpha=0.55)
        )
        axes.add_patch(Rectangle((left - 0.38, y + 0.45), 0.76, 0.45, color=SCENE, alpha=0.4, zorder=1))
        axes.add_patch(Circle((x + 1.0 + shift * 0.66, y + 0.9), 0.38, color=OBJECT, alpha=0.6, zorder=2))


def box(axes: Axes, x: float, y: float, color: str, name: str, how: str) -> None:
    """A canonical volume, seen from above its corner."""
    w, h, d = 2.3, 1.4, 0.55
    for corners in (
        [(x, y), (x + w, y), (x + w, y + h), (x, y + h)],
        [(x, y + h), (x + d, y + h + d), (x + w + d, y + h + d), (x + w, y + h)],
        [(x + w, y), (x + w + d, y + d), (x + w + d, y + h + d), (x + w, y + h)],
    ):
        axes.add_patch(Polygon(corners, facecolor=color, alpha=0.13, edgecolor=color, lw=1.3))
        axes.add_patch(Polygon(corners, fill=False, edgecolor=color, lw=1.3))
    axes.text(x + w / 2 + 0.2, y + 0.18, name, ha="center", fontsize=11, color=color, weight="bold")
    axes.text(x + w / 2 + d / 2, y - 0.38, how, ha="center", fontsize=9, color=SOFT)


def mark(axes: Axes, x: float, y: float, color: str, *, size: float, filled: bool = True) -> None:
    axes.plot([x], [y], "o", color=color if filled else "white", mec=color, mew=1.3, ms=size, zorder=7)


def dot(axes: Axes, x: float, y: float) -> None:
    mark(axes, x, y, POINT, size=9)


def arrow(axes: Axes, begin: tuple[float, float], end: tuple[float, float], color: str, *, faint: bool = False) -> None:
    patch = FancyArrowPatch(begin, end, arrowstyle="-|>", mutation_scale=14, lw=1.8, color=color, zorder=5)
    patch.set_alpha(0.25 if faint else 1)
    axes.add_patch(patch)


def curve(axes: Axes, begin: tuple[float, float], end: tuple[float, float], color: str, bend: float) -> None:
    style = f"arc3,rad={-bend}"
    axes.add_patch(FancyArrowPatch(begin, end, arrowstyle="-|>", mutation_scale=12, lw=1.6, color=color,
                                   connectionstyle=style, shrinkA=5, shrinkB=5, zorder=4))  # fmt: skip


def arc(axes: Axes, begin: int, end: int, color: str, width: float, *, dashed: bool = False) -> None:
    angle = np.linspace(np.pi, 0, 60)
    x = (begin + end) / 2 + (end - begin) / 2 * np.cos(angle)
    y = 0.16 + 0.34 * (end - begin) ** 0.8 * np.sin(angle)
    axes.plot(x, y, color=color, lw=width, ls="--" if dashed else "-", zorder=3 if width > 2 else 2)


def main() -> None:
    out = Path(sys.argv[1])
    mpl.rcParams["svg.hashsalt"] = "decomotion"  # the same drawing makes the same file
    for name, (draw, size) in DRAWINGS.items():
        figure, axes = plt.subplots(figsize=size, layout="constrained")
        axes.set_axis_off()
        draw(axes)
        for suffix in sys.argv[2:] or ["svg"]:
            figure.savefig(out / f"{name}.{suffix}", facecolor="white", dpi=110,
                           metadata={"Date": None} if suffix == "svg" else None)  # fmt: skip
        plt.close(figure)


if __name__ == "__main__":
    main()
