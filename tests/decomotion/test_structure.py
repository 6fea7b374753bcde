"""Structure from motion: hidden points of a scene that a camera turns and moves past."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from decomotion.data.structure import Structure, structure
from decomotion.data.structure.places import MOST_FRAMES, frames_to_place_by
from decomotion.data.surroundings import Expected
from decomotion.units import to_units

HEIGHT, WIDTH = 180, 320
POINTS = 300
Which = npt.NDArray[np.bool_]
FIRST_HALF = np.arange(POINTS) < POINTS // 2


@dataclass(frozen=True)
class Scene:
    """Points of each frame at random pixels and depths, seen by a camera in all frames."""

    points: npt.NDArray[np.float32]
    targets: npt.NDArray[np.float32]

    @property
    def frames(self) -> int:
        return len(self.points)

    def structure(self, confidence: npt.NDArray[np.uint8], targets: npt.NDArray[np.float32] | None = None) -> Structure:
        still = np.ones(self.points.shape[:2], bool)
        random = np.random.default_rng(3)
        told = self.targets if targets is None else targets
        return structure(self.points, told, confidence, still, (HEIGHT, WIDTH), random)

    def error(
        self, found: Structure, frame: int, target: int, which: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.floating]:
        """Units between where those points are expected that are in the frame, and where they are."""
        off = expected(found, frame, target).xy.numpy() - to_units(self.targets[frame, target], HEIGHT, WIDTH)
        return np.linalg.norm(off, axis=-1)[which & (self.certain()[frame, target] > 0)]

    def certain(self) -> npt.NDArray[np.uint8]:
        """All that is in the frame is known."""
        inside = ((self.targets >= 0) & (self.targets <= [WIDTH - 1, HEIGHT - 1])).all(axis=-1)
        return np.where(inside, np.uint8(255), np.uint8(0))


def filmed(frames: int = 16, turn: float = 0.03, move: tuple[float, float, float] = (0.12, 0.01, 0.06)) -> Scene:
    """A pinhole camera that turns by `turn` radians and moves by `move` from frame to frame."""
    random = np.random.default_rng(7)
    focal, centre = 300.0, np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
    points = random.random((frames, POINTS, 2)) * [WIDTH - 1, HEIGHT - 1]
    depth = random.uniform(3, 12, (frames, POINTS, 1))
    turns = [_about_y(turn * (frame - frames / 2)) for frame in range(frames)]
    places = [np.array(move) * (frame - frames / 2) for frame in range(frames)]
    targets = np.empty((frames, frames, POINTS, 2))
    for i in range(frames):
        rays = np.concatenate([(points[i] - centre) / focal, np.ones((POINTS, 1))], axis=1)
        world = (rays * depth[i]) @ turns[i] + places[i]
        for j in range(frames):
            seen = (world - places[j]) @ turns[j].T
            targets[i, j] = seen[:, :2] / seen[:, 2:] * focal + centre
    return Scene(points.astype(np.float32), targets.astype(np.float32))


def _about_y(angle: float) -> npt.NDArray[np.floating]:
    return np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])


def expected(found: Structure, frame: int, target: int) -> Expected:
    return found.expected(np.full(POINTS, frame), np.full(POINTS, target), np.arange(POINTS))


def hidden_late(scene: Scene, seen: int) -> npt.NDArray[np.uint8]:
    """Half of the points are linked to frames that are nearer than `seen` alone."""
    confidence = scene.certain()
    frames = np.arange(scene.frames)
    far = np.abs(frames[:, None] - frames) >= seen
    confidence[..., : POINTS // 2] *= ~far[..., None]
    return confidence


def test_hidden_points_are_expected_where_parallax_leads_them() -> None:
    scene = filmed()
    found = scene.structure(hidden_late(scene, 6))
    for frame, target in ((0, 12), (15, 4), (4, 15)):
        error = scene.error(found, frame, target, FIRST_HALF)
        assert np.median(error) < 0.15
        assert np.percentile(error, 90) < 1.0
        away = np.linalg.norm(scene.targets[frame, target] - scene.points[frame], axis=-1)
        assert np.median(away) > 20, "the scene moves by much more"


@pytest.mark.parametrize(("turn", "move"), [(0.0, (0.0, 0.0, 0.0)), (0.04, (0.0, 0.0, 0.0)), (0.0, (0.2, 0.0, 0.0))])
def test_cameras_that_stand_or_only_turn_or_move(turn: float, move: tuple[float, float, float]) -> None:
    scene = filmed(turn=turn, move=move)
    found = scene.structure(hidden_late(scene, 6))
    error = np.concatenate([scene.error(found, i, j, FIRST_HALF) for i, j in ((2, 13), (13, 2))])
    assert np.median(error) < 0.15
    assert np.isfinite(found.covariance).all()


def test_what_is_found_badly_weighs_little() -> None:
    scene = filmed(turn=0.0, move=(0.0, 0.0, 0.12))  # straight ahead: cameras are found roughly
    found = scene.structure(hidden_late(scene, 6))
    error = scene.error(found, 2, 13, FIRST_HALF)
    weight = expected(found, 2, 13).weight.numpy()[FIRST_HALF & (scene.certain()[2, 13] > 0)]
    assert np.median(error) < 2
    assert weight[error < 1].mean() > 0.8
    assert weight[error > 4].mean() < 0.65


def test_what_moves_otherwise_neither_bends_cameras_nor_agrees() -> None:
    scene = filmed()
    targets = scene.targets.copy()
    other = np.arange(POINTS) % 4 == 0
    frames = np.arange(scene.frames)
    targets[:, :, other] = scene.points[:, None, other]  # stays where it is in the picture
    targets[:, :, other, 1] += 2.0 * (frames - frames[:, None])[..., None]
    found = scene.structure(scene.certain(), targets)
    assert np.median(scene.error(found, 1, 14, ~other)) < 1
    placed = found.agreement > 0
    assert np.median(found.agreement[:, ~other][placed[:, ~other]]) > 0.9


def test_links_that_hold_on_to_what_hides_a_point_are_left_out() -> None:
    scene = filmed()
    confidence, targets = scene.certain(), scene.targets.copy()
    lost = np.arange(POINTS) % 3 == 0
    frames = np.arange(scene.frames)
    late = np.argwhere(frames - frames[:, None] >= 7)
    for i, j in late:
        targets[i, j, lost] = targets[i, i + 7, lost]  # stays with what hides it
        confidence[i, j, lost] = 120
    found = scene.structure(confidence, targets)
    assert np.median(scene.error(found, 0, 12, lost)) < 0.5


def test_the_less_is_known_the_less_it_weighs() -> None:
    scene = filmed()
    confidence = scene.certain()
    confidence[3, 9:, :100] = 0  # linked to frames 0 to 8
    confidence[3, :, 100:200] *= (np.abs(np.arange(scene.frames) - 3) < 3)[:, None]  # to five: too few
    found = scene.structure(confidence)
    enough = (confidence[3] > 0).sum(axis=0) > 7

    def weight(points: slice, target: int) -> float:
        return float(expected(found, 3, target).weight.numpy()[points][enough[points]].mean())

    assert weight(slice(200, 300), 12) > 0.9
    assert weight(slice(0, 100), 9) > weight(slice(0, 100), 15) > 0.1
    assert (expected(found, 3, 6).weight.numpy()[100:200] == 0).all()


def test_points_are_anchored_where_they_are() -> None:
    scene = filmed()
    confidence = scene.certain() // 2
    noise = np.random.default_rng(5).normal(scale=1.5, size=scene.targets.shape).astype(np.float32)
    found = scene.structure(confidence, scene.targets + noise)
    assert np.median(scene.error(found, 8, 8, FIRST_HALF)) < 0.4


@pytest.mark.parametrize("points", [0, 3])
def test_too_few_still_points_expect_nothing(points: int) -> None:
    scene = filmed(frames=9)
    confidence = scene.certain()
    confidence[..., points:] = 0
    still = np.zeros(scene.points.shape[:2], bool)
    still[:, :points] = True
    random = np.random.default_rng(0)
    found = structure(scene.points, scene.targets, confidence, still, (HEIGHT, WIDTH), random)
    assert np.isfinite(found.places).all()
    assert (found.agreement[:, points:] == 0).all()


def test_two_frames_have_no_structure() -> None:
    scene = filmed(frames=2)
    found = scene.structure(scene.certain())
    assert (found.agreement == 0).all()


def test_chance_is_the_given_generator() -> None:
    scene = filmed(frames=8)
    one, other = (scene.structure(scene.certain()) for _ in range(2))
    assert np.array_equal(one.places, other.places)


@pytest.mark.parametrize("frames", [5, MOST_FRAMES, MOST_FRAMES + 1, 103, 400])
def test_points_are_placed_by_a_bounded_number_of_frames(frames: int) -> None:
    for frame in (0, frames // 3, frames - 1):
        by = frames_to_place_by(frame, frames)
        assert frame in by
        assert len(by) <= MOST_FRAMES + 2
        assert by.min() <= 17 or frames > 300
        assert set(range(max(0, frame - 4), min(frames, frame + 5))) <= set(by)
    if frames <= MOST_FRAMES:
        assert len(frames_to_place_by(1, frames)) == frames


class Noted:
    """Stands in for the fit of cameras, and notes what that is given."""

    def __init__(self, seen: npt.NDArray, counts: npt.NDArray, gap: npt.NDArray) -> None:
        self.seen, self.counts, self.gap = seen, counts, gap


def fitted_to(scene: Scene, confidence: npt.NDArray[np.uint8], still: Which, seed: int = 0) -> Noted:
    """Of twelve points that are drawn, three a frame."""
    noted: list[Noted] = []

    def fit(seen: npt.NDArray, counts: npt.NDArray, gap: npt.NDArray, _: np.random.Generator) -> npt.NDArray:
        noted.append(Noted(seen, counts, gap))
        cameras = np.tile(np.eye(3, 4), (scene.frames, 1, 1))
        cameras[:, 2] = (0, 0, 0, 1)
        return cameras

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("decomotion.data.structure.fit_cameras", fit)
        patch.setattr("decomotion.data.structure.SAMPLE", 12)
        structure(scene.points, scene.targets, confidence, still, (HEIGHT, WIDTH), np.random.default_rng(seed))
    return noted[0]


def test_cameras_are_fitted_to_links_of_what_stands_still() -> None:
    """Places are units / 128 - 1; a link counts the square of its confidence, and a point's own place wholly."""
    scene = filmed(frames=4)
    confidence = np.random.default_rng(0).integers(0, 256, (4, 4, POINTS), np.uint8)
    still = np.random.default_rng(1).random((4, POINTS)) < 0.1
    still[3] = False
    still[3, 5] = True
    noted = fitted_to(scene, confidence, still)
    assert noted.seen.shape == (10, 4, 2)
    drawn = []
    for seen, counts, gap in zip(noted.seen, noted.counts, noted.gap, strict=True):
        frame = int(gap.argmin())
        assert gap.tolist() == [abs(other - frame) for other in range(4)]
        xy = (seen[frame] + 1) * 128 * 320 / 256 + (0.625 - 0.5)
        point = int(np.linalg.norm(scene.points[frame] - xy, axis=-1).argmin())
        np.testing.assert_allclose(scene.points[frame, point], xy, atol=1e-3)
        assert still[frame, point]
        drawn.append((frame, point))
        for other in range(4):
            if other != frame:
                there = (seen[other] + 1) * 128 * 320 / 256 + (0.625 - 0.5)
                np.testing.assert_allclose(there, scene.targets[frame, other, point], atol=1e-2)
                assert counts[other] == pytest.approx((confidence[frame, other, point] / 255) ** 2)
        assert counts[frame] == 1
    assert len(set(drawn)) == 10
    assert (3, 5) in drawn
    assert not np.array_equal(fitted_to(scene, confidence, still, seed=1).seen, noted.seen)


def test_what_is_expected_by_hand() -> None:
    """A camera that sees Z = 0.5 at depth 1.5: where, and by small steps how surely; half the weight at two units."""
    camera = np.float32([[1, 0, 0.5, 0.1], [0, 1, 0, -0.2], [0, 0, 1, 1]])
    place, covariance = np.float32([0.3, 0.6, 0.5]), np.float32([[3, 1, 0], [1, 2, 0.5], [0, 0.5, 4]]) / 128**2
    found = Structure(
        np.stack([np.eye(3, 4, dtype=np.float32), camera]),
        np.tile(place, (2, 1, 1)),
        np.tile(covariance, (2, 1, 1, 1)),
        np.full((2, 1), 0.8, np.float32),
    ).expected(np.array([0]), np.array([1]), np.array([0]))

    def seen(x: npt.NDArray) -> npt.NDArray:
        u, v, depth = camera @ np.append(x, 1.0)
        return np.array([u, v]) / depth

    np.testing.assert_allclose(found.xy[0], 128 * (seen(place) + 1), rtol=1e-5)
    np.testing.assert_allclose(found.xy[0], [128 * (0.65 / 1.5 + 1), 128 * (0.4 / 1.5 + 1)], rtol=1e-5)
    slope = np.stack([(seen(place + step) - seen(place - step)) / 2e-3 for step in 1e-3 * np.eye(3)], axis=1)
    variance = np.trace(slope @ covariance @ slope.T) * 128**2  # square units
    assert float(found.weight[0]) == pytest.approx(0.8 / (1 + variance / 4), rel=1e-3)


def test_what_is_behind_a_camera_is_somewhere_all_the_same() -> None:
    """At a fifth of the depth of the origin."""
    camera = np.float32([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1]])
    shape = (1, 1)
    behind = np.broadcast_to(np.float32([0.1, -0.04, -3]), (*shape, 3))
    found = Structure(camera[None], behind, np.zeros((*shape, 3, 3), np.float32), np.ones(shape, np.float32))
    at = found.expected(np.array([0]), np.array([0]), np.array([0]))
    np.testing.assert_allclose(at.xy[0], [128 * (0.5 + 1), 128 * (-0.2 + 1)], rtol=1e-5)
    assert float(at.weight[0]) == 1
