"""AJ after re-detection: against a twin that goes event by event, and numbers that can be done on paper."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from decomo_eval.metrics import THRESHOLDS
from decomo_eval.redetection import ABSENCES, redetection


def twin(hidden: np.ndarray, true: np.ndarray, told_hidden: np.ndarray, tracks: np.ndarray) -> dict[str, float]:
    """Of one video, the way of the published function: events longer than all before, their Jaccards."""
    events: list[tuple[int, dict[int, float]]] = []
    for n in range(len(hidden)):
        longest = -1
        for r in range(1, hidden.shape[1]):
            if hidden[n, r] or not hidden[n, r - 1]:
                continue
            d = 0
            while r - 1 - d >= 0 and hidden[n, r - 1 - d]:
                d += 1
            if d <= longest:
                continue
            longest = d
            jaccards = {}
            for threshold in THRESHOLDS:
                hits = false = seen = 0
                for t in range(r, hidden.shape[1]):
                    within = np.linalg.norm(tracks[n, t] - true[n, t]) <= threshold
                    seen += not hidden[n, t]
                    hits += bool(within and not hidden[n, t] and not told_hidden[n, t])
                    false += bool(not told_hidden[n, t] and (hidden[n, t] or not within))
                jaccards[threshold] = hits / (seen + false)
            events.append((d, jaccards))
    means = {}
    for least in ABSENCES:
        chosen = [jaccards for d, jaccards in events if d >= least]
        per_threshold = [np.mean([jaccards[threshold] for jaccards in chosen]) for threshold in THRESHOLDS if chosen]
        means[f"redetection_jaccard_{least}"] = float(np.mean(per_threshold)) if chosen else np.nan
    defined = [value for value in means.values() if not np.isnan(value)]
    return {"redetection_jaccard": float(np.mean(defined)) if defined else np.nan, **means}


def video(seed: int, points: int = 6, frames: int = 90) -> dict[str, Any]:
    random = np.random.default_rng(seed)
    spell = random.integers(0, 2, (points, frames // 5)).astype(bool)
    hidden = np.repeat(spell, 5, axis=1) ^ (random.random((points, frames)) < 0.05)
    true = random.uniform(0, 256, (points, frames, 2))
    tracks = true + random.normal(0, 1, true.shape) * random.choice([0.4, 2, 6, 20], (points, frames, 1))
    return {
        "hidden": hidden,
        "true": true,
        "told_hidden": hidden ^ (random.random(hidden.shape) < 0.2),
        "tracks": tracks,
    }


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_published_function_s(seed: int) -> None:
    videos = [video(seed), video(seed + 100)]
    found = redetection(*(np.stack([each[key] for each in videos]) for key in videos[0]))
    for number, each in enumerate(videos):
        assert {name: value[number] for name, value in found.items()} == pytest.approx(twin(**each), nan_ok=True)


def one(text: str, told: str, off: list[float]) -> dict[str, float]:
    """A point, hidden at `.` and visible at `#`."""
    hidden, told_hidden = (np.array([[[sign == "." for sign in line]]]) for line in (text, told))
    true = np.zeros((1, 1, len(text), 2))
    return {k: float(v[0]) for k, v in redetection(hidden, true, told_hidden, true + np.array(off)[:, None]).items()}


def test_numbers_on_paper() -> None:
    # back in frame 2; of frames 2 to 4, two are visible, one of them found, and one is falsely told visible
    found = one("#.##.", "#..##", [0] * 5)
    assert found["redetection_jaccard_1"] == pytest.approx(1 / 3)
    assert np.isnan(found["redetection_jaccard_4"])
    assert found["redetection_jaccard"] == pytest.approx(1 / 3)


def test_at_the_threshold_is_within() -> None:
    off = 8 / np.sqrt(2)
    found = one("#.#", "#.#", [0, 0, off * (1 - 1e-12)])
    assert found["redetection_jaccard_1"] == pytest.approx(2 / 5)  # 8 and 16 of the five


def test_a_shorter_absence_after_a_longer_one_is_no_event() -> None:
    # only the first event counts: of frames 3 to 5 one of the two visible is found, the other falsely placed
    found = one("#..#.#", "#..#.#", [0, 0, 0, 0, 0, 99])
    assert found["redetection_jaccard_1"] == pytest.approx(1 / 3)


def test_a_track_that_is_not_known_everywhere_has_no_event() -> None:
    hidden, true, told_hidden, tracks = (value[None] for value in video(0).values())
    judged = np.ones(hidden.shape, bool)
    whole = redetection(hidden, true, told_hidden, tracks)
    np.testing.assert_equal(redetection(hidden, true, told_hidden, tracks, judged), whole)
    judged[0, 1:, 0] = False
    alone = redetection(*(array[:, :1] for array in (hidden, true, told_hidden, tracks)))
    np.testing.assert_equal(redetection(hidden, true, told_hidden, tracks, judged), alone)
    assert alone["redetection_jaccard"] != whole["redetection_jaccard"]


def test_where_nothing_comes_back_it_is_nan() -> None:
    assert np.isnan(list(one("##..", "####", [0] * 4).values())).all()
