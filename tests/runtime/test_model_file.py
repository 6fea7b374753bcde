from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

from decomo_runtime import ModelFileError, SessionError, Tracker, contract
from decomo_runtime.model_file import open_session
from decomotion.quality import Figures, GapFigures, Quality

WriteModel = Callable[..., Path]
OPTIONAL = (
    contract.META_OBJECT_SHARE,
    contract.META_FORMAT_VERSION,  # without it the file is not ours
    contract.META_WRITER_VERSION,
    contract.META_BYTES_PER_RAY,
    contract.META_BYTES_PER_RENDERED_RAY,
    contract.META_BAKE,
    contract.META_PRECISION,
    contract.META_DEVIATION,
    contract.META_TIMES,
    contract.META_PIXEL_ASPECT,
    contract.META_QUALITY,
    contract.META_FITTED_BY,
    contract.META_STEPS,
    contract.META_BUDGET,
    contract.META_LICENCE,
)


def refusal(path: Path) -> str:
    """The sentence with which `path` is refused."""
    with pytest.raises(ModelFileError) as caught:
        Tracker(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


def test_facts(tracker: Tracker):
    assert (tracker.num_frames, tracker.height, tracker.width) == (6, 40, 48)
    assert (tracker.fps, tracker.clip_name, tracker.preset) == (12.5, "slide", "cpu")
    assert tracker.occlusion_threshold == 0.5
    assert tracker.pixel_aspect == 1
    np.testing.assert_array_equal(tracker.times, np.arange(6) / 12.5)


def test_facts_of_an_unusual_clip(write_model: WriteModel):
    times = [0, 0.033, 0.067, 0.5, 0.6, 2]
    path = write_model({contract.META_TIMES: str(times), contract.META_PIXEL_ASPECT: repr(16 / 11)})
    tracker = Tracker(path, providers="CPUExecutionProvider")
    np.testing.assert_array_equal(tracker.times, times)
    assert tracker.pixel_aspect == 16 / 11
    np.testing.assert_array_equal(tracker.track([(0, 3, 4)]).times, times)
    np.testing.assert_array_equal(tracker.track([(0, 3, 4)], [4, 1]).times, [0.6, 0.033])


@pytest.mark.parametrize(
    "text",
    [
        *("", "{}", "7", "null", "[" * 9999),
        *(
            "[]",
            "[0, 1, 2]",
            "[0, 1, 2, 3, 4, 4]",
            "[1, 2, 3, 4, 5, 6]",
            "[0, 1, 2, 3, 4, NaN]",
            "[0, 1, 2, 3, 4, 1e999]",
        ),
        *('["a", 1, 2, 3, 4, 5]', "[[0], [1], [2], [3], [4], [5]]", "[[0], 1, 2, 3, 4, 5]"),
    ],
)
def test_times_that_are_none(write_model: WriteModel, text: str):
    said = refusal(write_model({contract.META_TIMES: text}))
    assert "it must be a list of 6 rising seconds from 0; export the model again" in said


FIGURES = Figures(900, 0.3, 2.0, 0.05, 0.31, 0.8, 0.9, 0.95, 0.1)
QUALITY = Quality(700, None, FIGURES, FIGURES, None, (GapFigures(1, 1, FIGURES),))


def test_how_good_the_fit_is(write_model: WriteModel, tracker: Tracker):
    assert Tracker(write_model({contract.META_QUALITY: QUALITY.as_json()}), threads=1).quality == QUALITY
    assert tracker.quality is None


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "Expecting value"),
        ("[" * 9999, "nested too deeply"),
        ("{}", "no thinned"),
        (QUALITY.as_json()[:-2], "Expecting"),
        (QUALITY.as_json().replace("0.95", "1.95"), "shares that are none"),
        (QUALITY.as_json().replace("0.3,", "NaN,"), "median = nan"),
    ],
)
def test_figures_that_are_none(write_model: WriteModel, text: str, named: str):
    said = refusal(write_model({contract.META_QUALITY: text}))
    assert "impossible metadata decomotion.quality (" in said
    assert f"{named}" in said


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "16:11"])
def test_a_pixel_aspect_that_is_none(write_model: WriteModel, text: str):
    assert "impossible metadata decomotion.pixel_aspect" in refusal(write_model({contract.META_PIXEL_ASPECT: text}))


def test_missing(tmp_path: Path):
    assert "does not exist; write one with 'decomo-export'" in refusal(tmp_path / "no.onnx")


def test_folder(tmp_path: Path):
    assert "is a folder" in refusal(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_unreadable(model_path: Path):
    model_path.chmod(0)
    assert "cannot be read (Permission denied)" in refusal(model_path)


@pytest.mark.parametrize("content", [b"just some text\n", b"t,x,y\n0,1,2\n", bytes(1000), b"\x89PNG\r\n"])
def test_not_onnx(tmp_path: Path, content: bytes):
    path = tmp_path / "other.onnx"
    path.write_bytes(content)
    assert "is not an ONNX file, or it is damaged or cut short" in refusal(path)


def test_empty(tmp_path: Path):
    (tmp_path / "empty.onnx").touch()
    assert "is empty; copy it again" in refusal(tmp_path / "empty.onnx")


def test_every_truncation_is_refused(model_path: Path):
    """Cut in the graph the file does not parse; cut between graph and metadata it parses and is not ours."""
    content = model_path.read_bytes()
    for length in range(0, len(content), 97):
        model_path.write_bytes(content[:length])
        refusal(model_path)


def test_foreign_onnx(write_model: WriteModel):
    path = write_model({contract.META_FORMAT_VERSION: None})
    assert "is an ONNX file but holds no decomotion model; write one with 'decomo-export'" in refusal(path)


def test_newer_format(write_model: WriteModel):
    newer = str(contract.FORMAT_VERSION + 1)
    text = refusal(write_model({contract.META_FORMAT_VERSION: newer}))
    assert f"has format version {newer} but this decomotion reads up to {contract.FORMAT_VERSION}" in text
    assert "pip install -U decomotion" in text


def test_files_of_an_earlier_version_answer(write_model: WriteModel):
    """They knew less metadata, and one had an optional input; all outputs were computed always."""
    older = {key: None for key in OPTIONAL if key != contract.META_FORMAT_VERSION}
    optional_input = {"int64[M] frames)": "int64[M] frames, bool appearance = {1})"}
    for rename in ({}, optional_input):
        path = write_model(older, rename=rename)
        tracker = Tracker(path, threads=1)
        tracks = tracker.track([(1, 3, 4)], [0, 3])
        np.testing.assert_allclose(tracks.xy[0], [(1.5, 4.5), (6, 3)], atol=1e-5)  # float32 at tens of pixels
        np.testing.assert_allclose(tracker.sample([(2, 3, 4)]).depth, [0.5], atol=1e-6)
        assert tracker.facts.bytes_per_ray > 0


@pytest.mark.parametrize(("of_track", "rendered"), [("1024", 16384), ("65536", 65536)])
def test_a_ray_of_an_earlier_file_takes_no_less_than_a_query(write_model: WriteModel, of_track: str, rendered: int):
    facts = Tracker(write_model({contract.META_BYTES_PER_RAY: of_track})).facts
    assert (facts.bytes_per_ray, facts.bytes_per_rendered_ray) == (int(of_track), rendered)


def test_operators_that_this_onnxruntime_lacks(write_model: WriteModel):
    text = refusal(write_model(opset=999))
    assert "pip install -U onnxruntime" in text


def test_operators_that_no_onnxruntime_has(write_model: WriteModel):
    assert "(Error No Op registered for Frobnicate" in refusal(write_model(rename={"Abs": "Frobnicate"}))


@pytest.mark.parametrize(
    "key", [key for name, key in vars(contract).items() if name.startswith("META_") and key not in OPTIONAL]
)
def test_lacking_metadata(write_model: WriteModel, key: str):
    assert f"lacks the metadata {key}" in refusal(write_model({key: None}))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        (contract.META_FORMAT_VERSION, "one"),
        (contract.META_FORMAT_VERSION, "0"),
        (contract.META_NUM_FRAMES, "0"),
        (contract.META_HEIGHT, "-4"),
        (contract.META_WIDTH, "4.5"),
        (contract.META_FPS, "nan"),
        (contract.META_FPS, "0"),
        (contract.META_OCCLUSION_THRESHOLD, "1.5"),
        (contract.META_OCCLUSION_THRESHOLD, ""),
        (contract.META_OBJECT_SHARE, "1"),
        (contract.META_STEPS, "-1"),
        (contract.META_STEPS, "many"),
        (contract.META_BUDGET, "600"),
        (contract.META_BUDGET, "{"),
        (contract.META_BUDGET, '{"seconds": 600}'),
        (contract.META_BUDGET, '{"steps": 100, "seconds": -1}'),
        (contract.META_BUDGET, '{"steps": 100, "seconds": [1]}'),
        (contract.META_DEVIATION, "0.1"),
        (contract.META_DEVIATION, "0.1 nan"),
    ],
)
def test_impossible_metadata(write_model: WriteModel, key: str, value: str):
    assert f"has the impossible metadata {key} = {value!r}" in refusal(write_model({key: value}))


@pytest.mark.parametrize(("kind", "name"), [("input", "queries"), ("output", "depth")])
def test_other_names(write_model: WriteModel, kind: str, name: str):
    assert f"lacks the {kind} {name}" in refusal(write_model(rename={name: f"my_{name}"}))


@pytest.mark.parametrize("threads", [0, -1, 1.5, True, "2"])
def test_threads_must_be_a_positive_whole_number(model_path: Path, threads: Any):
    with pytest.raises(SessionError, match="threads must be a whole number of at least 1"):
        Tracker(model_path, threads=threads)


@pytest.mark.parametrize("provider", ["MoonExecutionProvider", ("MoonExecutionProvider", {"device_id": 0})])
def test_absent_provider(model_path: Path, provider: Any):
    with pytest.raises(SessionError, match=r"no provider 'MoonExecutionProvider'; choose from .*CPUExecutionProvider"):
        Tracker(model_path, providers=[provider])


def test_cuda_multiplies_exactly_unless_told_otherwise(model_path: Path, monkeypatch: pytest.MonkeyPatch):
    asked: list[Any] = []

    def session(path: str, options: Any, providers: Any) -> Any:
        asked.append(providers)
        raise RuntimeError("no GPU here")

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CUDAExecutionProvider"])
    monkeypatch.setattr(onnxruntime, "InferenceSession", session)
    own = {"device_id": 1, "use_tf32": "1"}
    for provider in ("CUDAExecutionProvider", ("CUDAExecutionProvider", own)):
        with pytest.raises(Exception, match="no GPU here"):
            open_session(model_path, [provider])
    assert asked == [[("CUDAExecutionProvider", {"use_tf32": "0"})], [("CUDAExecutionProvider", own)]]


def test_providers_and_options_pass_through(model_path: Path):
    for providers in (["CPUExecutionProvider"], [("CPUExecutionProvider", {})]):
        session = open_session(model_path, providers, 3)
        assert session.get_providers() == ["CPUExecutionProvider"]
        assert session.get_session_options().intra_op_num_threads == 3
