"""What stands out in a picture, by IS-Net (Qin et al. 2022), which was trained on outlines with thin parts.

The network is an ONNX file: `isnet-general-use.onnx`, as the library rembg publishes it, or the user's. It knows
nothing of motion; `outlines.py` asks it about what moves.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import onnxruntime
import torch

from decomotion.data.weights import downloaded
from decomotion.errors import SupervisionError

NAME = "isnet-general-use.onnx"
URL = f"https://github.com/danielgatis/rembg/releases/download/v0.0.0/{NAME}"
MD5 = "fc16ebd8b0c10d971d3513d564d01e29"


class Isnet:
    """The network.

    Args:
        weights: its file; None: its publisher's, by download.
        device: where it runs: on a GPU where onnxruntime is built for one.

    Raises `SupervisionError` where the file is none, `DownloadError` where the download fails.
    """

    def __init__(self, weights: str | None = None, device: str = "cpu") -> None:
        file = file_of(weights)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        options.enable_cpu_mem_arena = False  # it would keep gigabytes
        options.log_severity_level = 3
        wanted = ["CUDAExecutionProvider"] * device.startswith("cuda") + ["CPUExecutionProvider"]
        providers = [each for each in wanted if each in onnxruntime.get_available_providers()]
        try:
            self._session = onnxruntime.InferenceSession(str(file), options, providers=providers)
            (what,) = self._session.get_inputs()
            batch, channels, *self._sides = what.shape
        except Exception as error:  # onnxruntime raises what damaged content brings it to
            raise SupervisionError(_refused(file)) from error
        if (batch, channels, what.type) != (1, 3, "tensor(float)") or not all(isinstance(n, int) for n in self._sides):
            raise SupervisionError(_refused(file))
        self._input, self._output = what.name, self._session.get_outputs()[0].name

    def __call__(self, picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        """How much each pixel of a picture [h, w, 3], RGB, belongs to what stands out in it: [h, w] in [0, 1]."""
        height, width = self._sides
        enlarged = cv2.resize(picture, (width, height), interpolation=cv2.INTER_CUBIC)
        values = (enlarged.astype(np.float32) / 255 - 0.5).transpose(2, 0, 1)[None]
        found = np.asarray(self._session.run([self._output], {self._input: values})[0], np.float32)
        return cv2.resize(found[0, 0], picture.shape[1::-1], interpolation=cv2.INTER_AREA)


def file_of(weights: str | None) -> Path:
    """The network's file: the user's, or the publisher's, which is downloaded where it is not there yet.

    Raises as `Isnet`.
    """
    if weights is not None:
        if not Path(weights).is_file():
            raise SupervisionError(f"--masks {weights} does not exist; give the file of IS-Net, {NAME}")
        return Path(weights)
    return downloaded(_from_publisher, "IS-Net", f"give its file with --masks {NAME}")


def _from_publisher() -> Path:
    """In the folder of torch's hub, where kornia keeps its weights."""
    file = Path(torch.hub.get_dir()) / "checkpoints" / NAME
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        torch.hub.download_url_to_file(URL, str(file))
        if hashlib.md5(file.read_bytes(), usedforsecurity=False).hexdigest() != MD5:
            file.unlink()
            raise RuntimeError(f"{URL} is not the file that it was")
    return file


def _refused(file: Path) -> str:
    return (
        f"--masks {file} is not an ONNX file of IS-Net, or is damaged: an image [1, 3, h, w] goes in, a mask comes "
        f"out; give {NAME}"
    )
