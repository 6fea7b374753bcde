"""A frame of a clip with tracks on it, as napari shows it with our plugin.

    python benchmarks/napari_picture.py davis480p/frames/goat goat.npz 60 goat.jpg     # a Python with napari[pyqt6]

Tails are those of the ten frames before, coloured by how surely the point is hidden: red is hidden. It needs a display;
`xvfb-run -s "-screen 0 4000x3000x24" python ...` makes one.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import napari  # pyright: ignore[reportMissingImports]

from decomotion.frame_files import frame_files

TAIL, WIDTH = 10, 4
"""Frames; pixels."""
WINDOW = 1200, 760


def main(clip: str, tracks: str, frame: int, out: str) -> None:
    viewer = napari.Viewer(show=False)
    viewer.open([str(file) for file in frame_files(Path(clip))], stack=True, plugin="napari")
    (layer,) = viewer.open(tracks, plugin="decomotion")
    for name, value in (("tail_length", TAIL), ("tail_width", WIDTH), ("color_by", "occlusion")):
        setattr(layer, name, value)
    viewer.window.resize(*WINDOW)
    viewer.reset_view(margin=0.02)
    viewer.dims.set_current_step(0, frame)
    cv2.imwrite(out, viewer.screenshot(canvas_only=False, flash=False)[..., 2::-1])


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4])
