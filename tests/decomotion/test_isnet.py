"""IS-Net: what goes into the file and comes out of it, and files that are none."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch

from decomotion.data.masks import isnet
from decomotion.data.masks.isnet import Isnet, file_of
from decomotion.errors import DownloadError, SupervisionError
from tiny_isnet import write_network


def test_a_picture_is_brought_to_the_network_s_sides_and_the_mask_back(tmp_path: Path):
    """Red counts: a picture of 30x20 of which the right third is red, and in it a row that is not."""
    network = Isnet(str(write_network(tmp_path / "red.onnx", (1, 0, 0), 0.5, (1, 3, 60, 60))))
    picture = np.zeros((20, 30, 3), np.uint8)
    picture[..., 2] = 255
    picture[:, 20:] = (255, 0, 0)
    picture[6] = 0
    found = network(picture)
    assert (found.shape, found.dtype) == ((20, 30), np.float32)
    wanted = np.zeros((20, 30))
    wanted[:, 20:] = 1
    wanted[6] = 0
    inner = np.ones_like(wanted, np.bool_)
    inner[5:8], inner[:, 19:21] = False, False
    np.testing.assert_allclose(found[inner], wanted[inner], atol=1e-3)
    assert found[6, 25] < 0.3


def test_values_are_between_minus_and_plus_one_half(tmp_path: Path):
    """As IS-Net was trained: 51 of 255 is -0.3."""
    network = Isnet(str(write_network(tmp_path / "grey.onnx", (0, 1, 0), 0.5, (1, 3, 8, 8))))
    np.testing.assert_allclose(network(np.full((8, 8, 3), 51, np.uint8)), 0.2, atol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1, 8, 8), (2, 3, 8, 8), (1, 3, "h", "w")])
def test_another_network_is_refused(shape: tuple, tmp_path: Path):
    file = tmp_path / "other.onnx"
    if shape[1] == 3:
        write_network(file, shape=shape)
    else:
        file.write_bytes(b"\x08\x09")
    with pytest.raises(SupervisionError, match=r"other\.onnx is not an ONNX file of IS-Net, or is damaged: an image"):
        Isnet(str(file))


def test_a_file_that_is_not_there():
    with pytest.raises(SupervisionError, match=r"--masks nowhere\.onnx does not exist; give the file of IS-Net"):
        file_of("nowhere.onnx")


class TestDownload:
    """Of a stand-in for the publisher's file."""

    @pytest.fixture
    def hub(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
        monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
        monkeypatch.setattr(isnet, "MD5", hashlib.md5(b"network").hexdigest())
        return tmp_path / "checkpoints" / isnet.NAME

    def test_once(self, hub: Path, monkeypatch: pytest.MonkeyPatch):
        asked = []

        def download(url: str, file: str) -> None:
            asked.append(url)
            Path(file).write_bytes(b"network")

        monkeypatch.setattr(torch.hub, "download_url_to_file", download)
        assert file_of(None) == file_of(None) == hub
        assert asked == [isnet.URL]

    def test_another_file_than_it_was_is_not_kept(self, hub: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(torch.hub, "download_url_to_file", lambda _, file: Path(file).write_bytes(b"other"))
        with pytest.raises(DownloadError, match=r"IS-Net cannot be downloaded on this machine; give its file with"):
            file_of(None)
        assert not hub.exists()

    def test_without_a_network(self, hub: Path, monkeypatch: pytest.MonkeyPatch):
        def offline(*_: str) -> None:
            raise OSError("no route to host")

        monkeypatch.setattr(torch.hub, "download_url_to_file", offline)
        with pytest.raises(DownloadError, match=r"give its file with --masks isnet-general-use\.onnx"):
            file_of(None)
