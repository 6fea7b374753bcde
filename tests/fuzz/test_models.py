"""Model files: .onnx of ours, damaged and with strange metadata, and checkpoints."""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path
from typing import Any

import onnx
import onnx.helper
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from decomo_runtime import ModelFacts, contract
from decomo_runtime.errors import ModelFileError
from decomo_runtime.model_file import open_session, read_facts
from decomotion import checkpoint
from decomotion.checkpoint import Checkpoint, ClipFacts
from decomotion.config import load as load_config
from decomotion.errors import CheckpointError
from near_misses import EXTREMES, answer, any_or_near, forged_zip, near_tree
from tiny_fit import TINY_CPU, sliding_square, tiny_model
from tiny_model import write_tiny_model

SIZE = {"num_frames": 6, "height": 40, "width": 48}
KEYS = sorted(value for name, value in vars(contract).items() if name.startswith("META_"))
TEXTS = (
    *("", " ", "nan", "inf", "-inf", "-1", "0", "-0.0", "0.5", "1e400", "1e-320", "1e30", "six", "6.0", "1_0", "0x10"),
    *("9" * 30, "9" * 5000, "-" + "9" * 5000, "٣", "6\n7", "\0", "6 ", "true", "[6]", "2147483648", "16777217"),
)


def read(file: Path) -> ModelFacts:
    return read_facts(open_session(file, threads=1), file)


def check_facts(facts: ModelFacts | None) -> None:
    if facts is not None:
        numbers = (facts.num_frames, facts.height, facts.width, facts.bytes_per_ray, facts.bytes_per_rendered_ray)
        assert all(isinstance(number, int) and number >= 1 for number in numbers)
        assert max(numbers[:3]) <= 2**24  # float32 holds every whole number up to there, and queries are float32
        assert 0 < facts.fps < math.inf
        assert 0 <= facts.occlusion_threshold <= 1
        assert 0 <= facts.object_share < 1


@given(changes=st.dictionaries(st.sampled_from(KEYS), st.none() | st.sampled_from(TEXTS) | st.text(), max_size=3))
def test_metadata(place: Path, changes: dict[str, str | None]):
    file = place / "model.onnx"
    write_tiny_model(file, **SIZE, metadata=changes)
    check_facts(answer(lambda: read(file), ModelFileError))


@pytest.mark.parametrize("key", [contract.META_NUM_FRAMES, contract.META_HEIGHT, contract.META_WIDTH])
def test_numbers_that_queries_cannot_hold(place: Path, key: str):
    file = place / "model.onnx"
    write_tiny_model(file, **SIZE, metadata={key: str(2**24)})
    check_facts(read(file))
    write_tiny_model(file, **SIZE, metadata={key: str(2**24 + 1)})
    with pytest.raises(ModelFileError, match="impossible metadata"):
        read(file)


@given(data=st.data())
def test_onnx(place: Path, data: st.DataObject):
    file = place / "model.onnx"
    write_tiny_model(file, **SIZE)
    content = data.draw(any_or_near(file.read_bytes()))
    file.write_bytes(content)
    check_facts(answer(lambda: read(file), ModelFileError))


FOREIGN = """
<ir_version: 9, opset_import: ["" : 18]>
other (float[N,3] queries, int64[M] frames) => (float[N,3] tracks) <int64[1] size = {SIZE}> { BODY }
"""


@pytest.mark.parametrize(
    "body",
    [
        "tracks = Identity(queries)",
        "tracks = Unknown(queries)",
        "big = ConstantOfShape(size) sum = ReduceSum(big) tracks = Add(queries, sum)",
    ],
)
@pytest.mark.parametrize("size", ["1", "-1", "30000000000"])
def test_other_graphs(place: Path, body: str, size: str):
    model = onnx.parser.parse_model(FOREIGN.replace("BODY", body).replace("SIZE", size))
    onnx.helper.set_model_props(model, {contract.META_FORMAT_VERSION: "1"})
    onnx.save(model, place / "model.onnx")
    assert answer(lambda: read(place / "model.onnx"), ModelFileError) is None


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A checkpoint."""
    file = tmp_path_factory.mktemp("run") / checkpoint.FILE_NAME
    start = torch.eye(3, 4).repeat(8, 1, 1)
    model = tiny_model("cpu", frames=8, height=32, width=32, start=start)
    training = {"step": 7, "seed": 3, "errors": torch.arange(6.0)}
    checkpoint.save(file, load_config("cpu", overrides=TINY_CPU), ClipFacts.of(sliding_square()), model, training)
    return file.read_bytes()


@pytest.fixture(scope="module")
def content(whole: bytes) -> dict[str, Any]:
    """What is in it."""
    content = torch.load(io.BytesIO(whole), weights_only=True)
    return {**content, "model": dict(content["model"])}


def check_checkpoint(found: Checkpoint | None) -> None:
    if found is not None:
        clip = found.clip
        assert (found.model.plane.height, found.model.plane.width) == (clip.height, clip.width)
        assert isinstance(found.training, dict)


@given(data=st.data())
def test_checkpoint(place: Path, whole: bytes, data: st.DataObject):
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    content = data.draw(st.one_of(any_or_near(whole), forged_zip(members)))
    (place / "checkpoint.pt").write_bytes(content)
    check_checkpoint(answer(lambda: checkpoint.load(place / "checkpoint.pt"), CheckpointError))


@pytest.mark.parametrize("fact", ["num_frames", "height", "width", "fps"])
@pytest.mark.parametrize("value", ["many", 0, -1, 10**12])
def test_a_checkpoint_of_no_clip(place: Path, content: dict[str, Any], fact: str, value: Any):
    torch.save({**content, "clip": {**content["clip"], fact: value}}, place / "checkpoint.pt")
    found = answer(lambda: checkpoint.load(place / "checkpoint.pt"), CheckpointError)
    assert found is None or (value == 10**12 and fact != "num_frames")


@pytest.mark.parametrize("part", ["config", "clip", "model", "training", "feature_size"])
def test_a_checkpoint_without_a_part(place: Path, content: dict[str, Any], part: str):
    torch.save({**content, part: None}, place / "checkpoint.pt")
    assert answer(lambda: checkpoint.load(place / "checkpoint.pt"), CheckpointError) is None


HUGE = st.sampled_from(
    [*EXTREMES, 10**6, 10**9, 10**12, float("nan"), float("inf"), "a\nb", None, [], {}, torch.zeros(2)]
)


@given(data=st.data())
def test_content_of_checkpoints(place: Path, content: dict[str, Any], data: st.DataObject):
    torch.save(data.draw(near_tree(content, HUGE)), place / "checkpoint.pt")
    check_checkpoint(answer(lambda: checkpoint.load(place / "checkpoint.pt"), CheckpointError))
