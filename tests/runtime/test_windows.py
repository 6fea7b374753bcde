"""Clips of several windows: stand-in models that know where everything is, and what becomes of a point between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pytest

from decomo_runtime import ModelFileError, Tracker
from decomo_runtime.journey import follow
from decomo_runtime.model import Appearance, Model
from decomo_runtime.model_file import ModelFacts
from decomo_runtime.windows import MOST_OPEN, WindowModels
from decomotion.quality import Figures, Quality
from decomotion.windows import FILE_NAME, Window, Windows, split
from tiny_model import VELOCITY, write_tiny_model

HEIGHT, WIDTH = 60, 90
Hidden = Callable[[npt.NDArray[np.float32], npt.NDArray[np.int64]], npt.NDArray[np.floating]]


@dataclass
class Standing:
    """A model of a window, in which points move by (2, 1) a frame and are as hidden as `hidden(x of frame 0, frame)`.

    `error` is added to x wherever a point is not at its query. Asked for a place where a point is hidden, it follows
    what covers it, which stands still.
    """

    window: Window
    hidden: Hidden
    error: float = 0.0
    facts: Any = None

    def __post_init__(self) -> None:
        self.facts = ModelFacts("part", len(self.window), HEIGHT, WIDTH, 25.0, "cpu", 0.5)
        self.asked: list[int] = []

    def track(self, queries, frames, chunk=None, max_memory=None):
        assert ((queries[:, 0] >= 0) & (queries[:, 0] < len(self.window))).all()
        assert ((frames >= 0) & (frames < len(self.window))).all()
        self.asked.append(len(frames))
        gone = frames - queries[:, :1]
        xy = queries[:, None, 1:] + gone[..., None] * np.array([2.0, 1.0])
        xy[..., 0] += self.error * (gone != 0)
        origin = (queries[:, 1] - 2 * (queries[:, 0] + self.window.begin))[:, None]
        occlusion = np.where(gone == 0, 0, self.hidden(origin, frames + self.window.begin))
        covered = (
            self.hidden(origin, queries[:, :1].astype(int) + self.window.begin)[:, 0] > self.facts.occlusion_threshold
        )
        xy[covered], occlusion[covered] = queries[covered, None, 1:], 0
        return xy.astype(np.float32), occlusion

    def sample(self, queries, chunk=None, max_memory=None):
        colours = np.repeat(queries[:, :1] + self.window.begin, 3, axis=1)
        return Appearance(colours, colours, colours, *np.repeat(queries[:, 1][None], 3, axis=0))


def in_sight(origin: npt.NDArray, frames: npt.NDArray) -> npt.NDArray:
    return np.zeros(np.broadcast_shapes(origin.shape, frames.shape))


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., tuple[WindowModels, dict[str, Standing]]]:
    """A clip of windows, and the models that were opened, by name."""

    def made(windows: tuple[Window, ...], hidden: Hidden = in_sight, error: float = 0.0, **layout: Any):
        opened: dict[str, Standing] = {}
        facts = {"clip": "walk", "num_frames": windows[-1].end, "height": HEIGHT, "width": WIDTH, "fps": 25.0}
        Windows(**{**facts, "windows": windows, **layout}).save(tmp_path / FILE_NAME)
        for window in windows:
            (tmp_path / f"{window.name}.onnx").touch()

        def open_one(file: Path) -> Model:
            window = next(window for window in windows if window.name == file.stem)
            return cast(Model, opened.setdefault(file.stem, Standing(window, hidden, error)))

        return WindowModels(tmp_path, open_one), opened

    return made


def truth(queries: npt.NDArray, frames: npt.NDArray) -> npt.NDArray:
    return queries[:, None, 1:] + (frames - queries[:, :1])[..., None] * np.array([2.0, 1.0])


@pytest.mark.parametrize(("frames", "longest"), [(23, 8), (41, 17), (100, 30)])
def test_points_in_sight_go_through_all_windows_both_ways(make, frames: int, longest: int):
    windows = split(frames, [], longest)
    assert len(windows) > 2
    models, _ = make(windows)
    queries = np.array([(t, 3.5 + t, 2.25) for t in range(frames)], np.float32)
    every = np.arange(frames)
    xy, hidden = follow(models, queries, every)
    np.testing.assert_allclose(xy, truth(queries, every), atol=1e-4)
    assert not hidden.any()


def test_an_answer_depends_on_no_other_query_or_frame(make):
    def flickering(origin, frames):
        return np.abs(np.sin(origin + 3.0 * frames)) * 0.6

    models, _ = make(split(50, [], 20), flickering, error=0.5)
    queries = np.array([(t, 3.5 + t, 2.25) for t in (0, 49, 17, 30, 31, 8)], np.float32)
    every = np.arange(50)
    whole = follow(models, queries, every)
    for row in range(len(queries)):
        alone = follow(models, queries[row : row + 1], every)
        for one, of_all in zip(alone, whole, strict=True):
            np.testing.assert_array_equal(one[0], of_all[row])
    for frame in every:
        alone = follow(models, queries, np.array([frame]))
        for one, of_all in zip(alone, whole, strict=True):
            np.testing.assert_array_equal(one[:, 0], of_all[:, frame])
    mixed = np.array([44, 3, 3, 20])
    for one, of_all in zip(follow(models, queries, mixed), whole, strict=True):
        np.testing.assert_array_equal(one, of_all[:, mixed])


def test_a_point_crosses_where_it_is_surest_to_be_seen(make):
    """Each model adds an error to all but the query: places show where the next one was asked."""
    windows = (Window("window-000", 0, 20), Window("window-001", 14, 34))

    def hidden(origin, frames):
        return np.where(frames == 18, 0.1, 0.4) + 0 * origin

    models, _ = make(windows, hidden, error=1.0)
    xy, occlusion = follow(models, np.array([[2, 5, 5]], np.float32), np.arange(34))
    steps = np.diff(xy[0, :, 0])
    assert np.flatnonzero(np.abs(steps - 2) > 0.5).tolist() == [1, 2, 18]  # out of the query, and out of frame 18
    assert xy[0, 33, 0] == pytest.approx(5 + 2 * 31 + 2)
    assert occlusion[0, 18] == pytest.approx(0.1)


def test_a_query_among_the_shared_frames_crosses_there(make):
    models, _ = make(split(40, [], 24), lambda origin, frames: 0.45 + 0 * origin + 0 * frames, error=1.0)
    (shared,) = [models.layout.shared(0)]
    for frame in shared:
        xy, _ = follow(models, np.array([[frame, 50, 5]], np.float32), np.array([0, 39]))
        assert np.abs(xy[0] - truth(np.array([[frame, 50, 5]]), np.array([0, 39]))[0]).max() == pytest.approx(1.0)


def behind(first: int, last: int) -> Hidden:
    """All whose x in frame 0 is from 20 to 40 are hidden in the frames from `first` to `last`."""

    def hidden(origin, frames):
        return 0.9 * ((origin >= 20) & (origin <= 40) & (frames >= first) & (frames <= last))

    return hidden


@pytest.mark.parametrize("at", [(2, 34.25, 22.5), (40, 110.0 - 20, 41.0)])
def test_a_point_that_is_hidden_in_all_shared_frames_comes_back(make, at: tuple[float, float, float]):
    windows = (Window("window-000", 0, 20), Window("window-001", 14, 44))
    models, _ = make(windows, behind(10, 26))
    query, every = np.array([at], np.float32), np.arange(44)
    origin = at[1] - 2 * at[0]
    xy, occlusion = follow(models, query, every)
    assert 20 <= origin <= 40 or not occlusion.any()
    np.testing.assert_allclose(xy, truth(query, every), atol=1e-3)
    np.testing.assert_allclose(occlusion[0], behind(10, 26)(np.array([[origin]]), every)[0], atol=1e-6)


def test_one_that_does_not_stays_hidden_and_is_not_taken_for_what_covers_it(make):
    windows = (Window("window-000", 0, 20), Window("window-001", 14, 44), Window("window-002", 40, 60))
    models, _ = make(windows, behind(10, 60))
    query, every = np.array([[2, 34.25, 22.5]], np.float32), np.arange(60)
    xy, occlusion = follow(models, query, every)
    np.testing.assert_allclose(xy[0, :18], truth(query, every)[0, :18], atol=1e-3)
    np.testing.assert_allclose(xy[0, 18:], np.tile(xy[0, 17], (42, 1)), atol=1e-3)
    assert (occlusion[0, 18:] == 1).all()


def test_what_comes_back_belongs_to_what_was_hidden(make):
    """Points of the scene are hidden all the time; those of an object, in the same place, come back."""
    windows = (Window("window-000", 0, 20), Window("window-001", 14, 44))
    models, _ = make(windows, behind(10, 26))
    assert (follow(models, np.array([[2, 34, 22]], np.float32), np.arange(44))[1][0, 30:] == 0).all()
    confidence = Standing.sample

    def of_an_object(self, queries, chunk=None, max_memory=None):
        seen = confidence(self, queries)
        moving = self.window.begin > 0
        return Appearance(*[seen.rgb] * 3, np.full(len(queries), 0.0 if moving else 1.0), seen.depth, seen.depth)

    models, _ = make(windows, behind(10, 26))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Standing, "sample", of_an_object)
        assert (follow(models, np.array([[2, 34, 22]], np.float32), np.arange(44))[1][0, 30:] == 1).all()


def test_across_a_cut_nothing_is_followed(make):
    models, opened = make(split(30, [13], 20))
    xy, hidden = follow(models, np.array([[5, 5, 5], [20, 40, 5]], np.float32), np.arange(30))
    assert (hidden[0] == np.r_[np.zeros(13), np.ones(17)]).all()
    assert (hidden[1] == np.r_[np.ones(13), np.zeros(17)]).all()
    np.testing.assert_allclose(xy[0, 13:], np.tile(xy[0, 12], (17, 1)))
    np.testing.assert_allclose(xy[1, :13], np.tile(xy[1, 13], (13, 1)))
    assert len(opened) == 2


def test_only_windows_on_the_way_are_asked(make):
    models, opened = make(split(100, [], 20))
    opened["window-000"].asked.clear()
    follow(models, np.array([[50, 40, 5]], np.float32), np.array([50, 51]))
    assert [name for name, model in opened.items() if model.asked] == [
        models.layout.windows[models.layout.home(np.array([50]))[0]].name
    ]


def test_few_models_stay_open(make):
    models, opened = make(split(300, [], 20))
    assert len(models) > MOST_OPEN + 2
    follow(models, np.array([[0, 5, 5]], np.float32), np.array([299]))
    assert len(opened) == len(models)
    assert len(models._models) == MOST_OPEN


def test_each_ray_is_looked_at_in_its_own_window(make):
    models, _ = make(split(50, [], 20))
    queries = np.array([(t, t / 7, 1) for t in (40, 0, 49, 20)], np.float32)
    seen = models.sample(queries)
    np.testing.assert_allclose(seen.rgb[:, 0], queries[:, 0])
    np.testing.assert_allclose(seen.depth, queries[:, 1])
    assert models.sample(queries[:0]).rgb.shape == (0, 3)


def test_a_folder_of_files_is_one_tracker(tmp_path: Path):
    seconds = tuple((np.arange(30) / 20 + (np.arange(30) > 7)).tolist())
    layout = Windows("walk", 30, HEIGHT, WIDTH, 15.0, split(30, [], 16), seconds, 2.0)
    for window in layout.windows:
        size = {"num_frames": len(window), "height": HEIGHT, "width": WIDTH}
        write_tiny_model(tmp_path / f"{window.name}.onnx", **size, clip_name=window.name)
    layout.save(tmp_path / FILE_NAME, model="whatever else it says")
    tracker = Tracker(tmp_path, threads=1)
    assert (tracker.clip_name, tracker.num_frames, tracker.fps, tracker.pixel_aspect) == ("walk", 30, 15.0, 2.0)
    np.testing.assert_allclose(tracker.times, seconds)
    tracks = tracker.track([[12, 20, 30]])
    np.testing.assert_allclose(tracks.xy[0], [20, 30] + (np.arange(30)[:, None] - 12) * VELOCITY, atol=1e-3)
    assert tracker.dense(2, to=28).flow.shape == (HEIGHT, WIDTH, 2)


def test_how_good_it_is_is_said_of_the_worst_window(make):
    def quality(median: float) -> Quality:
        figures = Figures(60, median, 2 * median + 1, median, 2 * median + 1, 0.5, 0.6, 0.7, 0.1)
        return Quality(900, None, figures, None, None, ())

    windows = split(50, [], 20)
    models, _ = make(windows, quality=(None, quality(0.5), quality(2.0), *[None] * (len(windows) - 3)))
    assert models.facts.quality == quality(2.0)
    assert make(windows)[0].facts.quality is None


def test_a_folder_that_contradicts_itself_is_refused(tmp_path: Path):
    with pytest.raises(ModelFileError, match="is a folder without"):
        Tracker(tmp_path)
    layout = Windows("walk", 30, HEIGHT, WIDTH, 15.0, split(30, [], 16))
    layout.save(tmp_path / FILE_NAME)
    with pytest.raises(ModelFileError, match=r"lacks window-000.onnx, window-001.onnx"):
        Tracker(tmp_path)
    for window in layout.windows:
        size = {"num_frames": len(window) + (window.begin > 0), "height": HEIGHT, "width": WIDTH}
        write_tiny_model(tmp_path / f"{window.name}.onnx", **size)
    with pytest.raises(ModelFileError, match=r"window-001.onnx is of"):
        Tracker(tmp_path).track([[0, 1, 1]])


def test_one_file_is_the_one_window_of_its_clip(tmp_path: Path):
    model = Standing(Window("walk", 0, 4), in_sight)
    times = (0.0, 0.1, 0.5, 0.75)
    model.facts = replace(model.facts, times=times, pixel_aspect=1.5)
    layout = WindowModels(tmp_path / "walk.onnx", lambda _: cast(Model, model)).layout
    assert (layout.num_frames, layout.height, layout.width, layout.pixel_aspect) == (4, HEIGHT, WIDTH, 1.5)
    np.testing.assert_array_equal(layout.times, times)


def test_the_models_that_were_asked_last_stay_open(make):
    windows = split(300, [], 20)
    models, _ = make(windows)
    opened: list[str] = []
    plain = models._opened
    models._opened = lambda path: opened.append(path.stem) or plain(path)
    for number in (*range(1, MOST_OPEN), 0, MOST_OPEN, 0):  # the first was open, and is asked for again
        assert len(models[number].facts.clip_name)
    assert opened == [windows[number].name for number in range(1, MOST_OPEN + 1)]
    assert models[1].facts is not None
    assert opened[-1] == windows[1].name


@pytest.mark.parametrize("longest", [20, 50])  # several windows, and one
def test_the_limits_of_memory_reach_the_models_that_look_at_rays(make, longest: int, monkeypatch: pytest.MonkeyPatch):
    models, _ = make(split(50, [], longest))
    given = []

    def sample(self, queries, chunk=None, max_memory=None):
        given.append((chunk, max_memory))
        return Appearance(*np.zeros((3, len(queries), 3), np.float32), *np.zeros((3, len(queries)), np.float32))

    monkeypatch.setattr(Standing, "sample", sample)
    models.sample(np.array([[0, 1, 1], [49, 2, 2]], np.float32), 7, 10**6)
    assert given == [(7, 10**6)] * (2 if longest == 20 else 1)


def test_what_comes_back_was_hidden_in_the_middle_of_the_shared_frames(make):
    """Those with the window behind, as time goes, which one leaves."""
    models, _ = make((Window("window-000", 0, 20), Window("window-001", 14, 40), Window("window-002", 32, 60)))
    assert [models.returning(1, 1).frame, models.returning(1, -1).frame] == [17, 36]
    assert models.returning(1, -1) is models.returning(1, -1)
