"""One clip of a batch: fitted and exported as any of many, then asked where its points go.

OUT/models/, OUT/videos/         `decomotion.jobs.clip_task`
OUT/tracks/<name>.npz            where the points go, as decomo-track writes it
OUT/overlays/<name>.mp4          the same, drawn on the clip
OUT/videos/<name>/picture.jpg    three frames of that, small
OUT/videos/<name>/asked.json     which points these are of; appears when all of them are there
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from decomotion.jobs import clip_task
from decomotion.jobs.clip_task import ClipTask, is_model, model_in, read_json

COMMANDS: Mapping[str, tuple[str, ...]] = {
    **clip_task.COMMANDS,
    "track": ("-m", "decomotion.entry", "track"),
    "picture": ("-m", "decomotion.batch.picture"),
}
PICTURE, ASKED = "picture.jpg", "asked.json"
GRID = "16@0"
"""A point every 16 pixels of the first frame."""


@dataclass(frozen=True)
class TrackedTask(ClipTask):
    """A clip to be fitted and asked."""

    grid: str = GRID
    """Points to follow, STEP@T of decomo-track, where there is no file of them."""
    queries: Path | None = None
    """File of them, in full."""
    queries_digest: str | None = None
    """Of its content."""
    overlay: bool = True
    """Whether tracks are drawn on the clip."""
    commands: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: COMMANDS)

    @property
    def tracks(self) -> Path:
        """Where the answers go."""
        return self.out / "tracks" / f"{self.name}.npz"

    @property
    def drawn(self) -> Path:
        """Where the clip with its tracks goes."""
        return self.out / "overlays" / f"{self.name}.mp4"

    def stages(self, here: Path) -> Iterator[tuple[str, Sequence[str]]]:
        """See `ClipTask.stages`; points are always asked for anew, which takes seconds."""
        yield from super().stages(here)
        made, tracks, drawn = model_in(here, self.name), here / "tracks.npz", here / "overlay.mp4"
        points = ("--grid", self.grid) if self.queries is None else ("--queries", str(self.queries))
        overlay = ("--overlay", str(drawn), "--clip", self.source) if self.overlay else ()
        model = str(made if is_model(made) else self.model)
        yield "track", [*self.commands["track"], model, *points, "--out", str(tracks), *overlay]
        shown = str(drawn) if self.overlay else self.source
        yield "picture", [*self.commands["picture"], shown, str(here / PICTURE)]
        (here / ASKED).write_text(json.dumps(self.asked_for()), encoding="utf-8")

    def results(self, here: Path) -> Mapping[Path, Path]:
        """See `ClipTask.results`."""
        answers = {here / "tracks.npz": self.tracks, here / "overlay.mp4": self.drawn}
        about = {here / name: self.folder / name for name in (PICTURE, ASKED)}
        return {**super().results(here), **answers, **about}

    def is_done(self) -> bool:
        """Whether model and tracks are there, of the points that are asked for now."""
        there = is_model(self.model) and self.tracks.is_file() and (self.drawn.is_file() or not self.overlay)
        return there and read_json(self.folder / ASKED) == self.asked_for()

    def asked_for(self) -> dict[str, Any]:
        """What decides the tracks, beside the model; `asked.json`."""
        grid = self.grid if self.queries is None else None
        return {"grid": grid, "queries": self.queries_digest, "overlay": self.overlay}
