"""Text that is read back: configurations, `windows.json`, `run.json` and `stage.json`."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from decomotion import config
from decomotion.data.stages import RECORD, Stage
from decomotion.errors import CheckpointError, ConfigError
from decomotion.windows import FILE_NAME, Windows
from near_misses import answer, any_or_near, near_tree, plain_tree

YAML = (Path(config.__file__).parent / "configs" / "cpu.yaml").read_bytes()
TREE = yaml.safe_load(YAML)
ODD = (
    *("[" * 400, "{a: " * 400, "a: &x [*x]", "a: 2026-13-45", "a: " + "9" * 5000, "a: !!int x", "a: !!bool x", "- 1"),
    *("a: !!python/object/apply:os.mkdir [x]", "? [1]\n: 2", "a: \x01", "a: 0b_", "a: !!binary x", "a: !!float x"),
    *("a: !!timestamp x", "extends: cpu\nextends: paper", "extends: [cpu]", "extends: cpu\ndata: 3", "", "---\n---"),
    *("extends: cpu\ndata: {flow: {kind: [dis]}}", "extends: cpu\nloss: {flow_static: .nan}", "extends: cpu\n1: 2"),
    *("extends: cpu\nloss: {flow_static: .inf}", "extends: cpu\noptim: {steps: 5}\noptim: {pairs: 5}"),
    "extends: cpu\na0: &a0 1\n" + "\n".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 40)),
    "extends: cpu\nloss:\n  a0: &a0 1" + "".join(f"\n  a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 40)),
)
"""Too deep, recursive, exponential, of other types than it says, ambiguous, or out of range."""
REFUSED = [text for text in ODD if "extends: cpu" in text] + ["[" * 400, "a: 2026-13-45", "a: !!bool x", "a: !!int x"]


def numbers(value: Any) -> Iterator[float]:
    if isinstance(value, dict | list | tuple):
        for each in value.values() if isinstance(value, dict) else value:
            yield from numbers(each)
    elif isinstance(value, float):
        yield value


@given(
    content=st.one_of(
        any_or_near(YAML),
        st.sampled_from(ODD).map(str.encode),
        near_tree(TREE).map(lambda tree: yaml.safe_dump(tree, allow_unicode=True).encode(errors="replace")),
        near_tree(TREE).map(lambda tree: json.dumps({"extends": "cpu", "x": tree}).encode()),
    )
)
def test_configurations(place: Path, content: bytes):
    (place / "a.yaml").write_bytes(content)
    found = answer(lambda: config.load(file=place / "a.yaml"), ConfigError)
    if found is not None:
        assert all(map(math.isfinite, numbers(found.model_dump())))


@pytest.mark.parametrize("text", REFUSED)
def test_an_odd_configuration_is_refused(place: Path, text: str):
    (place / "a.yaml").write_text(text)
    assert answer(lambda: config.load(file=place / "a.yaml"), ConfigError) is None


KEYS = st.sampled_from(("optim.steps", "data.flow", "loss.flow_static", "model", "", ".", "optim.steps.x", "preset"))


@given(key=KEYS | st.text(), value=st.sampled_from(ODD) | st.text() | plain_tree().map(json.dumps))
def test_overrides(key: str, value: str):
    found = answer(lambda: config.load(overrides=(f"{key}={value}",)), ConfigError)
    if found is not None:
        assert all(map(math.isfinite, numbers(found.model_dump())))


DEEP = [b"[" * 100_000, b'{"a":' * 100_000, b"9" * 5000, b"NaN", b"null", b"[]", b'"a"', b"{}", b'{"windows": 3}']
WINDOWS = {
    **{"format_version": 1, "clip": "goat", "num_frames": 9, "height": 40, "width": 28, "fps": 24.0},
    "windows": [{"name": "window-000", "begin": 0, "end": 5}, {"name": "window-001", "begin": 4, "end": 9}],
    **{"seconds": None, "pixel_aspect": 1.0},
}
PATHS = st.sampled_from(["", ".", "..", "../goat", "/tmp", "window-000/..", "window-0\n", "a\0b", -1, 10**30])


@given(
    content=st.one_of(
        any_or_near(json.dumps(WINDOWS).encode()),
        st.sampled_from(DEEP),
        near_tree(WINDOWS, plain_tree() | PATHS).map(lambda tree: json.dumps(tree).encode()),
    )
)
def test_windows(place: Path, content: bytes):
    (place / FILE_NAME).write_bytes(content)
    found = answer(lambda: Windows.load(place / FILE_NAME, CheckpointError), CheckpointError)
    if found is not None:
        assert [window.name.startswith("window-") for window in found.windows]
        assert found.home(np.arange(min(found.num_frames, 99))).max() < len(found.windows)
        assert len(found.times) == found.num_frames or found.num_frames > 99


@given(data=st.data())
def test_stages(place: Path, data: st.DataObject):
    """A record that is damaged is of no finished stage: it is made anew."""
    stage = Stage("links", {"seed": 0}, place)
    stage.folder.mkdir(exist_ok=True)
    (stage.folder / "points.npy").write_bytes(b"12345")
    whole = {
        **{"settings": stage.settings, "seconds": {"flow": 0.5}, "facts": {"intervals": [1, 2]}},
        "files": {"points.npy": 5},
    }
    content = data.draw(
        st.one_of(
            any_or_near(json.dumps(whole).encode()),
            st.sampled_from(DEEP),
            near_tree(whole).map(lambda tree: json.dumps(tree).encode()),
        )
    )
    (stage.folder / RECORD).write_bytes(content)
    if answer(lambda: stage.finished):
        record = answer(lambda: stage.record(cached=True))
        assert record is not None
        assert all(isinstance(seconds, float) for seconds in record.seconds.values())
