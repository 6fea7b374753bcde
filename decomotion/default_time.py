"""How long a fit takes where nothing is said of it, and the line that tells before it begins."""

from __future__ import annotations

import math

from decomotion.windows import Windows

PRESETS_IN_TIME = ("cpu", "omnimotion")
"""Presets whose default is a time; others have as many steps as they say."""
MOST, LEAST = 600.0, 360.0
"""Seconds of a window, preparation included."""
IN_ALL = 1440.0
"""Seconds of all windows, as long as each has `LEAST`: with reading and export, half an hour."""
EXPORT, EXPORT_OF_A_FRAME = 9.0, 0.15
"""Seconds of exporting a window, about, and for each of its frames, on one core."""
LESS = "less means fewer steps: in place of 5,700, 1,200 cost about 1 of 100 points of AJ, and 120 about 5"
"""`docs/limits.md` has the records."""


def rounds(windows: int, jobs: int) -> int:
    """How many windows are fitted one after the other where `jobs` are at a time."""
    return math.ceil(windows / jobs)


def default_seconds(windows: int, jobs: int) -> float:
    """Of each window: frames decide how many there are. What a fit looks at hardly grows with their size."""
    return min(MOST, max(LEAST, IN_ALL / rounds(windows, jobs)))


def announcement(layout: Windows, jobs: int, steps: int | None, seconds: float | None) -> str:
    """What will be done and how long it will take, as far as that is known.

    Args:
        layout: the clip and its windows.
        jobs: windows at a time.
        steps: of each window; None: a time, or the preset's.
        seconds: of each window, in the mean; None: steps.
    """
    count = len(layout.windows)
    what = f"{layout.clip}: {layout.num_frames} frames of {layout.width}x{layout.height}"
    if count > 1:
        what += f" in {count} windows of up to {max(map(len, layout.windows))} frames, {jobs} at a time"
    if seconds is None:
        how_long = "as many steps as the preset has" if steps is None else f"{steps} steps"
        return f"{what}; {how_long} (--time-budget or --steps say otherwise)"
    in_turn = rounds(count, jobs)
    each = f" in all, {spoken(seconds)} for each" if count > 1 else ""
    export = math.ceil((count * EXPORT + sum(map(len, layout.windows)) * EXPORT_OF_A_FRAME) / 60)
    otherwise = "--time-budget or --steps say otherwise"
    if seconds < MOST and count > 1:
        otherwise = f"--time-budget {math.ceil(MOST * in_turn / 60)}m gives each {spoken(MOST)}"
    return (
        f"{what}; {spoken(seconds * in_turn)}{each}, preparation included, then about {export} min of export "
        f"({otherwise}; {LESS})"
    )


def spoken(seconds: float) -> str:
    """`90 s`, `10 min`, `6 h 50 min`."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
