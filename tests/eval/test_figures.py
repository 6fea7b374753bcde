"""Benchmarks' own figures against twins that go the way of the benchmarks' code, track by track, on random inputs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from decomo_eval import figures

N, T = 7, 17
ROOMS = pytest.mark.parametrize("seed", range(4))


def tracks(seed: int) -> dict[str, Any]:
    """Positions on the raster, near ones and far ones."""
    random = np.random.default_rng(seed)
    true = random.uniform(-20, 276, (N, T, 2))
    off = random.normal(0, 1, (N, T, 2)) * random.choice([0.5, 3, 10, 40], (N, T, 1))
    return {"random": random, "true": true, "tracks": true + off}


def masked_mean(values: np.ndarray, mask: np.ndarray) -> float:
    return float((values * mask).sum() / mask.sum())


@ROOMS
def test_pointodyssey_s_figures_are_those_of_pips_plus_plus(seed: int) -> None:
    made = tracks(seed)
    valid = made["random"].random((N, T)) < 0.8
    valid[:, 0] = True
    # as test_on_pod.py: at an input of 896x512, divided by a 256th of it
    scale = np.array([896, 512]) / 256
    distance = np.linalg.norm(made["tracks"] * scale / scale - made["true"] * scale / scale, axis=-1)
    within = [masked_mean(distance[:, 1:] < d, valid[:, 1:]) for d in (1, 2, 4, 8, 16)]
    survivals = [np.cumprod(1 - (distance > far) * valid, axis=1).mean() for far in (50, 16)]
    medians = [np.median(distance[n][valid[n]]) for n in range(N)]
    assert figures.pointodyssey(made["tracks"], made["true"], valid) == pytest.approx(
        {
            "pointodyssey_d_avg": np.mean(within),
            "pointodyssey_survival": survivals[0],
            "pointodyssey_survival_16": survivals[1],
            "pointodyssey_mte": np.mean(medians),
        }
    )


@ROOMS
def test_dynamic_replica_s_figures_are_those_of_cotracker(seed: int) -> None:
    made, width, height = tracks(seed), 30, 17
    visible = made["random"].random((N, T)) < 0.6
    visible[:, 3] = True
    # as Evaluator.compute_metrics: pixels of the frame, divided by (W - 1) / 255
    pixels = np.array([width, height]) / 256
    scale = (np.array([width, height]) - 1) / 255
    distance = np.linalg.norm((made["tracks"] * pixels - made["true"] * pixels) / scale, axis=-1)
    started = np.array([[t > np.flatnonzero(visible[n])[0] for t in range(T)] for n in range(N)])
    shares = {
        name: np.mean([masked_mean(distance < d, where) for d in (1, 2, 4, 8, 16)])
        for name, where in (("avg", started), ("vis", visible * started), ("occ", (1 - visible) * started))
    }
    survival = np.cumprod(1 - (distance > 50) * visible, axis=1).mean()
    found = figures.dynamic_replica(made["tracks"], made["true"], visible, (width, height))
    assert found == pytest.approx(
        {**{f"dynamic_replica_d_{n}": share for n, share in shares.items()}, "dynamic_replica_survival": survival}
    )


@ROOMS
def test_egopoints_figures_are_those_of_its_script(seed: int) -> None:
    made = tracks(seed)
    random, true, answers = made["random"], made["true"], made["tracks"]
    answers = np.where(random.random((N, T, 1)) < 0.2, answers + 300, answers)  # some out of view
    kind = random.integers(0, 4, (N, T))  # position, hidden, out of view, not annotated
    kind[1:, 0], kind[0] = 0, [2, *[0] * (T - 1)]  # out of view in frame 0 alone is not counted
    answers[0, 0] = 400
    kind[1, -1], true[1, -1], answers[1, -1] = 0, (3, 100), (-3, 100)
    valid, hidden, out = kind == 0, kind == 1, kind == 2
    out[1, -1] = True  # and annotated nevertheless: near the border, found again where it is last out of view
    visible, judged = valid & (random.random((N, T)) < 0.8), kind < 3
    occluded = random.random((N, T)) < 0.4

    e, g = answers * [2, 1.5], true * [2, 1.5]  # at 512x384
    inside = (e[..., 0] >= 0) & (e[..., 0] <= 512) & (e[..., 1] >= 0) & (e[..., 1] <= 384)
    oova = (out[:, 1:] * ~inside[:, 1:]).sum() / out[:, 1:].sum()
    weight = valid[:, 1:].astype(float) + hidden[:, 1:]
    iva = (weight * inside[:, 1:]).sum() / weight.sum()
    after, after_true = np.zeros((N, T)), np.zeros((N, T))
    for n in range(N):
        both = np.flatnonzero(out[n, 1:] * ~inside[n, 1:])  # counted from frame 1, as in the script
        if len(both):
            after[n, both.max() + 1 :] = 1
        gone = np.flatnonzero(out[n])
        if len(gone):
            after_true[n, gone.max() + 1 :] = 1
    back = (valid[:, 1:] * after_true[:, 1:]).sum()
    off = np.linalg.norm(e[:, 1:] - g[:, 1:], axis=-1)
    re_id = np.mean([(valid[:, 1:] * after[:, 1:] * (off < d)).sum() / back for d in (8, 16, 24)])
    scale = np.array([512, 384]) / 256
    distance = np.linalg.norm(e / scale - g / scale, axis=-1)
    within = {d: masked_mean(distance[:, 1:] < d, valid[:, 1:]) for d in (1, 2, 4, 8, 16, 24)}
    assert figures.egopoints(answers, occluded, true, valid, visible, judged, out, hidden) == pytest.approx(
        {
            "egopoints_d_avg": np.mean([within[d] for d in (1, 2, 4, 8, 16)]),
            "egopoints_d_avg_star": np.mean([within[d] for d in (8, 16, 24)]),
            "egopoints_re_id": re_id,
            "egopoints_oova": oova,
            "egopoints_iva": iva,
            "egopoints_oa": masked_mean(~occluded == visible, judged),
            "egopoints_mte": np.mean([np.median(distance[n][valid[n]]) for n in range(N)]),
        }
    )


def test_egopoints_without_a_point_out_of_view_has_no_figure_of_them() -> None:
    made, none = tracks(0), np.zeros((N, T), bool)
    found = figures.egopoints(made["tracks"], none, made["true"], ~none, ~none, ~none, none, none)
    assert np.isnan([found["egopoints_re_id"], found["egopoints_oova"]]).all()
    assert found["egopoints_oa"] == 1


@ROOMS
def test_badja_s_figures_are_those_of_cotracker(seed: int) -> None:
    made = tracks(seed)
    counted = made["random"].random((N, T)) < 0.5
    counted[:, 0] = False
    masks = made["random"].random((T, 384, 512)) < made["random"].uniform(0, 0.3, (T, 1, 1))
    relative, three = [], []
    for t in range(1, T):
        for n in range(N):
            if counted[n, t]:
                distance = np.hypot(*((made["tracks"] - made["true"])[n, t] * [2, 1.5]))
                relative.append(distance < 0.2 * np.sqrt(masks[t].sum()))
                three.append(distance < 3)
    found = figures.badja(made["tracks"], made["true"], counted, masks.sum(axis=(1, 2)))
    assert found == pytest.approx({"badja_pck": np.mean(relative), "badja_pck_3px": np.mean(three)})
    assert 0 < found["badja_pck_3px"] < found["badja_pck"] < 1


def test_nothing_to_count_is_nan() -> None:
    none = np.zeros((0, 5, 2))
    mask = np.zeros((0, 5), bool)
    found = {
        **figures.pointodyssey(none, none, mask),
        **figures.dynamic_replica(none, none, mask, (9, 5)),
        **figures.egopoints(none, mask, none, mask, mask, mask, mask, mask),
        **figures.badja(none, none, mask, np.zeros(5)),
    }
    assert np.isnan(list(found.values())).all()
    assert {name for name in found if name.endswith("_mte")} == set(figures.IN_PIXELS)


def test_egopoints_edge_of_the_image_belongs_to_it() -> None:
    """At 512x384, of a raster of 256: the whole raster's edge."""
    tracks = np.array([[[9.0, 9], [0, 0], [256, 256], [256.01, 9], [9, -0.01]]])
    none, every = np.zeros((1, 5), bool), np.ones((1, 5), bool)
    found = figures.egopoints(tracks, none, tracks, every, every, every, none, none)
    assert found["egopoints_iva"] == 2 / 4
