"""Flow that the user brings: a folder of `.npy` or `.flo` files named by the pair of frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from decomotion.arrays import read_npy
from decomotion.data.flow.config import FolderFlowConfig
from decomotion.data.flow.interface import Flow, Frame, kept, to_raster
from decomotion.errors import SupervisionError

FLO_MAGIC = 202021.25
"""The number that a Middlebury `.flo` file begins with."""
MANY = 5
"""Missing pairs that are named one by one."""


class FolderFlow:
    """Fields `<i>_<j>.npy` or `<i>_<j>.flo` of a folder, frames counted from 0; see `FlowEstimator`.

    A field is [h, w, 2], the displacement (x, y) from frame i to frame j in pixels of its own raster, which may have
    any size and covers the frame. `.npy`: any float type; `.flo`: Middlebury's.
    """

    guided = False
    concurrent = True

    def __init__(self, config: FolderFlowConfig) -> None:
        self._config, self.field_side = config, config.field_side
        self._folder = Path(config.path)
        if not self._folder.is_dir():
            raise SupervisionError(f"--flow {self._folder} is no folder; give dis, raft-small, raft-large or one")

    def __call__(
        self,
        first: Frame,
        second: Frame,  # noqa: ARG002
        pair: tuple[int, int],
        start: Flow | None = None,  # noqa: ARG002
    ) -> Flow:
        """See `FlowEstimator`; the field's raster is that of the frames, limited to `field_side`."""
        file = self._file(pair)
        if file is None:
            raise SupervisionError(f"--flow {self._folder} has no field {_stem(pair)}.npy or {_stem(pair)}.flo")
        return to_raster(read_field(file), kept(first.shape[0], first.shape[1], self._config.field_side))

    def effort(self, gap: int) -> float:  # noqa: ARG002
        """The same at any gap."""
        return 1.0

    def require(self, pairs: list[tuple[int, int]]) -> None:
        """Every pair has a file."""
        missing = [pair for pair in pairs if self._file(pair) is None]
        if missing:
            named = ", ".join(_stem(pair) for pair in missing[:MANY])
            more = f" and {len(missing) - MANY} more" if len(missing) > MANY else ""
            raise SupervisionError(
                f"--flow {self._folder} lacks fields {named}{more}; "
                "add them as .npy or .flo files, or name other gaps with --set data.flow.intervals=[1,…]"
            )

    def _file(self, pair: tuple[int, int]) -> Path | None:
        files = (self._folder / f"{_stem(pair)}{suffix}" for suffix in (".npy", ".flo"))
        return next((file for file in files if file.is_file()), None)


def _stem(pair: tuple[int, int]) -> str:
    return f"{pair[0]}_{pair[1]}"


def read_field(file: Path) -> Flow:
    """The field [h, w, 2] of a `.npy` or `.flo` file; raises `SupervisionError` where it is none or not finite."""
    flow = read_npy(file, SupervisionError) if file.suffix == ".npy" else _read_flo(file)
    if flow.ndim != 3 or flow.shape[2] != 2 or 0 in flow.shape or not np.issubdtype(flow.dtype, np.floating):
        raise SupervisionError(f"flow field {file} is {flow.dtype} {list(flow.shape)}; it must be float [h, w, 2]")
    with np.errstate(over="ignore"):
        flow = flow.astype(np.float32)
    if not np.isfinite(flow).all():
        raise SupervisionError(f"flow field {file} has values that are not finite numbers; replace them")
    return flow


def _read_flo(file: Path) -> Flow:
    try:
        content = file.read_bytes()
        if len(content) < 12 or np.frombuffer(content, "<f4", 1)[0] != np.float32(FLO_MAGIC):
            raise ValueError("no .flo header")
        width, height = (int(side) for side in np.frombuffer(content, "<i4", 2, 4))
        return np.frombuffer(content, "<f4", offset=12).reshape(height, width, 2)
    except (ValueError, OSError) as error:
        raise SupervisionError(f"{file} is not a .flo file, or is damaged ({error}); replace it") from error
