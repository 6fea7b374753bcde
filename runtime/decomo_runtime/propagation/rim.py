"""The rim of a soft mask brought to the edges of a picture: the guided filter of He, Sun and Tang (TPAMI 2013).

In every small window the mask is taken for a linear function of the colours. The function is found on a small raster
and applied to the picture at its own size (He and Sun, "Fast guided filter", 2015).
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]

RADIUS = 1 / 72
"""Of a window, as a share of the raster's longer side; a pixel of the small raster at least."""
SMOOTH = 1e-4
"""Variance of colours, in [0, 1], below which a window is flat."""


class Guide:
    """A picture as a guide.

    Args:
        small: float32 [h, w, 3] in [0, 1].
        full: the same at its own size [H, W, 3].
    """

    def __init__(self, small: Floats, full: Floats) -> None:
        self._small, self._full = small, full
        self._window = 2 * max(1, round(RADIUS * max(small.shape[:2]))) + 1
        self._mean = self._averaged(small)
        products = self._averaged((small[..., :, None] * small[..., None, :]).reshape(*small.shape[:2], 9))
        spread = products.reshape(*small.shape[:2], 3, 3) - self._mean[..., :, None] * self._mean[..., None, :]
        self._inverse = np.linalg.inv(spread + SMOOTH * np.eye(3, dtype=np.float32))

    def __call__(self, soft: Floats) -> Floats:
        """`soft` [h, w] in [0, 1] at the picture's own size, its rim on the picture's edges; [H, W] in [0, 1]."""
        mean = self._averaged(soft)
        together = self._averaged(self._small * soft[..., None]) - self._mean * mean[..., None]
        slope = (self._inverse @ together[..., None])[..., 0]
        offset = mean - (slope * self._mean).sum(axis=-1)
        height, width = self._full.shape[:2]
        line = cv2.resize(
            self._averaged(np.dstack([slope, offset]).astype(np.float32)),
            (width, height),
            interpolation=cv2.INTER_LINEAR,
        )
        return ((line[..., :3] * self._full).sum(axis=-1) + line[..., 3]).clip(0, 1).astype(np.float32)

    def _averaged(self, image: Floats) -> Floats:
        """The mean of each window; channel by channel, as OpenCV takes no more than four."""
        planes = np.moveaxis(image.reshape(*image.shape[:2], -1), -1, 0)
        means = [cv2.blur(np.ascontiguousarray(plane), (self._window, self._window)) for plane in planes]
        return np.stack(means, axis=-1).reshape(image.shape).astype(np.float32, copy=False)
