"""Small faults: where they are put, and that the same ones are drawn however the file is moved."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import click
import pytest

pytest.importorskip("cosmic_ray", reason="mutants are cosmic-ray's: pip install cosmic-ray")

from harness.mutants import Mutant, sample
from mutation import described, survived

SOURCE = '''"""A module of 3 words."""

import logging

Number = int | float
LIMIT = 5


class Wrong(ValueError):
    pass


def added(first: int | None, second: int = 2, *, more: int = 0) -> int | None:
    """Never 7."""
    if first is None:
        raise WrongError(f"{LIMIT + 1} is wrong")
    logging.info("adding %d", first + 1)
    return first + second | more
'''


def drawn(root: Path, source: str, name: str = "module.py", count: int = 99, seed: int = 0) -> list[Mutant]:
    (root / name).write_text(source)
    return sample(root, [name], count, seed)


def test_faults_are_put_where_a_test_could_see_them(tmp_path: Path):
    mutants = drawn(tmp_path, SOURCE)
    places = sorted((mutant.line, mutant.before) for mutant in mutants)
    assert [line for line, _ in places] == [6, 13, 13, 15, 15, 18, 18]
    assert {mutant.function for mutant in mutants} == {"", "added"}
    for mutant in mutants:
        assert mutant.before in SOURCE
        assert mutant.after not in SOURCE
        assert mutant.changed != SOURCE
        compile(mutant.changed, "mutant", "exec")


def test_the_sample_is_of_the_text(tmp_path: Path):
    """Another name and lines above change nothing; another seed does."""

    def changes(mutants: list[Mutant]) -> list[tuple[str, str]]:
        return [(mutant.before, mutant.after) for mutant in mutants]

    first = changes(drawn(tmp_path, SOURCE, count=4))
    assert len(first) == 4
    assert changes(drawn(tmp_path, "ABOVE = None\n\n" + SOURCE, name="moved.py", count=4)) == first
    assert changes(drawn(tmp_path, SOURCE, count=4, seed=1)) != first


def test_what_survived_is_tried_again_and_the_rest_counts_as_noticed(tmp_path: Path):
    mutants = drawn(tmp_path, SOURCE)
    hole, harmless = mutants[1], mutants[4]
    room = {"equivalent": [{"line": harmless.before, "becomes": harmless.after, "why": "for the test"}]}
    jobs = [SimpleNamespace(mutant=each, noticed=None if each in (hole, harmless) else "a test") for each in mutants]
    first = described(room, jobs, len(mutants))
    assert (first["mutants"], first["killed"], first["survivors"]) == (6, 5, [hole.record()])
    assert [each["why"] for each in first["equivalent"]] == ["for the test"]
    record = {"rooms": {"room": first}}
    assert survived(record, "room", mutants) == [hole, harmless]
    jobs = [SimpleNamespace(mutant=hole, noticed="a test"), SimpleNamespace(mutant=harmless, noticed=None)]
    second = described(room, jobs, len(mutants))
    assert (second["mutants"], second["killed"], second["survivors"]) == (6, 6, [])
    with pytest.raises(click.UsageError, match="the sources of room have changed since that record"):
        survived(record, "room", mutants[:-1])
    with pytest.raises(click.UsageError, match="have changed"):
        survived(record, "room", [each for each in mutants if each != hole] + drawn(tmp_path, "a = 1\n"))
