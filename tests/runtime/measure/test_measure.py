"""Points, regions and maps of deformations in closed form."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from decomo_runtime import (
    MeasureError,
    MeasureSettings,
    QueryError,
    Scale,
    Smoothing,
    Tracks,
    measure_maps,
    measure_points,
    measure_region,
    raster_over,
)
from decomo_runtime.measure.strain import strain_of
from decomo_runtime.regions import region_queries
from deforming_tracker import FRAMES, HEIGHT, WIDTH, DeformingTracker, affine

LAST = FRAMES - 1
MATRIX = np.array([[1.1, 0.15], [-0.05, 0.95]])
SETTINGS = MeasureSettings(Scale(0.5, "mm"))
MIDDLE = np.s_[20:40, 30:60]


def region(frame: int = 0, spacing: float = 3) -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[MIDDLE] = True
    return region_queries(mask, frame, spacing)


def test_points_in_units_of_length_and_time():
    """x moves by t^2 pixels in t seconds, y by -2 t."""

    def moving(places: np.ndarray, frames: np.ndarray) -> np.ndarray:
        t = frames / 10
        return places + np.stack([t**2, -2 * t], axis=-1)

    motion = measure_points(DeformingTracker(moving), [(0, 30, 20), (0, 50.5, 41)], settings=SETTINGS)
    t = np.arange(FRAMES) / 10
    np.testing.assert_allclose(motion.displacement[1], np.stack([t**2, -2 * t], axis=-1) / 2, atol=1e-5)
    np.testing.assert_allclose(motion.rates.velocity[0], np.stack([t, -1 + 0 * t], axis=-1), atol=1e-3)
    np.testing.assert_allclose(motion.rates.acceleration[0], np.broadcast_to([1, 0], (FRAMES, 2)), atol=1e-2)
    faster = measure_points(
        DeformingTracker(moving), [(0, 30, 20)], settings=MeasureSettings(fps=1000), frames=np.arange(1, 8)
    )
    np.testing.assert_allclose(faster.times, np.arange(1, 8) / 1000)
    np.testing.assert_allclose(faster.rates.velocity[0, :, 1], -200, rtol=1e-3)


def test_velocities_are_along_the_clip_s_own_times():
    times = np.array([0, 1, 2, 5, 6, 8, 9, 10, 14]) / 10

    def moving(places: np.ndarray, frames: np.ndarray) -> np.ndarray:
        return places + times[frames][..., None] * [4.0, 3.0]

    tracker = DeformingTracker(moving, times=times)
    motion = measure_points(tracker, [(0, 30, 20)])
    np.testing.assert_allclose(motion.rates.velocity[0], np.broadcast_to([4, 3], (FRAMES, 2)), rtol=1e-4)
    with pytest.raises(MeasureError, match="leave out --fps"):
        measure_points(tracker, [(0, 30, 20)], settings=MeasureSettings(fps=240))


def test_displacement_is_against_any_frame():
    there, back = affine(MATRIX, (4, 2))
    tracker = DeformingTracker(there, back)
    queries = np.array([(2, 30, 20), (5, 40, 31)])
    motion = measure_points(tracker, queries, reference=3)
    start = back(queries[:, 1:].astype(float), queries[:, 0])
    truth = there(start[:, None], np.arange(FRAMES)[None]) - there(start[:, None], np.array([[3]]))
    np.testing.assert_allclose(motion.displacement, truth, atol=1e-4)
    assert not motion.displacement[:, 3].any()
    own = measure_points(tracker, queries)
    assert not own.displacement[[0, 1], [2, 5]].any()
    three = MeasureSettings(smoothing=Smoothing(3))
    later = measure_points(tracker, queries, reference=3, frames=[4, 6, 8], settings=three)
    np.testing.assert_allclose(later.displacement, truth[:, [4, 6, 8]], atol=1e-4)
    reference = own.measured().named("reference").values
    assert reference[:, 0].tolist() == [2, 5]


@pytest.mark.parametrize("reference", [0, 3, 8])
def test_a_region_of_a_uniform_deformation_is_exact(reference: int):
    there, back = affine(MATRIX, (4, -2))
    motion = measure_region(DeformingTracker(there, back), region(frame=2), reference=reference, settings=SETTINGS)
    amount = np.arange(FRAMES)[:, None, None] / LAST
    gradients = np.eye(2) + amount * (MATRIX - np.eye(2))
    truth = strain_of(gradients @ np.linalg.inv(gradients[reference]))
    for name in ("green_lagrange", "small", "principal", "area_change"):
        np.testing.assert_allclose(getattr(motion.strain, name), getattr(truth, name), atol=1e-5)
    np.testing.assert_allclose(motion.strain.rotation, truth.rotation, atol=1e-3)
    assert (motion.residual < 1e-4).all()
    assert not motion.hidden.any()
    middle = region(frame=2)[:, 1:].mean(0)
    start = back(middle, np.array(2))
    np.testing.assert_allclose(motion.middle, there(start, np.arange(FRAMES)), atol=1e-4)
    np.testing.assert_allclose(motion.displacement, (motion.middle - motion.middle[reference]) / 2, atol=1e-4)


def test_hidden_points_of_a_region_do_not_count_until_too_few_are_left():
    """The bar hides what is left of its edge, which moves; its answers are off by 5 pixels."""
    there, back = affine(MATRIX)
    tracker = DeformingTracker(there, back, hidden=lambda places, frames: places[..., 0] < 5 * frames + 19)
    motion = measure_region(tracker, region(), frames=np.arange(FRAMES))
    assert motion.hidden.tolist() == [False] * 7 + [True] * 2
    assert (np.diff(motion.in_sight) <= 0).all()
    truth = strain_of(np.eye(2) + np.arange(FRAMES)[:, None, None] / LAST * (MATRIX - np.eye(2)))
    np.testing.assert_allclose(motion.strain.green_lagrange[:7], truth.green_lagrange[:7], atol=1e-5)
    assert motion.measured().named("occluded").values.tolist() == motion.hidden.tolist()
    middle = region()[:, 1:].mean(0)
    np.testing.assert_allclose(motion.middle[:7], there(middle, np.arange(7)), atol=1e-4)


def test_what_is_hidden_in_the_frame_of_reference_is_marked():
    there, back = affine(MATRIX)
    tracker = DeformingTracker(there, back, hidden=lambda places, frames: (frames == 4) & (places[..., 0] < 33))
    motion = measure_points(tracker, [(0, 30, 20), (0, 40, 20)], reference=4)
    assert motion.hidden[0].all()
    assert not motion.hidden[1].any()
    assert motion.tracks.occluded[0].tolist() == [frame == 4 for frame in range(FRAMES)]


def test_a_map_of_a_uniform_deformation_is_exact_up_to_the_border():
    there, back = affine(MATRIX)
    tracker = DeformingTracker(there, back, pixel_aspect=1.5)
    raster = raster_over(tracker, 3, spacing=4, gauge=16)
    assert raster.inside.shape == (15, 20)
    assert raster.gauge == (16, 16)
    gradients = np.eye(2) + np.array([0, 8])[:, None, None] / LAST * (MATRIX - np.eye(2))
    base = np.eye(2) + 3 / LAST * (MATRIX - np.eye(2))
    stretch = np.diag([1.5, 1])
    for each, gradient in zip(measure_maps(tracker, raster, frames=[0, 8], settings=SETTINGS), gradients, strict=True):
        truth = stretch @ gradient @ np.linalg.inv(base) @ np.linalg.inv(stretch)
        np.testing.assert_allclose(each.deformation, np.broadcast_to(truth, (15, 20, 2, 2)), atol=1e-5)
        assert not each.hidden.any()


def test_a_bending_wave_shows_the_gauge_s_size():
    """The mean slope of a sine over a gauge is less than its greatest one; a small gauge is near to the truth."""
    length, height = 40.0, 1.5

    def bent(places: np.ndarray, frames: np.ndarray) -> np.ndarray:
        down = height * (frames > 0) * np.sin(2 * np.pi / length * places[..., 0])
        return places + np.stack([np.zeros_like(down), down], axis=-1)

    tracker = DeformingTracker(bent)
    errors = []
    for gauge in (4, 16):
        raster = raster_over(tracker, 0, spacing=2, gauge=gauge)
        (found,) = measure_maps(tracker, raster, frames=[5])
        x = raster.queries[10:20, 10:30, 1]
        truth = height * 2 * np.pi / length * np.cos(2 * np.pi / length * x)
        errors.append(np.abs(found.deformation[10:20, 10:30, 1, 0] - truth).max())
    assert errors[0] < 0.01
    assert errors[1] > 0.03


def test_gauges_do_not_reach_across_an_object_s_rim():
    """What is right of x = 40 is an object that moves away; neither it nor the scene is strained."""

    def parted(places: np.ndarray, frames: np.ndarray) -> np.ndarray:
        return places + np.where(places[..., :1] > 40, 1.0, 0.0) * frames[..., None] * [3.0, 1.0]

    tracker = DeformingTracker(parted, own=lambda places: places[..., 0] > 40)
    raster = raster_over(tracker, 0, spacing=4, gauge=24)
    (found,) = measure_maps(tracker, raster, frames=[6])
    np.testing.assert_allclose(found.strain.green_lagrange, 0, atol=1e-5)


def test_what_is_torn_has_no_strain():
    """Both halves are the scene's; only gauges that reach across x = 40 are torn."""

    def torn(places: np.ndarray, frames: np.ndarray) -> np.ndarray:
        return places + np.where((places[..., :1] > 40) & (frames[..., None] > 0), 12.0, 0.0)

    tracker = DeformingTracker(torn)
    raster = raster_over(tracker, 0, spacing=4, gauge=16)
    (found,) = measure_maps(tracker, raster, frames=[6])
    torn_region = measure_region(tracker, region(), frames=np.arange(1, FRAMES), reference=0)
    assert np.isnan(torn_region.deformation).all()
    assert (torn_region.residual > 3).all()
    assert np.isfinite(torn_region.displacement).all()
    across = np.abs(raster.queries[..., 1] - 40) < 8
    assert np.isnan(found.strain.principal[across]).all()
    assert (found.residual[across] > 1).all()
    np.testing.assert_allclose(found.strain.green_lagrange[~across], 0, atol=1e-5)


def test_hidden_nodes_are_marked_and_touch_no_others():
    there, _ = affine(MATRIX)
    tracker = DeformingTracker(there, hidden=lambda places, frames: (frames > 0) & (places[..., 0] < 41))
    raster = raster_over(tracker, 0, spacing=4, gauge=24)
    (found,) = measure_maps(tracker, raster, frames=[LAST])
    hidden = raster.queries[..., 1] < 41
    np.testing.assert_array_equal(found.hidden, hidden)
    wanted = np.broadcast_to(MATRIX, found.deformation.shape)
    np.testing.assert_allclose(found.deformation[~hidden], wanted[~hidden], atol=1e-5)
    assert np.abs(found.deformation[hidden] - wanted[hidden]).max() > 0.1
    values = found.measured().named("occluded").values
    np.testing.assert_array_equal(values, hidden)


def test_a_map_within_a_region_is_of_it_alone():
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[MIDDLE] = True

    def torn(places: np.ndarray, frames: np.ndarray) -> np.ndarray:
        inside = (places > [29.5, 19.5]).all(-1) & (places < [59.5, 39.5]).all(-1)
        return places + np.where(inside[..., None], 0.0, 7.0)

    tracker = DeformingTracker(torn)
    raster = raster_over(tracker, 0, spacing=2, gauge=8, region=mask)
    (found,) = measure_maps(tracker, raster, frames=[4])
    assert np.isfinite(found.deformation[raster.inside]).all()
    np.testing.assert_allclose(found.strain.green_lagrange[raster.inside], 0, atol=1e-6)
    assert np.isnan(found.deformation[~raster.inside]).all()


def test_a_clip_refines_points_regions_and_maps(monkeypatch: pytest.MonkeyPatch):
    """Refining is tested with it; here it moves all points of frame 5 by a pixel."""
    video = np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8)

    def moved(_: object, tracks: Tracks, frames: np.ndarray) -> Tracks:
        assert frames is video
        return replace(tracks, xy=tracks.xy + np.where(tracks.frames == 5, 1, 0)[None, :, None])

    monkeypatch.setattr("decomo_runtime.measure.following.refine", moved)
    tracker = DeformingTracker(*affine(np.eye(2)))
    raster = raster_over(tracker, 0)
    (mapped,) = measure_maps(tracker, raster, frames=[5], clip=video)
    found = [
        measure_points(tracker, [(0, 30, 20)], clip=video).displacement[0, 5],
        measure_region(tracker, region(), clip=video).displacement[5],
        mapped.displacement[2, 3],
    ]
    np.testing.assert_allclose(found, 1, atol=1e-5)


def test_frames_in_blocks_are_all_there(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("decomo_runtime.measure.maps.BLOCK", 4)
    monkeypatch.setattr("decomo_runtime.measure.following.PIECE", 7)
    tracker = DeformingTracker(*affine(MATRIX))
    maps = list(measure_maps(tracker, raster_over(tracker, 0)))
    assert [each.frame for each in maps] == list(range(FRAMES))
    np.testing.assert_allclose(maps[-1].deformation, np.broadcast_to(MATRIX, (8, 10, 2, 2)), atol=1e-5)
    motion = measure_region(tracker, region())
    assert len(motion.tracks.queries) == len(region())
    np.testing.assert_allclose(motion.deformation[-1], MATRIX, atol=1e-5)


@pytest.mark.parametrize(
    ("ask", "reason"),
    [
        (lambda t: measure_points(t, [(0, 1, 2)], reference=9), "--reference 9 is no frame of the clip"),
        (lambda t: measure_points(t, [(0, 1, 2)], reference=-1), "give one within 0 .. 8"),
        (lambda t: measure_points(t, []), "there is no point to measure"),
        (lambda t: measure_region(t, np.empty((0, 3))), "there is no point to measure"),
        (lambda t: measure_region(t, []), "there is no point to measure"),
        (lambda t: measure_points(t, [(0, 1, 2)], reference=1.5), "--reference 1.5 is no frame of the clip"),
        (lambda t: measure_points(t, [(0, 1, 2)], frames=[3, 2, 1]), "in rising order"),
        (lambda t: measure_points(t, [(0, 1, 2)], frames=[]), "at least one"),
        (lambda t: measure_points(t, [(0, 1, 2)], frames=[1, 2]), "needs 7 frames but there are 2"),
        (lambda t: measure_region(t, [(0, 1, 2), (0, 9, 9)]), "the region has 2 points, of which a strain needs"),
        (lambda t: measure_region(t, [(0, x, 9) for x in range(9)]), "do not lie on a line"),
        (lambda t: raster_over(t, 9), "--reference 9 is no frame"),
        (lambda t: raster_over(t, 0, spacing=0.5), "--spacing 0.5 must be from 1 pixel"),
        (lambda t: raster_over(t, 0, spacing=16), "to a quarter of the frame"),
        (lambda t: raster_over(t, 0, spacing=8, gauge=12), "--gauge 12 must be at least twice the spacing"),
        (lambda t: raster_over(t, 0, gauge=61), "no more than the frame"),
        (lambda t: raster_over(t, 0, region=np.ones((9, 7), bool)), "the region is a mask of [9, 7], but the clip's"),
    ],
)
def test_bad_arguments(ask: Any, reason: str):
    with pytest.raises(MeasureError, match=re.escape(reason)):
        ask(DeformingTracker(*affine(MATRIX)))


def test_points_outside_of_the_clip():
    with pytest.raises(QueryError, match="x must be within"):
        measure_points(DeformingTracker(*affine(MATRIX)), [(0, 99, 2)])


@pytest.mark.parametrize("queries", ["points", [(0, 1), (2, 3)], [(np.nan, 1, 1)], None, [[0, 1, 2], [3]]])
@pytest.mark.parametrize("ask", [measure_points, measure_region])
def test_what_is_no_points(ask: Any, queries: Any):
    with pytest.raises(QueryError):
        ask(DeformingTracker(*affine(MATRIX)), queries)


def test_an_expected_error_is_a_length():
    class Told(DeformingTracker):
        def track(self, queries: Any, frames: Any = None) -> Tracks:
            tracks = super().track(queries, frames)
            return replace(tracks, error=np.full(tracks.occluded.shape, 3, np.float32))

    motion = measure_points(Told(*affine(np.eye(2))), [(0, 30, 20)], settings=SETTINGS)
    error = motion.measured().named("error")
    assert error.unit == "mm"
    np.testing.assert_allclose(error.values, 1.5)


def test_what_is_said_of_a_point_hidden_in_the_frame_of_reference():
    """It is marked everywhere, and its velocity is of the frames in which it is seen."""
    there, back = affine(np.eye(2), (16, 0))
    tracker = DeformingTracker(there, back, hidden=lambda places, frames: (frames == 4) & (places[..., 0] < 33))
    motion = measure_points(tracker, [(0, 30, 20), (0, 40, 20)], reference=4)
    assert motion.measured().named("occluded").values.tolist() == [[True] * 9, [False] * 9]
    np.testing.assert_allclose(motion.rates.velocity[0, [2, 3, 5, 6]], np.broadcast_to([20, 0], (4, 2)), rtol=1e-4)
    assert motion.rates.used[0].tolist() == [6, 6, 6, 6, 7, 6, 6, 6, 6]


def test_what_a_file_says_of_its_region():
    motion = measure_region(DeformingTracker(*affine(MATRIX)), region(), settings=SETTINGS)
    assert motion.measured().settings["points"] == len(region()) > 50
    assert motion.measured().settings["length_of_a_pixel"] == 0.5


def test_a_gauge_is_32_pixels_wide_where_nothing_is_said():
    assert raster_over(DeformingTracker(*affine(MATRIX)), 0).gauge == (32, 30)  # eight rows of 7.5 pixels


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_what_is_torn_is_so_in_any_unit(scale: float):
    """What is right of x = 40 moves by 12 pixels, or by a fifth of one."""

    def parted(places: np.ndarray, frames: np.ndarray) -> np.ndarray:
        away = np.where(frames[..., None] == 6, 12.0, 0.2 * (frames[..., None] > 0))
        return places + np.where(places[..., :1] > 40, away, 0.0)

    tracker, settings = DeformingTracker(parted), MeasureSettings(Scale(scale, "mm"))
    raster = raster_over(tracker, 0, spacing=4, gauge=16)
    for whole, found in zip(
        (True, False), measure_maps(tracker, raster, frames=[5, 6], settings=settings), strict=True
    ):
        assert np.isfinite(found.deformation).all() == whole


@pytest.mark.parametrize(("high", "torn"), [(12, True), (40, False)])
def test_a_region_is_torn_by_its_narrow_side(high: int, torn: bool):
    """Sixty pixels wide; one half moves by eight, of which a plane leaves some two."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[8 : 8 + high, 10:70] = True

    def parted(places: np.ndarray, frames: np.ndarray) -> np.ndarray:
        return places + np.where((places[..., :1] > 40) & (frames[..., None] > 0), 8.0, 0.0)

    motion = measure_region(DeformingTracker(parted), region_queries(mask, 0, 3))
    assert 1.3 < motion.residual[5] < 3.5
    assert np.isnan(motion.deformation[5]).all() == torn
