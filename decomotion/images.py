"""Pictures as PNG and JPEG files."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

_ORDERS = {3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}


def png(image: npt.NDArray[np.uint8]) -> bytes:
    """The file of a picture: grey [H, W], RGB [H, W, 3] or RGBA [H, W, 4]."""
    return _encoded(".png", image, ())


def jpeg(image: npt.NDArray[np.uint8], quality: int, full_colour: bool = False) -> bytes:
    """The file of a picture RGB [H, W, 3]; `quality` from 1 to 100, `full_colour` as fine as brightness (4:4:4)."""
    sampling = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444) if full_colour else ()
    return _encoded(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, quality, *sampling))


def _encoded(suffix: str, image: npt.NDArray[np.uint8], options: Sequence[int]) -> bytes:
    ordered = image if image.ndim == 2 else cv2.cvtColor(image, _ORDERS[image.shape[2]])
    done, encoded = cv2.imencode(suffix, ordered, list(options))
    if not done:
        raise OSError(f"OpenCV could not encode a picture of {image.shape} as {suffix}")
    return encoded.tobytes()
