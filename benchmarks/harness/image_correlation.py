"""Run by the Python of an environment with `al-dic` (PyPI), which has versions of its own of what we need too.

    PYTHON image_correlation.py FRAMES.npy OUT.npz MODE

Frames are uint8 [T, H, W]; MODE says whether each is compared with the first (`accumulative`) or with the one before
(`incremental`). OUT holds `nodes` [N, 2], (x, y) in pixels of frame 0, and
`moved` [T, N, 2].
"""

from __future__ import annotations

import sys

import numpy as np


def main(frames_file: str, out: str, mode: str) -> None:
    """As above."""
    from al_dic.core.config import dicpara_default  # pyright: ignore[reportMissingImports]
    from al_dic.core.data_structures import GridxyROIRange  # pyright: ignore[reportMissingImports]
    from al_dic.core.pipeline import run_aldic  # pyright: ignore[reportMissingImports]

    frames = np.load(frames_file)
    _, height, width = frames.shape
    para = dicpara_default(
        winsize=20,
        winstepsize=4,
        winsize_min=4,
        reference_mode=mode,
        img_size=(height, width),
        gridxy_roi_range=GridxyROIRange(gridx=(0, width - 1), gridy=(0, height - 1)),
        show_plots=False,
    )
    images = [frame / 255.0 for frame in frames]
    result = run_aldic(para, images, [np.ones((height, width))] * len(images), compute_strain=False)
    nodes = result.dic_mesh.coordinates_fem
    moved = [np.zeros_like(nodes)]
    for each in result.result_disp:
        accumulated = each.U if each.U_accum is None else each.U_accum
        moved.append(accumulated.reshape(-1, 2))
    np.savez(out, nodes=nodes, moved=np.stack(moved))


if __name__ == "__main__":
    main(*sys.argv[1:])
