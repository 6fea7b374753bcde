"""The traced graph: the same operators whatever the clip's length, its tables shared and not copied."""

from __future__ import annotations

import numpy as np
import onnx
import pytest

from decomo_export import lookup
from decomo_export.baking import Bake
from decomo_export.graph import QueryGraph
from decomo_export.tracing import trace
from tiny_fit import tiny_model


def traced(frames: int, bake: Bake = "depth", preset: str = "cpu") -> onnx.ModelProto:
    return trace(QueryGraph(tiny_model(preset, frames=frames, height=18, width=30).eval(), bake).eval())


@pytest.mark.parametrize("preset", ["cpu", "paper"])
def test_operators_do_not_depend_on_the_number_of_frames(preset: str):
    """What a longer clip adds is rows of constants: time and memory of tracing are those of a short one."""
    short, long = (traced(frames, preset=preset) for frames in (3, 40))
    assert [node.SerializeToString() for node in short.graph.node] == [
        node.SerializeToString() for node in long.graph.node
    ]
    sizes = [{each.name: len(each.raw_data) for each in proto.graph.initializer} for proto in (short, long)]
    assert sizes[0].keys() == sizes[1].keys()
    longer = {name for name, size in sizes[0].items() if size != sizes[1][name]}
    assert {"surfaces.codes", "model.static.to_first", "model.static.from_first"} <= longer
    for name in longer:
        assert sizes[1][name] * 3 == sizes[0][name] * 40


@pytest.mark.parametrize("bake", ["none", "depth", "full"])
def test_nothing_but_look_ups_is_made_of_large_tables(bake: Bake, monkeypatch: pytest.MonkeyPatch):
    """So that a runtime, which computes what follows from constants when it loads, has nothing to compute."""
    unfolding = read_by(traced(6, bake))
    monkeypatch.setattr(lookup, "MOST_UNFOLDED", 0)
    folded = read_by(traced(6, bake))
    assert unfolding.keys() == folded.keys()
    assert set(unfolding.values()) == {"Slice"}
    assert set(folded.values()) == {"Gather"}


def read_by(proto: onnx.ModelProto) -> dict[str, str]:
    """The operator that reads each table."""
    return {
        name: node.op_type
        for node in proto.graph.node
        for name in node.input
        if name.endswith((".grids", "surfaces.codes"))
    }


def test_tables_are_stored_as_they_are_not_unfolded():
    graph = QueryGraph(tiny_model("cpu", frames=4, height=18, width=30).eval(), "full").eval()
    stored = {each.name: onnx.numpy_helper.to_array(each) for each in trace(graph).graph.initializer}
    np.testing.assert_array_equal(stored["surfaces.codes"], graph.surfaces.get_buffer("codes"))
    tables = {name: table for name, table in graph.named_buffers() if name in stored}
    rest = sum(array.nbytes for name, array in stored.items() if name not in tables)
    assert sum(stored[name].nbytes - table.nbytes for name, table in tables.items()) == 0
    assert rest < 2 * sum(parameter.nbytes for parameter in graph.parameters())
