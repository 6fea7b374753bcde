"""The rooms of `benchmarks/mutation.yaml`: what they name is there, or nobody would miss its faults."""

from __future__ import annotations

from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
ROOMS = yaml.safe_load((ROOT / "benchmarks/mutation.yaml").read_text())


def test_every_source_and_every_test_is_there():
    sources = [pattern for room in ROOMS.values() for pattern in room["sources"]]
    tests = [f"tests/{name}.py" for room in ROOMS.values() for name in room["tests"]]
    assert [pattern for pattern in sources + tests if not any(ROOT.glob(pattern))] == []
