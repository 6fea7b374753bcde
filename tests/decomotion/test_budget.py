"""The budget of linking: what there is no time for is refused at once, or thinned."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decomotion.config import load
from decomotion.data.config import DataConfig
from decomotion.data.links import budget, flow_store, sift_matching
from decomotion.data.links.budget import check_time, scheduled, what_is_thinned
from decomotion.data.links.costs import Costs, HopCosts, LaterCosts
from decomotion.data.links.flow_store import FlowStore
from decomotion.data.links.matching import MatchStore
from decomotion.data.links.sift_matching import SiftMatcher
from decomotion.data.masks import cost as masks_cost
from decomotion.errors import SupervisionError
from tiny_fit import FRAMES, sliding_square

CLIP = sliding_square()
DEAR = HopCosts(flow=0.001, match=0.0025)
NOTHING, LATER = LaterCosts(0.0, 0.0), LaterCosts(0.0, 20 / 256)


def settings(seconds: float, *overrides: str) -> DataConfig:
    return load("cpu", overrides=(f"data.prepare_budget={seconds}", *overrides)).data


class Estimator:
    """Of no flow."""

    field_side = 64

    def __init__(self, concurrent: bool = False, guided: bool = False) -> None:
        self.concurrent, self.guided = concurrent, guided
        self.asked: list[tuple[int, int]] = []

    def __call__(self, first: Any, second: Any, pair: tuple[int, int], start: Any = None) -> Any:
        self.asked.append(pair)

    def effort(self, gap: int) -> float:
        return 1.0

    def require(self, pairs: list[tuple[int, int]]) -> None:
        """All are there."""


class Matched(MatchStore):
    """Lasts 10 seconds."""

    lasting = 10.0

    def seconds(self) -> float:
        return self.lasting


class Flows(FlowStore):
    """Fields that last 2 seconds each; none is made."""

    def seconds(self, fields: int) -> float:
        return 2.0 * fields

    def compute(self, gaps: Sequence[int], progress: bool, only: slice = slice(None)) -> int:
        return 2 * len(range(FRAMES - 1)[only])

    def seconds_a_search(self) -> float:
        return 2.0


@pytest.fixture
def flows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Flows:
    monkeypatch.setattr(budget.costs, "hop_costs", lambda *_: DEAR)
    matches = Matched(CLIP, (4,), SiftMatcher(10), tmp_path / "matches")
    return Flows(CLIP, Estimator(), matches, tmp_path / "flow")


def test_all_parts_count(flows: Flows) -> None:
    """Matching 10, 14 fields of 2 seconds 28, features, masks and structure 20; and a point of every frame has 56 hops
    by flow and 20 by matches: 0.106 seconds, 256 of them 27.1. Altogether 86 seconds."""
    assert check_time(CLIP, settings(86.0), flows, 500, 1.0, LATER) == Costs(DEAR, LATER)
    sentence = (
        "8 frames are too many for the time that there is: to prepare them takes at least 86 seconds (matching 10, "
        "flow between neighbours 28, links of 256 points a frame 27, features, masks and structure 20), and there are "
        "85; give --prepare-budget 86s or longer, to decomo-train also --time-budget 115s or longer for each window, "
        "or a part, CLIP@A:B"
    )
    with pytest.raises(SupervisionError, match=re.escape(sentence)):
        check_time(CLIP, settings(85.0), flows, 500, 1.0, LATER)
    check_time(CLIP, settings(85.0), flows, 100, 1.0, LATER)  # where fewer are wanted


def test_what_is_linked_again_counts(flows: Flows) -> None:
    """A third of the points: 36 seconds for 27."""
    hop = check_time(CLIP, settings(96.0), flows, 500, 4 / 3, LATER).hop
    assert (hop.flow, hop.match) == pytest.approx((DEAR.flow * 4 / 3, DEAR.match * 4 / 3))
    with pytest.raises(
        SupervisionError, match=r"at least 95 seconds .* points a frame 36, features, masks and structure 20"
    ):
        check_time(CLIP, settings(94.0), flows, 500, 4 / 3, LATER)


def test_what_takes_a_minute_is_not_refused(flows: Flows, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Matched, "lasting", 4.8)
    check_time(CLIP, settings(1.0), flows, 500, 1.0, NOTHING)
    with pytest.raises(SupervisionError, match="at least 61 seconds"):
        check_time(CLIP, settings(1.0), flows, 500, 1.0, LaterCosts(0.5, 0.0))


@pytest.mark.parametrize(
    ("seconds", "gaps", "points"),
    [
        # 1 2 4 is 14 + 12 + 8 = 34 fields, 68 seconds of at least 113.4; 56 + 42 + 20 hops by flow, 20 by matches
        (200.0, [1, 2, 4], 500),
        (150.0, [1, 2, 4], 488),
        (113.4, [1, 2, 4], 270),
        (113.2, [1, 2], 413),  # 26 fields, 52 seconds; 98 hops by flow
        (10.0, [1], 256),
        (-10.0, [1], 256),
    ],
)
def test_flow_has_its_share_and_points_fit_into_the_rest(
    flows: Flows, seconds: float, gaps: list[int], points: int, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    chosen = scheduled(CLIP, settings(180.0), flows, 500, Costs(DEAR, NOTHING), seconds, tmp_path / "schedule.json")
    assert chosen == {"intervals": gaps, "seconds_per_search": 2.0, "points": points, "thinned": points < 500}
    fewer = "" if len(gaps) == 3 else f"flow at gaps {', '.join(map(str, gaps))} of 1, 2, 4 and "
    told = f"{fewer}{points} of 500 points a frame: budget; for all, give a longer --prepare-budget or --time-budget"
    assert [record.getMessage() for record in caplog.records] == ([told] if points < 500 else [])


@pytest.mark.parametrize(
    ("seconds", "gaps", "points"), [(240.0, [1, 2, 4], 500), (160.0, [1, 2, 4], 390), (123.2, [1, 2], 322)]
)
def test_fewer_points_take_less_time_later(
    flows: Flows, seconds: float, gaps: list[int], points: int, tmp_path: Path
) -> None:
    """As above, with ten seconds less; and of a point another 0.042 beside 0.168, or 0.148 with gaps 1 and 2."""
    later = LaterCosts(10.0, 0.042)
    chosen = scheduled(CLIP, settings(180.0), flows, 500, Costs(DEAR, later), seconds, tmp_path / "schedule.json")
    assert (chosen["intervals"], chosen["points"]) == (gaps, points)


def test_what_is_thinned_is_a_line() -> None:
    config = settings(1.0, "data.flow.longest_interval=8")
    for gaps, points, line in (
        ((1, 2), 500, "flow at gaps 1, 2 of 1, 2, 4, 8: budget"),
        ((1, 2, 4, 8), 300, "300 of 500 points a frame: budget"),
        ((1,), 300, "flow at gaps 1 of 1, 2, 4, 8 and 300 of 500 points a frame: budget"),
        ((1, 2, 4, 8), 500, None),
    ):
        assert what_is_thinned(config, 40, gaps, points, 500) == line
    assert what_is_thinned(config, 6, [1, 2, 4], 500, 500) is None  # a short clip has no others


def test_a_list_has_all_the_time_it_takes(flows: Flows, caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    config = settings(1.0, "data.flow.intervals=[1,3]")
    chosen = scheduled(CLIP, config, flows, 500, None, -1.0, tmp_path / "schedule.json")
    assert (chosen["intervals"], chosen["points"], chosen["thinned"]) == ([1, 3], 500, False)
    assert not caplog.text


@pytest.mark.parametrize(("seconds", "gaps"), [(74.0, [1, 2, 4]), (73.8, [1, 2]), (57.0, [1, 2]), (56.8, [1])])
def test_what_linking_all_points_leaves_is_flow_s(
    flows: Flows, seconds: float, gaps: list[int], tmp_path: Path
) -> None:
    """Of all points, with gaps 1 2 4 and 118 hops by flow, 5.9 seconds beside flow's 68; with 1 2, 4.9 beside 52."""
    cheap = HopCosts(flow=0.0001, match=0.0)
    chosen = scheduled(CLIP, settings(180.0), flows, 500, Costs(cheap, NOTHING), seconds, tmp_path / "schedule.json")
    assert (chosen["intervals"], chosen["points"], chosen["thinned"]) == (gaps, 500, gaps != [1, 2, 4])


def test_fields_cost_what_their_gap_does(flows: Flows, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A search at gap 4 takes half, so that flow takes 60 seconds instead of 68; and neighbours are searched twice."""
    monkeypatch.setattr(Estimator, "effort", lambda _, gap: 0.5 if gap == 4 else 1.0)
    for number, (seconds, gaps) in enumerate([(100.1, [1, 2, 4]), (99.9, [1, 2])]):
        file = tmp_path / f"{number}.json"
        assert scheduled(CLIP, settings(180.0), flows, 500, Costs(DEAR, NOTHING), seconds, file)["intervals"] == gaps
    flows.estimator.guided = True
    flows.matches.gaps = [1, 4]
    assert [flows.effort(gap) for gap in (1, 2, 4)] == [2.0, 1.0, 0.5]


def test_what_was_chosen_stays(flows: Flows, tmp_path: Path) -> None:
    file = tmp_path / "schedule.json"
    chosen = scheduled(CLIP, settings(180.0), flows, 500, Costs(DEAR, NOTHING), 113.2, file)
    assert json.loads(file.read_text()) == chosen
    assert scheduled(CLIP, settings(180.0), flows, 500, None, 1e6, file) == chosen


class TestOfParts:
    """Each part's time is that of a frame, a pair or a field, as often as there is one."""

    @pytest.fixture(autouse=True)
    def of_a_second(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def least_seconds(task: Callable[[], object]) -> float:
            task()
            return 1.0

        for module in (flow_store, sift_matching, masks_cost):
            monkeypatch.setattr(module, "least_seconds", least_seconds)

    def matches(self, folder: Path) -> MatchStore:
        return MatchStore(CLIP, (3, 5, 20), SiftMatcher(10), folder / "matches", True)

    def test_matching(self, tmp_path: Path) -> None:
        """8 frames, and of pairs 7, 5 and 3; none of those that are there."""
        matches = self.matches(tmp_path)
        assert matches.seconds() == 8 + 15
        matches.compute(progress=False)
        assert matches.seconds() == 0

    @pytest.mark.parametrize(
        ("concurrent", "guided", "seconds"), [(False, False, 14), (False, True, 28), (True, True, 7)]
    )
    def test_flow(
        self, concurrent: bool, guided: bool, seconds: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(flow_store, "threads", lambda: 4)
        estimator = Estimator(concurrent, guided)
        assert FlowStore(CLIP, estimator, self.matches(tmp_path), tmp_path / "flow").seconds(14) == seconds
        assert estimator.asked == [(0, 1)]

    @pytest.mark.parametrize(("frames", "pairs"), [(2, 1), (8, 7), (40, 16)])
    def test_masks(self, frames: int, pairs: int, monkeypatch: pytest.MonkeyPatch) -> None:
        """A frame is compared with 8 on either side, or with as many as there are; a trial is of 6 pairs."""
        asked = []
        monkeypatch.setattr(
            masks_cost, "moving_probability", lambda *arguments: asked.append([a.shape for a in arguments[:4]])
        )
        clip = np.zeros((frames, 28, 40, 3), np.uint8)
        seconds = masks_cost.seconds_a_frame(clip, 500, np.random.default_rng(3))
        some = min(3, frames)
        assert seconds == pytest.approx(pairs / (some * (some - 1)))
        assert asked == [[(some, 28, 40, 3), (some, 494, 2), (some, some, 494, 2), (some, some, 494)]]

    def test_masks_of_a_clip(self) -> None:
        assert masks_cost.seconds_a_frame(CLIP.frames, 300, np.random.default_rng(3)) == pytest.approx(7 / 6)
