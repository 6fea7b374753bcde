"""Files of weights: what they may be wrapped in, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from decomotion.data.weights import downloaded, read_state
from decomotion.errors import SupervisionError

WEIGHTS = {"layer.weight": torch.arange(6.0).reshape(2, 3), "layer.bias": torch.ones(2)}
PREFIXED = {f"module.{key}": value for key, value in WEIGHTS.items()}


def same(state: dict[str, torch.Tensor]) -> bool:
    return state.keys() == WEIGHTS.keys() and all(torch.equal(state[key], value) for key, value in WEIGHTS.items())


@pytest.mark.parametrize(
    "content",
    [
        WEIGHTS,
        PREFIXED,
        {"state_dict": WEIGHTS, "epoch": 3},
        {"model": PREFIXED},
        {"state_dict": {"model": WEIGHTS}},
    ],
    ids=["plain", "module", "state_dict", "model", "both"],
)
def test_a_state_dict_is_unwrapped(content: dict[str, Any], tmp_path: Path):
    torch.save(content, tmp_path / "weights.pth")
    assert same(read_state(tmp_path / "weights.pth", "--weights"))


def test_a_layer_may_be_called_model(tmp_path: Path):
    torch.save({"model": torch.ones(3)}, tmp_path / "weights.pth")
    assert read_state(tmp_path / "weights.pth", "--weights")["model"].tolist() == [1, 1, 1]


def test_safetensors(tmp_path: Path):
    from safetensors.torch import save_file

    save_file(PREFIXED, tmp_path / "weights.safetensors")
    assert same(read_state(tmp_path / "weights.safetensors", "--weights"))
    (tmp_path / "weights.safetensors").write_bytes(b"12345678901234567890")
    with pytest.raises(SupervisionError, match=r"--weights .*weights.safetensors is not a file of weights, or is dam"):
        read_state(tmp_path / "weights.safetensors", "--weights")


@pytest.mark.parametrize("content", [{}, [torch.zeros(2)], {"weight": 3.0}, {"model": {}}, {"model": {"epoch": 1}}])
def test_what_holds_no_state_dict_is_refused(content: object, tmp_path: Path):
    torch.save(content, tmp_path / "weights.pth")
    with pytest.raises(SupervisionError, match=r"--weights .* holds no state dict"):
        read_state(tmp_path / "weights.pth", "--weights")


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04 half a file"])
def test_damaged_files_are_refused(content: bytes, tmp_path: Path):
    (tmp_path / "weights.pth").write_bytes(content)
    with pytest.raises(SupervisionError, match=r"--weights .* is not a file of weights, or is damaged"):
        read_state(tmp_path / "weights.pth", "--weights")


@pytest.mark.parametrize("error", [OSError, RuntimeError])
def test_a_download_that_fails_says_what_to_do_instead(error: type[Exception]):
    def fail() -> int:
        raise error("no route")

    with pytest.raises(SupervisionError, match="the weights of RAFT cannot be downloaded on this machine; walk"):
        downloaded(fail, "RAFT", "walk")
    assert downloaded(lambda: 7, "RAFT", "walk") == 7


def test_another_failure_is_not_a_download_s():
    with pytest.raises(KeyError):
        downloaded(lambda: {}["name"], "RAFT", "walk")
