"""docs/supervise.md: its scripts run whole, with stand-ins for the trackers; their files become links as they are."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from clip_files import write_images
from decomotion.clip import Clip, read_clip
from decomotion.config import load
from decomotion.data.links.tracks import read_tracks
from decomotion.data.masks.folder import read_masks
from decomotion.data.prepare import prepare
from decomotion.errors import SupervisionError
from tiny_fit import TINY_CPU

PAGE = (Path(__file__).parents[2] / "docs" / "supervise.md").read_text()
WIDTH, HEIGHT = 48, 28
SPEED = torch.tensor([0.75, -0.5])
TRACKERS = ("CoTracker3", "TAPIR and BootsTAPIR", "TAPNext")
GRIDS = [(7, 3, 2), (6, 2, 3), (11, 4, 5)]
"""Frames, points across and frames that the grid is laid in; of the second, as many tracks as frames."""


def script(title: str, setting: str, value: str) -> str:
    """The section's Python, with another value of a setting."""
    section = PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]
    (code,) = re.findall(r"```python\n(.*?)```", section, re.S)
    code, changed = re.subn(rf"^{setting} = .*", f"{setting} = {value}", code, flags=re.M)
    assert changed == 1
    return code


def hidden(frame: torch.Tensor, begin: torch.Tensor) -> torch.Tensor:
    """Which points hide: every third frame counted from their own, so that it differs between points."""
    return (frame - begin) % 3 == 1


def place(frame: torch.Tensor, begin: torch.Tensor, xy: torch.Tensor) -> torch.Tensor:
    """True (x, y), pixels of the clip."""
    return xy + (frame - begin)[..., None] * SPEED


class CoTracker:
    """Answers as `CoTrackerPredictor.forward` does."""

    def to(self, device: str) -> CoTracker:
        return self

    def __call__(self, video: torch.Tensor, queries: torch.Tensor, backward_tracking: bool = False) -> Any:
        assert video.shape[2:] == (3, HEIGHT, WIDTH)
        assert 1 < video.max() <= 255
        assert queries.ndim == 3
        frame, begin = torch.arange(video.shape[1])[:, None], queries[0, :, 0]
        xy = place(frame, begin, queries[0, :, 1:])
        if not backward_tracking:
            xy[frame < begin] = 0
        return xy[None], ~hidden(frame, begin)[None]


def in_clip(yx: torch.Tensor, side: int) -> torch.Tensor:
    """(y, x) where the image spans 0 to `side` to (x, y) in pixels of the clip."""
    return yx.flip(-1) * torch.tensor([WIDTH, HEIGHT]) / side - 0.5


def in_raster(xy: torch.Tensor, side: int) -> torch.Tensor:
    return (xy + 0.5) * side / torch.tensor([WIDTH, HEIGHT])


class Tapir:
    """Answers as `TAPIR.forward` does: some points hide by `occlusion`, some by `expected_dist`."""

    def __init__(self, pyramid_level: int) -> None:
        assert pyramid_level == 1

    def load_state_dict(self, state: dict[str, Any]) -> None:
        assert state == {}

    def to(self, device: str) -> Tapir:
        return self

    def eval(self) -> Tapir:
        return self

    def __call__(self, video: torch.Tensor, query_points: torch.Tensor, query_chunk_size: int) -> dict[str, Any]:
        _, frames, height, width, channels = video.shape
        assert height == width
        assert channels == 3
        assert -1 <= video.min() < 0 < video.max() <= 1
        frame, begin = torch.arange(frames), query_points[0, :, :1]
        xy = place(frame, begin, in_clip(query_points[0, :, 1:], width)[:, None])
        hides = hidden(frame, begin)
        by_occlusion = (torch.arange(len(hides)) % 2 == 0)[:, None]
        return {
            "tracks": in_raster(xy, width)[None],
            "occlusion": torch.where(hides & by_occlusion, 3.0, -3.0)[None],
            "expected_dist": torch.where(hides & ~by_occlusion, 3.0, -3.0)[None],
        }


class TapNext(Tapir):
    """Answers as `TAPNext.forward` does, a frame at a time and onwards only."""

    def __init__(self, image_size: tuple[int, int]) -> None:
        self.side = image_size[0]

    def __call__(self, video: torch.Tensor, query_points: Any = None, state: Any = None) -> Any:
        assert video.shape == (1, 1, self.side, self.side, 3)
        assert -1 <= video.min() < 0 < video.max() <= 1
        shown = [*state.shown, video] if state else [video]
        points = state.points if state else query_points
        begin, xy = points[0, :, 0], in_clip(points[0, :, 1:], self.side)
        step = torch.tensor(len(shown) - 1)
        # The clip grows lighter: one that grows darker is played backwards, and then everything moves the other way.
        way = -1 if len(shown) > 1 and shown[1].mean() < shown[0].mean() else 1
        true = place(way * step, way * begin, xy)
        true[step < begin] = -100
        logits = torch.where(hidden(way * step, way * begin), -2.0, 2.0)
        logits[step < begin] = 2.0
        after = SimpleNamespace(shown=shown, points=points)
        return in_raster(true, self.side).flip(-1)[None, None], None, logits[None, None, :, None], after


class Sam:
    """Model and processor in one, as those of Transformers' SAM 2: each object is 9 pixels about its first point, which
    move."""

    def from_pretrained(self, name: str) -> Sam:
        assert name.startswith("facebook/sam2")
        return self

    def to(self, device: str) -> Sam:
        return self

    def init_video_session(self, video: list[np.ndarray], inference_device: str) -> SimpleNamespace:
        assert inference_device == "cpu"
        height, width, _ = video[0].shape
        return SimpleNamespace(count=len(video), video_height=height, video_width=width)

    def add_inputs_to_inference_session(self, inference_session: SimpleNamespace, **given: Any) -> None:
        [objects], [labels] = given["input_points"], given["input_labels"]
        assert given["frame_idx"] == 0
        assert len(given["obj_ids"]) == len(objects) == len(labels)
        assert [len(points) for points in objects] == [len(each) for each in labels]
        inference_session.objects = [points[0] for points in objects]

    def __call__(self, inference_session: SimpleNamespace, frame_idx: int) -> None:
        inference_session.begun = frame_idx == 0

    def propagate_in_video_iterator(self, session: SimpleNamespace) -> Iterator[SimpleNamespace]:
        assert session.begun
        for frame in range(session.count):
            yield SimpleNamespace(frame_idx=frame, pred_masks=(frame, session))

    def post_process_masks(self, masks: list[Any], original_sizes: list[list[int]]) -> list[torch.Tensor]:
        [(frame, session)], [(height, width)] = masks, original_sizes
        found = torch.zeros(len(session.objects), 1, height, width, dtype=torch.bool)
        for number, (x, y) in enumerate(session.objects):
            found[number, 0, y - 1 : y + 2, x - 1 + frame : x + 2 + frame] = True
        return [found]


def module(name: str, **content: Any) -> ModuleType:
    made = ModuleType(name)
    made.__dict__.update(content)
    return made


@pytest.fixture
def trackers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def load(repository: str, name: str) -> CoTracker:
        assert (repository, name) == ("facebookresearch/co-tracker", "cotracker3_offline")
        return CoTracker()

    monkeypatch.setattr(torch.hub, "load", load)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    model = module("tapnet.torch.tapir_model", TAPIR=Tapir)
    utilities = {"restore_model_from_jax_checkpoint": lambda model, path: model}
    for made in (
        module("tapnet"),
        module("tapnet.torch", tapir_model=model),
        model,
        module("tapnet.tapnext"),
        module("tapnet.tapnext.tapnext_torch", TAPNext=TapNext),
        module("tapnet.tapnext.tapnext_torch_utils", **utilities),
    ):
        monkeypatch.setitem(sys.modules, made.__name__, made)
    monkeypatch.chdir(tmp_path)
    torch.save({}, "bootstapir_checkpoint_v2.pt")


@pytest.fixture
def sam(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    stand_in = module("transformers", Sam2VideoModel=Sam(), Sam2VideoProcessor=Sam())
    monkeypatch.setitem(sys.modules, "transformers", stand_in)
    monkeypatch.chdir(tmp_path)


def clip_of(frames: int) -> Clip:
    """A clip in the folder `clip` whose frames grow lighter."""
    texture = np.random.default_rng(0).integers(0, 180, (HEIGHT, WIDTH, 3))
    shown = (texture + np.linspace(0, 70, frames)[:, None, None, None]).astype(np.uint8)
    write_images(Path("clip"), [f"{index:05}.png" for index in range(frames)], shown)
    return read_clip("clip")


def execute(title: str, code: str, out: str) -> None:
    """As a script that is given the clip and where to write."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["script.py", "clip", out])
        exec(compile(code, title, "exec"), {"__name__": "__main__"})


def run(title: str, across: int, starts: int) -> dict[str, Any]:
    """What the section's script saves of the clip, in `tracks.npz`, on a small grid, three points at a time."""
    execute(title, script(title, "ACROSS, STARTS, CHUNK", f"{across}, {starts}, 3"), "tracks.npz")
    with np.load("tracks.npz") as content:
        return dict(content)


def truth(frames: int, across: int, starts: int) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) [N, T, 2] in pixels of the clip, and which are hidden."""
    step = WIDTH / across
    asked = torch.tensor(
        [
            [begin, column * step + step / 2, row * step + step / 2]
            for begin in sorted({round(index * (frames - 1) / (starts - 1)) for index in range(starts)})
            for row in range(int(np.ceil((HEIGHT - step / 2) / step)))
            for column in range(across)
        ]
    )
    frame, begin = torch.arange(frames), asked[:, :1]
    return place(frame, begin, asked[:, None, 1:] - 0.5).numpy(), hidden(frame, begin).numpy()


def seen_inside(xy: np.ndarray, occluded: np.ndarray) -> np.ndarray:
    return ~occluded & ((xy >= -0.5) & (xy <= np.array([WIDTH, HEIGHT]) - 0.5)).all(axis=-1)


@pytest.mark.usefixtures("trackers")
@pytest.mark.parametrize(("frames", "across", "starts"), GRIDS)
@pytest.mark.parametrize("title", TRACKERS)
def test_what_the_page_s_script_saves_is_read_exactly(title: str, frames: int, across: int, starts: int):
    clip = clip_of(frames)
    content = run(title, across, starts)
    xy, occluded = truth(frames, across, starts)
    assert (len(xy) == frames) == (frames == 6)
    tracks = read_tracks("tracks.npz", clip)
    np.testing.assert_allclose(tracks.xy, xy, atol=1e-4)  # float32 in a raster of 256
    np.testing.assert_array_equal(tracks.confidence, seen_inside(xy, occluded))
    names = (
        {"pred_tracks", "pred_visibility"} if title == "CoTracker3" else {"query_points", "tracks", "width", "height"}
    )
    assert names <= set(content)


@pytest.mark.usefixtures("trackers")
@pytest.mark.parametrize("title", TRACKERS)
def test_they_are_links_of_the_pool(title: str):
    frames, across, starts = GRIDS[0]
    clip = clip_of(frames)
    run(title, across, starts)
    pool = prepare(clip, load("cpu", overrides=(*TINY_CPU, "data.tracks=tracks.npz")).data, progress=False)
    xy, occluded = truth(frames, across, starts)
    seen = seen_inside(xy, occluded).T
    for begin in range(frames):
        sure = pool.confidence[begin, :, -len(xy) :]
        np.testing.assert_array_equal(sure, 255 * (seen[begin] & seen))
        links = pool.targets[begin, :, -len(xy) :]
        np.testing.assert_allclose(links[seen], xy.swapaxes(0, 1)[seen], atol=2e-3)  # targets are stored in 16 bits


@pytest.mark.usefixtures("trackers")
def test_cotracker_s_own_grid_has_no_queries():
    """As many tracks as frames: its layout alone says which axis is which."""
    clip = clip_of(6)
    content = run("CoTracker3", *GRIDS[1][1:])
    del content["queries"]
    np.savez("tracks.npz", **content)
    np.testing.assert_allclose(read_tracks("tracks.npz", clip).xy, truth(*GRIDS[1])[0], atol=1e-4)


@pytest.mark.usefixtures("trackers")
@pytest.mark.parametrize("title", TRACKERS)
def test_as_many_tracks_as_frames_the_other_way_round_are_refused(title: str):
    """The names say which axis is which: nothing is guessed."""
    clip = clip_of(6)
    content = run(title, *GRIDS[1][1:])
    points = 2 if title == "CoTracker3" else 1
    for name, array in content.items():
        if array.ndim > 2:
            content[name] = np.roll(array, 1, points).swapaxes(1, 2)
        elif array.ndim == 2:  # rolled, so that no track begins on the diagonal, which both ways share
            content[name] = np.roll(array, 1, 0)
    np.savez("tracks.npz", **content)
    with pytest.raises(SupervisionError, match="from their own queries"):
        read_tracks("tracks.npz", clip)


@pytest.mark.usefixtures("trackers")
def test_pixels_of_frames_of_a_size_that_the_file_names():
    """Of CoTracker's and our layout, whose pixel centres lie at integers."""
    clip, (xy, _) = clip_of(7), truth(*GRIDS[0])
    doubled = 2 * (xy + 0.5) - 0.5
    layouts: tuple[dict[str, Any], ...] = (
        {"tracks": doubled, "occluded": np.zeros(xy.shape[:2], bool)},
        {"pred_tracks": doubled.swapaxes(0, 1), "pred_visibility": np.ones(xy.shape[1::-1])},
    )
    for content in layouts:
        np.savez("tracks.npz", **content, width=2 * WIDTH, height=2 * HEIGHT)
        np.testing.assert_allclose(read_tracks("tracks.npz", clip).xy, xy, atol=1e-4)


@pytest.mark.usefixtures("trackers")
@pytest.mark.parametrize(
    ("title", "change", "message"),
    [
        ("TAPNext", {"width": None, "height": None}, "does not say of which size the frames were that the tracker saw"),
        ("TAPNext", {"width": None}, "must hold both width and height, as positive numbers, or neither"),
        ("TAPNext", {"width": 0}, "must hold both width and height, as positive numbers, or neither"),
        ("TAPNext", {"tracks": "exchanged"}, "from their own queries"),
        ("TAPNext", {"visibles": None}, "lacks the key occluded of its layout"),
        ("TAPNext", {"visibles": np.full((1, 8, 7), 2.5)}, "must hold true or false as visibles"),
        ("CoTracker3", {"pred_tracks": None}, "lacks the key pred_tracks of its layout"),
        ("CoTracker3", {"pred_tracks": "exchanged"}, "from their own queries"),
        ("CoTracker3", {"pred_tracks": np.zeros((1, 5, 12, 2))}, "it must be .N, T, 2. with the clip's T = 7 frames"),
        ("CoTracker3", {"pred_visibility": np.full((1, 7, 12), np.nan)}, "must hold finite numbers as pred_visibility"),
    ],
)
def test_what_does_not_fit_is_refused(title: str, change: dict[str, Any], message: str):
    clip = clip_of(7)
    content = run(title, *GRIDS[0][1:])
    for name, value in change.items():
        content[name] = content[name][..., ::-1] if isinstance(value, str) else value
    np.savez("tracks.npz", **{name: value for name, value in content.items() if value is not None})
    with pytest.raises(SupervisionError, match=message):
        read_tracks("tracks.npz", clip)


@pytest.mark.usefixtures("sam")
def test_masks_of_sam_are_what_its_objects_hold_together():
    clip = clip_of(5)
    objects = [[[10, 6], [11, 6]], [[30, 20]]]
    title = "Masks from SAM 2"
    execute(title, script(title, "OBJECTS", str(objects)), "masks")
    masks = np.stack(list(read_masks(Path("masks"), len(clip), HEIGHT, WIDTH)))
    expected = np.zeros((5, HEIGHT, WIDTH), bool)
    for frame in range(5):
        for x, y in ((10, 6), (30, 20)):
            expected[frame, y - 1 : y + 2, x - 1 + frame : x + 2 + frame] = True
    np.testing.assert_array_equal(masks, expected)
