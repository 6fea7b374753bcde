"""What a folder of frames lacks by the names in it: numbers that are left out, and frames in files of other kinds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import pairwise
from statistics import median_low

from decomotion.errors import ClipError
from decomotion.frame_order import Key, name_key, words_and_numbers
from decomotion.lost_frames import PLACES, UNEVEN

OTHER_SUFFIXES = frozenset(
    {".avif", ".bmp", ".dng", ".dpx", ".exr", ".gif", ".hdr", ".heic", ".heif", ".jfif", ".jp2", ".jpe", ".jxl"}
    | {".pgm", ".ppm", ".tga", ".tif", ".tiff", ".webp"}
)
"""Of pictures that are no frames here."""


def check_kinds(frames: Iterable[str], others: Iterable[str]) -> None:
    """Raises `ClipError` where a picture of another kind has a name of the frames' series and a number of its own."""
    series: dict[tuple[str, ...], set[tuple[Fraction, ...]]] = {}
    for name in frames:
        words, numbers = words_and_numbers(name)
        series.setdefault(words, set()).add(numbers)
    for name in sorted(others):
        words, numbers = words_and_numbers(name)
        if numbers and words in series and numbers not in series[words]:
            raise ClipError(f"{name} is one of the frames by its name, but no .jpg or .png; convert it or take it away")


def missing_numbers(names: Sequence[str]) -> str | None:
    """Says which frames in order are missing by their numbers, as in `lacks 2 frames by its names: 2 after 002.png`.

    None where none are, where no one number counts the frames, or where it does so unevenly.
    """
    numbers = _counter([name_key(name) for name in names])
    if len(numbers) < 3:
        return None
    steps = [after - number for number, after in pairwise(numbers)]
    if (usual := median_low(steps)) <= 0:
        return None
    gaps = {name: round(step / usual) - 1 for name, step in zip(names, steps, strict=False) if step >= 2 * usual}
    if not gaps or len(gaps) > max(1, UNEVEN * len(steps)):
        return None
    where = [f"{number} after {name}" for name, number in gaps.items()]
    more = f" and at {len(where) - PLACES} more places" if len(where) > PLACES else ""
    count = sum(gaps.values())
    frames = f"{count} frame{'s' if count > 1 else ''}"
    return f"lacks {frames} by its names: {', '.join(where[:PLACES])}{more}; the other {len(names)} are counted from 0"


def _counter(keys: Sequence[Key]) -> list[Fraction]:
    """The number that alone differs between names; empty where there is none such."""
    if len({len(key) for key in keys}) != 1:
        return []
    changing = [column for column in zip(*keys, strict=True) if len(set(column)) > 1]
    return [part for part in changing[0] if isinstance(part, Fraction)] if len(changing) == 1 else []
