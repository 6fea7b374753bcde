"""Files of torch.save, read without it: the same tensors, and nothing executed."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch._utils import _rebuild_tensor_v2

from dataset_files import repacked
from decomo_eval.errors import DatasetError, UnsafePickleError
from decomo_eval.safe_torch import load_tensors

TYPES = [torch.float32, torch.float64, torch.float16, torch.bool, torch.uint8, torch.int8, torch.int16, torch.int32]
TYPES += [torch.int64]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "a.pth"


@pytest.mark.parametrize("dtype", TYPES)
def test_tensors_come_back(dtype: torch.dtype, file: Path) -> None:
    whole = torch.arange(-3, 21).reshape(2, 3, 4).to(dtype)
    views = {"whole": whole, "turned": whole.permute(2, 0, 1), "part": whole[1, 1:, ::2], "one": whole[1, 2, 3]}
    views["none"] = whole[:0]
    torch.save({**views, "other": [1, {"a": None}]}, file)
    found = load_tensors(file, [*views, "absent"])
    assert list(found) == list(views)
    for key, view in views.items():
        np.testing.assert_array_equal(found[key], view.numpy(), strict=True)


def test_tensors_of_another_byte_order(file: Path) -> None:
    values = np.arange(5.0)
    torch.save({"a": torch.from_numpy(values)}, file)
    file.write_bytes(repacked(file, {"/byteorder": b"big", "/data/0": values.astype(">f8").tobytes()}))
    np.testing.assert_array_equal(load_tensors(file, ["a"])["a"], values)


def test_tensors_of_older_releases_have_no_byte_order(file: Path) -> None:
    torch.save({"a": torch.arange(3)}, file)
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist() if "byteorder" not in name}
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    assert load_tensors(file, ["a"])["a"].tolist() == [0, 1, 2]


class Named:
    """Pickled as a call of something."""

    def __init__(self, call: Any, *arguments: Any) -> None:
        self.call = call, arguments

    def __reduce__(self) -> Any:
        return self.call


@pytest.mark.parametrize(
    "content",
    [Named(eval, "print(1)"), {"a": Named(eval, "1")}, {"a": torch.nn.Linear(2, 2)}, {"a": torch.Size([2])}],
)
def test_what_names_anything_else_is_refused(content: Any, file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torch.save(content, file)
    with pytest.raises(UnsafePickleError, match="nothing in it executed"):
        load_tensors(file, ["a"])
    assert not capsys.readouterr().out


STORAGE = pickle.GLOBAL + b"torch FloatStorage\n".replace(b" ", b"\n")


@pytest.mark.parametrize(
    "program",
    [
        STORAGE + pickle.EMPTY_TUPLE + pickle.REDUCE,
        STORAGE + pickle.EMPTY_DICT + pickle.BUILD,
        pickle.MARK + pickle.UNICODE + b"storage\n" + STORAGE + pickle.UNICODE + b"0\n" + pickle.UNICODE + b"cpu\n"
        + pickle.INT + b"3\n" + pickle.TUPLE + pickle.BINPERSID + pickle.EMPTY_DICT + pickle.BUILD,
    ],
)  # fmt: skip
def test_what_changes_or_calls_storages_is_refused(program: bytes, file: Path) -> None:
    torch.save({"a": torch.zeros(3)}, file)
    file.write_bytes(repacked(file, {"/data.pkl": pickle.PROTO + b"\x02" + program + pickle.STOP}))
    with pytest.raises(UnsafePickleError):
        load_tensors(file, ["a"])


def tensor(shape: Any, strides: Any, offset: Any = 0, length: Any = 6, key: Any = "0") -> bytes:
    """A program that describes one."""

    class Pickler(pickle.Pickler):
        def persistent_id(self, obj: Any) -> Any:
            return ("storage", torch.FloatStorage, key, "cpu", length) if obj is storage else None

    storage, content = object(), io.BytesIO()
    Pickler(content, 2).dump({"a": Named(_rebuild_tensor_v2, storage, offset, shape, strides, False, {})})
    return content.getvalue()


@pytest.mark.parametrize(
    "program",
    [
        tensor((2, 3), (3, 1), 1),
        tensor((7,), (1,)),
        tensor((2**40,), (0,)),  # one value as often as that
        tensor((2,) * 70, (0,) * 70, 0),
    ],
)
def test_a_tensor_that_is_larger_than_its_storage_is_refused(program: bytes, file: Path) -> None:
    torch.save({"a": torch.arange(6.0)}, file)
    file.write_bytes(repacked(file, {"/data.pkl": program}))
    with pytest.raises(DatasetError, match="is larger than its storage"):
        load_tensors(file, ["a"])


@pytest.mark.parametrize(
    "program",
    [
        tensor((2,), (-1,), 3),
        tensor((2,), (1,), -1),
        tensor((2.0,), (1,)),
        tensor((2, 3), (3,)),
        tensor([2], [1]),
        tensor((2,), (1,), 0, 2**40),
        tensor((2,), (1,), 0, "6"),
        tensor((2,), (1,), key="9"),
        tensor((2,), (1,), key=b"0"),
        tensor((2,) * 70, (0,) * 70, 0, 2**80),
    ],
)
def test_a_tensor_that_is_not_in_the_file_is_refused(program: bytes, file: Path) -> None:
    torch.save({"a": torch.arange(6.0)}, file)
    file.write_bytes(repacked(file, {"/data.pkl": program}))
    with pytest.raises(DatasetError, match="is not readable as a dict of tensors, saved by torch"):
        load_tensors(file, ["a"])


@pytest.mark.parametrize("content", [[torch.zeros(2)], {"a": 3}, torch.zeros(2)])
def test_what_is_no_dict_of_tensors_is_refused(content: Any, file: Path) -> None:
    torch.save(content, file)
    with pytest.raises(DatasetError, match="a dict of tensors"):
        load_tensors(file, ["a"])


def test_files_of_other_kinds(file: Path) -> None:
    with pytest.raises(DatasetError, match=r"cannot be opened \(No such file"):
        load_tensors(file, ["a"])
    torch.save({"a": torch.zeros(2)}, file)
    file.write_bytes(repacked(file, {}, zipfile.ZIP_DEFLATED))
    with pytest.raises(DatasetError, match="is compressed"):
        load_tensors(file, ["a"])
    torch.save({"a": torch.zeros(2)}, file, _use_new_zipfile_serialization=False)
    with pytest.raises(DatasetError, match="saved by torch"):
        load_tensors(file, ["a"])
    with zipfile.ZipFile(file, "w"):
        pass
    with pytest.raises(DatasetError, match="saved by torch"):
        load_tensors(file, ["a"])
