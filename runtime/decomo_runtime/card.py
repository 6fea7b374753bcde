"""A model's card: what it is of, how it came to be, and how good it is, as far as its files tell."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from decomo_runtime.origin import Origin
from decomotion.quality import Quality

NOT_TOLD = "not told"


@dataclass(frozen=True)
class WindowCard:
    """One of a clip's windows, each of which has a file of its own."""

    name: str
    """Of its file, without the suffix."""
    begin: int
    """First frame in the clip."""
    end: int
    """The frame after its last."""
    bytes: int
    """Size of its file."""
    quality: Quality | None
    """How good its fit is; None: not told."""


@dataclass(frozen=True)
class Card:
    """See the module. Of several windows, `preset` and `origin` are the first one's."""

    path: Path
    bytes: int
    """Size of the file, or of those of all windows."""
    clip_name: str
    num_frames: int
    height: int
    """Pixels, of the clip's own resolution; so is `width`."""
    width: int
    fps: float
    """Frames a second, in the mean."""
    seconds: float
    """From the clip's first frame to the end of its last, which lasts 1 / `fps`."""
    pixel_aspect: float
    """Width of a pixel over its height."""
    windows: tuple[WindowCard, ...]
    """In order; one of a single file."""
    preset: str
    origin: Origin
    quality: Quality | None
    """How good the fit is, of several windows that of the worst; None: not told."""
    providers: tuple[str, ...]
    """onnxruntime's execution providers that run it here, in order of preference."""

    def rows(self) -> list[tuple[str, str]]:
        """What it says, a name and a text each; the text may have several lines."""
        origin, count = self.origin, len(self.windows)
        size = f"{self.width}x{self.height}"
        aspect = "" if self.pixel_aspect == 1 else f", pixels {self.pixel_aspect:.4g} times as wide as high"
        rows = [
            ("model", f"{self.path} ({self.bytes / 2**20:.1f} MiB)"),
            ("clip", self.clip_name),
            ("licence", origin.licence or NOT_TOLD),
            ("frames", f"{self.num_frames} of {size}, {self.fps:.5g} a second, {self.seconds:.5g} s{aspect}"),
            ("windows", "1" if count == 1 else "\n".join([str(count), *map(_window, self.windows)])),
            ("preset", self.preset),
            ("budget", _budget(origin)),
            ("steps", NOT_TOLD if origin.steps is None else str(origin.steps)),
            ("fitted by", _code(origin.fitted_by)),
            ("exported by", _code(origin.exported_by)),
            ("tables", origin.bake or NOT_TOLD),
            ("precision", _precision(origin)),
            ("runs on", ", ".join(self.providers)),
        ]
        if self.quality is None:
            return [*rows, ("quality", NOT_TOLD)]
        of = "" if count == 1 else "of the window that misses its links the most:\n"
        warning = self.quality.warning()
        told = [f"{of}{self.quality.summary()}", self.quality.table(), *([warning] if warning else [])]
        return [*rows, ("quality", "\n".join(told))]

    def as_text(self) -> str:
        """`rows` in two columns."""
        rows = self.rows()
        width = max(len(name) for name, _ in rows) + 2
        return "\n".join(f"{name:{width}}" + f"\n{'':{width}}".join(text.splitlines()) for name, text in rows)

    def as_json(self) -> dict[str, Any]:
        """The same as plain values, by the names of the fields; what is not told is None."""
        return json.loads(json.dumps({**asdict(self), "path": str(self.path)}))


def _window(each: WindowCard) -> str:
    missed = "" if each.quality is None else f", held-out links missed by {each.quality.all.median:.2f} px of 256"
    return f"{each.name}: frames {each.begin} to {each.end - 1}, {each.bytes / 2**20:.1f} MiB{missed}"


def _budget(origin: Origin) -> str:
    if origin.budget_seconds is not None:
        return f"{origin.budget_seconds:.5g} s"
    return NOT_TOLD if origin.budget_steps is None else f"{origin.budget_steps} steps"


def _code(version: str | None) -> str:
    return NOT_TOLD if version is None else f"decomotion {version}"


def _precision(origin: Origin) -> str:
    if origin.precision is None:
        return NOT_TOLD
    if origin.precision == "fp32" or origin.deviation is None:
        return origin.precision
    mean, p99 = origin.deviation
    return f"{origin.precision}, which moves tracks by {mean:.2g} px in the mean, {p99:.2g} at the 99th percentile"


def window_cards(
    files: Sequence[Path], bounds: Sequence[tuple[int, int]], qualities: Sequence[Quality | None]
) -> tuple[WindowCard, ...]:
    """Of the files of a clip's windows, the (begin, end) of each in the clip, and how good its fit is."""
    return tuple(
        WindowCard(file.stem, *bound, file.stat().st_size, quality)
        for file, bound, quality in zip(files, bounds, qualities, strict=True)
    )
