"""The file says what torch says, at every size and whatever else is asked in the same call."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch

from decomo_export import parity
from decomo_export.errors import ExportError
from decomo_export.graph import QueryGraph
from decomo_runtime import contract
from decomotion.geometry import ImagePlane
from tiny_export import Export, random_queries

SCORE_LIMIT = 1e-3
"""Of occlusion, colours, confidence and depth: float32 through a few dozen layers."""


@pytest.mark.parametrize(("queries", "frames"), [(1, 1), (2, 7), (3, 5), (61, 3), (5, 40)])
def test_as_torch_says_at_sizes_other_than_traced(exported: Export, queries: int, frames: int):
    asked = random_queries(queries), np.random.default_rng(1).integers(8, size=frames)
    answers = zip(contract.OUTPUTS, exported.ask_torch(*asked), exported.ask_file(*asked), strict=True)
    for name, expected, given in answers:
        assert given.dtype == np.float32
        limit = parity.LIMIT_PIXELS if name == contract.TRACKS else SCORE_LIMIT
        np.testing.assert_allclose(given, expected, rtol=0, atol=limit, err_msg=name)


@pytest.mark.parametrize(("queries", "frames"), [(0, 0), (0, 3), (3, 0), (0, 1), (1, 0)])
def test_no_queries_and_no_frames(exported: Export, queries: int, frames: int):
    answers = exported.ask_file(random_queries(queries), np.arange(frames))
    expected = [(queries, frames, 2), (queries, frames), *[(queries, 3)] * 3, *[(queries,)] * 3]
    assert [answer.shape for answer in answers] == expected


def test_one_query_s_answer_does_not_depend_on_the_others(exported: Export):
    queries, frames = random_queries(9), np.arange(8)
    together = exported.ask_file(queries, frames)
    for row in range(9):
        for answer, alone in zip(together, exported.ask_file(queries[row : row + 1], frames), strict=True):
            # other sizes, other orders of summation
            np.testing.assert_allclose(alone[0], answer[row], rtol=0, atol=1e-4)


def test_one_frame_s_answer_does_not_depend_on_the_others(exported: Export):
    queries = random_queries(5)
    tracks, occlusion, *_ = exported.ask_file(queries, np.arange(8))
    some = np.array([6, 0, 6])
    tracks_of_some, occlusion_of_some, *_ = exported.ask_file(queries, some)
    np.testing.assert_allclose(tracks_of_some, tracks[:, some], rtol=0, atol=1e-4)
    np.testing.assert_allclose(occlusion_of_some, occlusion[:, some], rtol=0, atol=1e-4)


def test_answers_are_in_range(exported: Export):
    _, *scores, depth = exported.ask_file(random_queries(50), np.arange(8))
    for score in scores:
        assert (score >= 0).all()
        assert (score <= 1 + 1e-5).all()
    assert (depth >= 0).all()
    assert (depth <= 2).all()


def test_measured_parity_is_within_the_limit(exported: Export):
    measured = parity.measure(exported.graph, exported.proto())
    assert measured.pixels < parity.LIMIT_PIXELS
    assert measured.score < SCORE_LIMIT


def test_a_file_that_disagrees_is_refused(fitted: Export, networks: Export):
    with pytest.raises(ExportError, match=r"differs from torch by .* px \(limit 0\.01\); nothing was written"):
        parity.measure(fitted.graph, networks.proto())


def shifted(graph: QueryGraph, by: float) -> QueryGraph:
    """A graph whose tracks lie elsewhere."""
    moved = copy.deepcopy(graph)
    forward = moved.forward
    moved.forward = lambda *asked: (forward(*asked)[0] + by, *forward(*asked)[1:])  # type: ignore[method-assign]
    return moved


def test_a_larger_frame_has_a_larger_limit(networks: Export):
    graph = shifted(networks.graph, 0.015)
    with pytest.raises(ExportError, match=r"limit 0\.01\)"):
        parity.measure(graph, networks.proto())
    graph.model.plane = ImagePlane(512, 512)  # the same model, asked elsewhere
    assert 0.01 < parity.measure(graph, networks.proto()).pixels < 0.02


def test_by_force_what_disagrees_is_only_said(networks: Export, caplog: pytest.LogCaptureFixture):
    graph = shifted(networks.graph, 3.0)
    assert parity.measure(graph, networks.proto(), force=True).pixels == pytest.approx(3.0, abs=0.01)
    assert "differs from torch by 3 px" in caplog.text


def test_tracks_far_outside_the_image_are_not_compared():
    plane = ImagePlane(24, 32)
    xy = np.array([[0, 0], [-31, 55], [63, -31], [-33, 0], [65, 0], [0, 57], [0, -33], [np.nan, 0]], np.float32)
    assert parity._far(xy, plane).tolist() == [False] * 3 + [True] * 4 + [False]


def test_not_a_number_is_a_difference(networks: Export):
    graph = copy.deepcopy(networks.graph)
    with torch.no_grad():
        for volume in (graph.model.static, graph.model.dynamic):
            volume.from_first.fill_(float("nan"))
    with pytest.raises(ExportError, match="differs from torch by nan px"):
        parity.measure(graph, networks.proto())
