"""All formats of dense correspondence, a line for each; command, Python and documentation go by this table.

A format is a module of this package with `write(found, path)`, for one pair of frames: it may take for granted that
`path` is new. It is imported when the format is used; a library that an extra installs is imported within `write`.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from decomo_runtime.errors import FlowError

if TYPE_CHECKING:
    from decomo_runtime.flow.found import Found


@dataclass(frozen=True)
class FlowFormat:
    """One format of dense correspondence."""

    name: str
    """For `--format`, and of the module."""
    ending: str
    purpose: str
    """What it holds, in a phrase: for help and documentation."""
    library: str | None = None
    """That it needs beside those of the runtime."""
    extra: str | None = None
    """Of `pip install 'decomotion[...]'`, which installs the library."""

    def check(self) -> None:
        """`FlowError` where its library is not installed."""
        if self.library is not None and find_spec(self.library) is None:
            raise FlowError(
                f"{self.name} needs {self.library}, which is not installed; run: pip install 'decomotion[{self.extra}]'"
            )

    def write(self, found: Found, path: Path) -> None:
        """Writes the file of one pair of frames."""
        import_module(f"decomo_runtime.flow.{self.name}").write(found, path)


FORMATS = (
    FlowFormat("flo", ".flo", "Middlebury's, and occlusion as png"),
    FlowFormat("kitti", ".png", "KITTI's 16-bit png, valid where in sight"),
    FlowFormat("npz", ".npz", "arrays for numpy"),
    FlowFormat("motion", ".exr", "motion vectors in pixels, y up", "OpenEXR", "exr"),
    FlowFormat("stmap", ".exr", "an STMap, where to look from 0 to 1, y up", "OpenEXR", "exr"),
)


def format_named(name: str) -> FlowFormat:
    """`FlowError` where there is none."""
    for each in FORMATS:
        if each.name == name:
            return each
    raise FlowError(f"{name} is no format of flow; there are {', '.join(each.name for each in FORMATS)}")
