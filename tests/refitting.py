"""A `Refits` whose commands are stand-ins, and what a test sees and decides of them."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from decomo_runtime.view.refit import Refits

SECONDS = 120.0


class Bench:
    """A run, its model and a clip in `folder`, and stand-ins that wait for `let_go`."""

    def __init__(self, folder: Path, model: Path, clip: Path, **of_model: Any) -> None:
        self.control = folder / "control"
        self.run = folder / "runs" / "slide"
        self.model, self.clip = model, clip
        self.control.mkdir(parents=True)
        self.run.mkdir(parents=True)
        (self.control / "model.json").write_text(json.dumps(of_model))

    def refits(self, site: Path) -> Refits:
        """Of a folder that is served."""
        stand_in = (sys.executable, str(Path(__file__).with_name("stand_in.py")), str(self.control))
        return Refits(site, self.clip, self.run, self.model, train=(*stand_in, "train"), export=(*stand_in, "export"))

    def let_go(self, failure: str = "") -> None:
        """The fit that runs, or the next one, ends: well, or with the sentence `failure`."""
        partial = self.control / "nearly"
        partial.write_text(failure)
        partial.rename(self.control / "go")

    def begun(self) -> list[list[str]]:
        """Clip, run and time budget of each fit that was begun."""
        file = self.control / "begun"
        return [line.split() for line in file.read_text().splitlines()] if file.exists() else []

    def wait_until_begun(self, count: int = 1) -> int:
        """Waits for so many fits; returns the id of a process that the last one began."""
        wait_until(lambda: len(self.begun()) >= count and (self.control / "child").exists())
        return int((self.control / "child").read_text())

    def left(self) -> list[str]:
        """All that lies beside the run, hidden names too."""
        return sorted(path.name for path in self.run.parent.iterdir())


def wait_until(holds: Callable[[], bool], seconds: float = SECONDS) -> None:
    """Waits, but not for ever."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it never comes true"
        time.sleep(0.02)


def lives(pid: int) -> bool:
    """Whether a process is there that does anything."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
