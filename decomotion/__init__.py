"""DecoMotion: fits one decomposed, invertible motion model to one video.

Importing this package loads no torch: `decomotion.fit` does, when called.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from decomotion.version import __version__

if TYPE_CHECKING:
    from decomotion.train import fit as fit

__all__ = ["__version__", "fit"]


def __getattr__(name: str) -> object:
    if name == "fit":
        from decomotion.train import fit

        return fit
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
