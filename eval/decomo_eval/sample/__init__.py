"""A procedural clip with exact ground truth: textured scene, moving camera, non-rigid objects. No torch.

`generate(seed, frames, size)` makes it, `write(sample, directory)` puts it on disk; `decomo-sample` does both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from decomo_eval.sample.sample import Sample, SampleError, generate
    from decomo_eval.sample.storage import write

__all__ = ["Sample", "SampleError", "generate", "write"]


def __getattr__(name: str) -> Any:
    """Imports numpy and OpenCV only when something is used, so that `decomo-sample --help` is instant."""
    if name in ("Sample", "SampleError", "generate"):
        from decomo_eval.sample import sample

        return getattr(sample, name)
    if name == "write":
        from decomo_eval.sample.storage import write

        return write
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
