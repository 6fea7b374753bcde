"""Exports a fitted model to one standard .onnx file."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from decomo_export.exporter import Exported as Exported
    from decomo_export.exporter import export as export

__all__ = ["Exported", "export"]


def __getattr__(name: str) -> object:
    if name in __all__:
        from decomo_export import exporter

        return getattr(exporter, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
