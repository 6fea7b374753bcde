"""The order of a folder's frames by their names, from a table that the page's tests read too."""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decomotion.errors import ClipError
from decomotion.frame_order import _first_that_share, frame_order

TABLE = json.loads((Path(__file__).parents[1] / "recorded" / "frame_order.json").read_text(encoding="utf-8"))


def named(case: dict[str, Any]) -> str:
    return " ".join(case["files"])


@pytest.mark.parametrize("case", [case for case in TABLE if "order" in case], ids=named)
def test_order_of(case: dict[str, Any]):
    assert sorted(case["files"]) == sorted(case["order"])
    for files in (case["files"], case["order"], case["order"][::-1]):
        assert frame_order(files) == case["order"]


@pytest.mark.parametrize("case", [case for case in TABLE if "refused" in case], ids=named)
def test_refused(case: dict[str, Any]):
    with pytest.raises(ClipError):
        frame_order(case["files"])


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (["0.jpg", "0.png", "1.jpg"], r"0\.jpg and 0\.png differ in their ending alone; keep frames and their masks"),
        (["a1.png", "b1.png", "a2.png", "b2.png"], r"a1\.png and b1\.png have one number, and so have 1 more pairs"),
        (["1.9.png", "1.10.png"], r"1\.9\.png and 1\.10\.png follow each other in one order as decimal numbers"),
        (["-1.png", "-2.png"], r"the number of -2\.png has a minus or a dash before it"),
    ],
)
def test_the_sentence_names_the_files(files: list[str], words: str):
    for order in permutations(files):
        with pytest.raises(ClipError, match=words):
            frame_order(order)


def test_the_first_two_series_that_share_numbers_are_found():
    random = np.random.default_rng(0)
    for most in (3, 20, 400):
        ways = [{(Fraction(int(each)),) for each in random.choice(most, 3, replace=False)} for _ in range(30)]
        pairs = [pair for pair in combinations(range(30), 2) if len(ways[pair[0]] & ways[pair[1]]) > 1]
        assert _first_that_share(ways) == next(iter(pairs), None)


def test_names_by_chance_are_compared_only_where_they_share_a_number():
    """Each is a series of its own: all pairs of so many would take many minutes."""
    assert _first_that_share([{(Fraction(number),)} for number in range(50_000)]) is None


def test_few_files_are_in_order():
    assert frame_order([]) == []
    assert frame_order(["-1.png"]) == ["-1.png"]
