"""From a folder or list of clips to models, tracks and one page about them.

OUT/batch.json      what all clips are fitted with: one answer for the whole folder
OUT/index.html      the page; `summary.json` says the same to programs
and what `task.py` names, for each clip.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

from decomotion.batch.clips import Entry, read_clips, together
from decomotion.batch.page import write_page
from decomotion.batch.task import GRID, TrackedTask
from decomotion.clip import clip_part
from decomotion.errors import BatchError
from decomotion.files import digest_of
from decomotion.frame_files import frame_files
from decomotion.jobs.engine import Engine, LocalEngine
from decomotion.jobs.folder import ClipTasks, Results, claim
from decomotion.jobs.lock import alone
from decomotion.jobs.task import Outcome
from decomotion.presets import AUTO

GRID_FORM = re.compile(r"[1-9]\d*(\.\d+)?@\d+", re.ASCII)


def batch(
    clips: str | Path | Sequence[Entry],
    out: str | Path,
    options: Sequence[str] = (),
    *,
    engine: Engine | None = None,
    grid: str = GRID,
    overlay: bool = True,
    attempts: int = 2,
    prepared: str = AUTO,
) -> Results:
    """Fits, exports and tracks every clip; what is done in `out` is not done again.

    Args:
        clips: a folder of clips, a list of them (`clips.read_clips`), or what is read from one.
        out: folder of all that is made.
        options: decomo-train's for every clip, names and values in turn.
        engine: where clips are fitted; by default here, one at a time.
        grid: points to follow in clips without queries of their own, STEP@T: one every STEP pixels of frame T.
        overlay: whether to draw the tracks on each clip, as a video.
        attempts: how often a clip is tried; then it is reported, and the others go on.
        prepared: what becomes of what a finished fit has prepared (`decomotion.cache.of_each`).

    Returns: what came of the clips, those that failed among them.

    Raises `BatchError` where the grid is none, the list cannot be read, `out` was made with other options, or another
    run is at work on it; `EngineError` where the engine does not run.
    """
    out = Path(out)
    if not GRID_FORM.fullmatch(grid):
        raise BatchError(f"--grid {grid} is not STEP@T: a spacing of at least 1 pixel and a frame, such as {GRID}")
    entries = read_clips(clips) if isinstance(clips, str | Path) else list(clips)
    tasks = [_task(entry, out.absolute(), options, grid, overlay, attempts, prepared) for entry in entries]
    with alone(out, "decomo-batch", BatchError):
        claim(out / "batch.json", {"options": list(options)}, BatchError)
        results = ClipTasks(tasks, digest).run(engine or LocalEngine())
        results = results.with_others(_earlier(out, {entry.name for entry in entries}))
        results.write(out)
        write_page(out, results)
    return results


def digest(task: TrackedTask) -> str:
    """Of a clip's files, by their content: 16 hexadecimal digits.

    Raises `ClipError` or `OSError` where there are none that can be read.
    """
    path, begin, end = clip_part(Path(task.source))
    if not path.is_dir():
        return digest_of(path)[:16]
    content = hashlib.sha256()
    for file in frame_files(path)[begin:end]:
        content.update(f"{file.name} {digest_of(file)}\n".encode())
    return content.hexdigest()[:16]


def _task(
    entry: Entry, out: Path, options: Sequence[str], grid: str, overlay: bool, attempts: int, prepared: str
) -> TrackedTask:
    own = together(options, entry.options)
    points = None if entry.queries is None else digest_of(entry.queries)
    asked = {"grid": grid, "queries": entry.queries, "queries_digest": points, "overlay": overlay}
    return TrackedTask(entry.name, out, entry.source, own, attempts, prepared=prepared, **asked)


def _earlier(out: Path, asked: set[str]) -> list[Outcome | None]:
    """What is known of clips in the folder that were not asked for."""
    names = sorted(folder.name for folder in (out / "videos").glob("*") if folder.is_dir())
    return [TrackedTask(name, out.absolute(), "", (), 1).recorded() for name in names if name not in asked]
