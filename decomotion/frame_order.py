"""The one order of a folder's frames, by their names; `docs/formats.md` states it, the page has the same.

A name without its ending is cut into text and numbers, in turn. Numbers are compared as numbers, text in lower case and
composed (NFC) by code points, and what is still equal by the whole names. A dash may be a minus, a dot or a comma a
decimal point: where that makes another order, the names must show which it is.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Sequence
from fractions import Fraction
from itertools import combinations, pairwise
from pathlib import PurePath
from unicodedata import normalize

from decomotion.errors import ClipError

Key = list[str | Fraction]
"""Text and numbers in turn; text, which may be empty, is first and last."""
Numbers = tuple[Fraction, ...]
"""Of a name."""

_DIGITS = "0-9"  # not \d: one order in every language and alphabet
_AMONG_NUMBERS = rf"(?<![{_DIGITS}])(?<![{_DIGITS}]\.)"
_NO_NUMBERS_MORE = rf"(?!\.?[{_DIGITS}])"  # 1.2.3 is no decimal number


def frame_order(names: Iterable[str]) -> list[str]:
    """The names of the frames in a folder (`0.jpg`, `shot (1).png`), in their order.

    Raises `ClipError` where they are of two clips, or can be read in two orders and nothing tells which is meant.
    """
    names = sorted(names)
    _check_single(names)
    minus = _has_minus(names)
    return _sorted(names, minus, _has_decimals(names, minus))


def _sorted(names: Sequence[str], minus: bool = False, decimal: bool = False) -> list[str]:
    return sorted(names, key=lambda name: (name_key(name, minus, decimal), name))


def name_key(name: str, minus: bool = False, decimal: bool = False) -> Key:
    """Text and numbers of a name without its ending, in turn; numbers have a sign, or decimals, where that is said."""
    sign, fraction = "-?" if minus else "", rf"(?:[.,][{_DIGITS}]+)?" if decimal else ""
    alone = rf"{_AMONG_NUMBERS}{sign}[{_DIGITS}]+{fraction}{_NO_NUMBERS_MORE}"
    if decimal:
        alone = rf"(?<![{_DIGITS}],(?=[{_DIGITS}])){alone}(?!,[{_DIGITS}])"
    parts = re.split(rf"({alone}|[{_DIGITS}]+)", normalize("NFC", PurePath(name).stem.lower()))
    return [Fraction(part.replace(",", ".")) if place % 2 else part for place, part in enumerate(parts)]


def words_and_numbers(name: str) -> tuple[tuple[str, ...], Numbers]:
    """The letters of a name between its numbers, which are those of one series, and the numbers."""
    key = name_key(name)
    words = tuple("".join(filter(str.isalpha, part)) for part in key if isinstance(part, str))
    return words, tuple(part for part in key if isinstance(part, Fraction))


def _check_single(names: Sequence[str]) -> None:
    """Refuses two files of one name, and two series that have the same numbers, as `0001.png` and `0001_mask.png`."""
    named: dict[str, str] = {}
    series: dict[tuple[str, ...], dict[Numbers, str]] = defaultdict(dict)
    for name in names:
        stem = PurePath(name).stem
        if (other := named.setdefault(stem, name)) != name:
            raise ClipError(
                f"{other} and {name} differ in their ending alone; keep frames and their masks in folders of their own"
            )
        words, numbers = words_and_numbers(name)
        if numbers:
            series[words][numbers] = name
    ways = list(series.values())
    if (pair := _first_that_share(ways)) is not None:
        one, other = (ways[number] for number in pair)
        shared = sorted(one.keys() & other.keys())
        first, second = sorted([one[shared[0]], other[shared[0]]])
        raise ClipError(
            f"{first} and {second} have one number, and so have {len(shared) - 1} more pairs: two clips, or "
            "frames and their masks; keep them in folders of their own"
        )


def _first_that_share(ways: Sequence[Collection[Numbers]]) -> tuple[int, int] | None:
    """The first two of some series that have two numbers or more in common; None where no two have.

    Names of letters and digits by chance are each a series of their own, of which no two are compared for nothing.
    """
    with_number: dict[Numbers, list[int]] = defaultdict(list)
    for number, each in enumerate(ways):
        for key in each:
            with_number[key].append(number)
    common = Counter(pair for those in with_number.values() for pair in combinations(those, 2))
    return min((pair for pair, count in common.items() if count > 1), default=None)


def _has_minus(names: Sequence[str]) -> bool:
    """Whether a dash before a number is a minus: where others have a number there without one, as `-1` and `0`.

    Behind a letter it is a dash else; refused where it is behind none.
    """
    signed: dict[tuple[str | Fraction, ...], str] = {}
    plain = set()
    for name in names:
        key = name_key(name, minus=True, decimal=True)
        for place, part in enumerate(key):
            if isinstance(part, Fraction) and part < 0:
                signed[tuple(key[:place])] = name
        for way in (key, name_key(name, minus=True)):  # (0,-1) and (0,1) are no decimal numbers
            plain |= {tuple(way[:place]) for place, part in enumerate(way) if isinstance(part, Fraction) and part >= 0}
    if signed.keys() & plain:
        return True
    for before, name in signed.items():
        if not str(before[-1])[-1:].isalpha() and _sorted(names, minus=True) != _sorted(names):
            raise ClipError(
                f"the number of {name} has a minus or a dash before it, which makes two orders; rename the frames"
            )
    return False


def _has_decimals(names: Sequence[str], minus: bool) -> bool:
    """Whether a dot or a comma between numbers is a decimal point; false too where it makes no other order.

    It is none where two names would then be one number, as 1.1 and 1.10. It is one where it has to be for the sake of
    a 0 right behind it (0.05), or of the frames' even distance (0.25, 0.5, 0.75). What else can be read both ways is
    refused, as 1.9 and 1.10.
    """
    if minus and any(re.search(rf"[{_DIGITS}],-[{_DIGITS}]", name) for name in names):  # two numbers, as in (0,-1)
        return False
    counted, measured = _sorted(names, minus), _sorted(names, minus, decimal=True)
    keys = [name_key(name, minus, decimal=True) for name in measured]
    if counted == measured or any(key == after for key, after in pairwise(keys)):
        return False
    fractions = [digits for name in names for digits in re.findall(rf"[.,]([{_DIGITS}]+)", PurePath(name).stem)]
    longer = [digits for digits in fractions if len(digits) > 1]
    if any(digits[0] == "0" for digits in longer):
        return True
    if not any(digits[-1] == "0" for digits in longer) and _evenly_spaced(keys, max(map(len, fractions))):
        return True
    first = next(place for place, pair in enumerate(zip(counted, measured, strict=True)) if pair[0] != pair[1])
    raise ClipError(
        f"{counted[first]} and {measured[first]} follow each other in one order as decimal numbers and in the other as "
        "counters; give all names as many decimals"
    )


def _evenly_spaced(keys: Sequence[Key], digits: int) -> bool:
    """Whether three names or more differ in one number alone, and by even steps as far as its digits tell."""
    if len(keys) < 3 or len({len(key) for key in keys}) > 1:
        return False
    changing = [column for column in zip(*keys, strict=True) if len(set(column)) > 1]
    numbers = [number for number in changing[0] if isinstance(number, Fraction)]
    if len(changing) > 1 or not numbers:
        return False
    steps = [after - number for number, after in pairwise(numbers)]
    return max(steps) - min(steps) <= 2 * Fraction(1, 10**digits)
