"""Long clips, and clips of several shots: fitted as windows, each a run of its own in a process of its own.

RUN/windows.json               the clip, its windows, and what they are fitted with: one answer for the whole folder
RUN/window-000/                a run, as of a clip that is one window
RUN/window-000/log.txt         what decomo-train printed, where several windows are fitted at a time

This process only looks on, without torch: it takes little memory beside a fit.
A window that is finished is not fitted again, and one that was stopped goes on, however often the command is given.
"""

from __future__ import annotations

import json
import logging
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from decomotion import record
from decomotion.cache import DROP, of_each
from decomotion.clip import Clip
from decomotion.data.config import DataConfig
from decomotion.data.cuts import find_cuts
from decomotion.data.flow.config import FolderFlowConfig
from decomotion.default_time import default_seconds, rounds
from decomotion.errors import CheckpointError, ClipError, ConfigError, TrainingError
from decomotion.jobs.engine import Engine, run_tasks
from decomotion.jobs.lock import alone
from decomotion.jobs.task import Outcome, Place, run_stages
from decomotion.options import WHOLE
from decomotion.presets import AUTO
from decomotion.times import is_steady
from decomotion.windows import FILE_NAME, Windows, split

log = logging.getLogger(__name__)

COMMAND = ("-m", "decomotion.cli")
"""Arguments of python that fit a window."""
ONE_WINDOW = 128
"""Frames up to which `auto` fits a shot as one window."""
USUAL = 100
"""Frames of a window of a longer one, about."""
ATTEMPTS = 2
"""How often a window is tried."""


def check_one_shot(clip: Clip) -> None:
    """Raises `ClipError` where the clip has cuts."""
    if cuts := find_cuts(clip.frames):
        many = "s" if len(cuts) > 1 else ""
        raise ClipError(
            f"{clip.name} cuts to another shot at frame{many} {', '.join(map(str, cuts))}, and no motion leads across; "
            "fit each shot by itself with --shots split, or take it as one shot with --shots ignore"
        )


def lay_out(clip: Clip, window: int | str, shots: str) -> Windows:
    """The windows of a clip as the options of commands say it (`decomotion.options.window_options`).

    Raises `ClipError` where `shots` is `stop` and the clip has cuts, or a shot has a single frame.
    """
    if shots == "stop":
        check_one_shot(clip)
    cuts = find_cuts(clip.frames) if shots == "split" else []
    longest = {AUTO: None, WHOLE: len(clip)}[window] if isinstance(window, str) else window
    return windows_of(clip, longest, cuts)


def windows_of(clip: Clip, longest: int | None, cuts: Sequence[int]) -> Windows:
    """The windows of a clip with these cuts: of `longest` frames at most, about; None: few and long where that serves.

    Raises `ClipError` where a shot has a single frame.
    """
    bounds = [0, *cuts, len(clip)]
    single = [begin for begin, end in pairwise(bounds) if end - begin < 2]
    if single:
        raise ClipError(
            f"{clip.name} has a shot of one frame, {single[0]}, and motion needs at least two; "
            "leave that frame out, or take the clip as one shot with --shots ignore"
        )
    fits = all(end - begin <= ONE_WINDOW for begin, end in pairwise(bounds))
    longest = longest or (ONE_WINDOW if fits else USUAL)
    seconds = None if is_steady(clip.times, clip.fps) else tuple(clip.times.tolist())
    facts = clip.name, len(clip), clip.height, clip.width, clip.fps
    return Windows(*facts, split(len(clip), cuts, longest), seconds, clip.pixel_aspect)


def own_files(config: DataConfig) -> list[str]:
    """Options whose flow, masks or tracks are the user's own, which go with the frames of one clip."""
    given = {
        "--flow": isinstance(config.flow, FolderFlowConfig),
        "--masks": config.gives_masks,
        "--tracks": config.tracks is not None,
    }
    return [option for option, is_given in given.items() if is_given]


def check_no_files(config: DataConfig) -> None:
    """Raises `ConfigError` where there are `own_files`."""
    if named := " and ".join(own_files(config)):
        raise ConfigError(
            f"{named} with several windows: files of the whole clip do not fit its parts; fit CLIP@A:B one by one, "
            "each with files of its own, or the whole clip as one with --window all"
        )


@dataclass(frozen=True)
class WindowTask:
    """A window to be fitted."""

    name: str
    source: str
    """CLIP@A:B, in full: attempts run on other machines too."""
    folder: Path
    """Of its run, in full."""
    options: tuple[str, ...]
    """Of decomo-train, for a window that is begun: its default time, too."""
    budget: tuple[str, ...]
    """Of decomo-train, for a window that goes on too; so is what becomes of what it prepares."""
    logged: bool
    """Whether what decomo-train prints goes to a file."""
    attempts: int = ATTEMPTS

    def attempt(self, number: int, place: Place) -> Outcome:
        """Fits the window, or goes on with it: see `decomotion.jobs.task.Task`."""
        self.folder.mkdir(parents=True, exist_ok=True)
        begun = record.read_record(self.folder) is not None
        how = ["--resume"] if begun else self.options
        line = [*COMMAND, self.source, "--out", str(self.folder), "--shots", "ignore", "--window", "all"]
        stages = [("train", [*line, *how, *self.budget])]
        ended = run_stages(stages, self.folder / "log.txt" if self.logged else None, place)
        return Outcome(self.name, number, ended.seconds, ended.error)


def fit_windows(
    source: str | Path,
    clip: Clip,
    layout: Windows,
    folder: Path,
    options: Sequence[str],
    *,
    engine: Engine,
    told: Callable[[int, float | None], None],
    steps: int | None = None,
    time_budget: float | None = None,
    in_time: bool = False,
    longer: bool = False,
    prepared: str = AUTO,
) -> None:
    """Fits each window of a clip; those that are finished are left alone.

    Args:
        source: path of the clip.
        clip: what it holds.
        layout: its windows.
        folder: of the runs.
        options: decomo-train's, for every window, budget not among them.
        engine: where windows are fitted.
        told: hears, before the first is begun, how many are fitted at a time, and how many seconds each has in the
            mean; None: steps.
        steps: of each window.
        time_budget: seconds of all windows, which share it by their length.
        in_time: of neither, a window that is begun has `default_seconds`, not the preset's steps.
        longer: go on with finished windows too.
        prepared: what becomes of what a finished window has prepared (`decomotion.cache.of_each`).

    Raises `CheckpointError` where the folder holds windows of another clip or with other options, `TrainingError` where
    some failed: the others are kept, and the next call tries those alone.
    """
    folder = folder.absolute()
    with alone(folder, "decomo-train", CheckpointError):
        _claim(folder, clip, layout, options)
        path, first = _whole(Path(source))
        failed = []
        with engine.start() as room:
            count = len(layout.windows)
            jobs, seconds = min(room.jobs, count), None
            if time_budget is not None:
                seconds = time_budget / rounds(count, jobs)
            elif steps is None and in_time:
                seconds = default_seconds(count, jobs)
            told(jobs, seconds)
            of_window = of_each(prepared, count)
            if of_window != prepared:
                log.info("what a window prepares leaves the disk when it is finished (--prepared keep: stays)")
            tasks = []
            for window in layout.windows:
                begun_with, budget = list(options), ["--steps", str(steps)] if steps else []
                if time_budget is not None and seconds is not None:
                    share = len(window) * count / sum(map(len, layout.windows))
                    budget = ["--time-budget", f"{max(1.0, share * seconds):.1f}s"]
                elif seconds is not None:
                    begun_with += ["--time-budget", f"{seconds:.1f}s"]
                budget += ["--prepared", of_window] if of_window == DROP else []
                part = f"{path}@{first + window.begin}:{first + window.end}"
                given = (tuple(begun_with), tuple(budget), jobs > 1)
                tasks.append(WindowTask(window.name, part, folder / window.name, *given))

            def ready(task: WindowTask) -> WindowTask | Outcome:
                if record.is_finished(task.folder) and not longer:
                    return Outcome(task.name, 0, {}, None)
                log.info("%s of %d, frames %s", task.name, len(tasks), task.source.rpartition("@")[2])
                return task

            for done, outcome in enumerate(run_tasks(tasks, room, ready, lambda _, outcome: outcome), 1):
                log.info("%s %s (%d of %d)", outcome.name, outcome.words, done, len(tasks))
                failed += [outcome] if outcome.error else []
    if failed:
        reasons = "; ".join(f"{outcome.name}: {outcome.error}" for outcome in failed)
        raise TrainingError(
            f"{len(failed)} of {len(tasks)} windows failed, the same command tries them again ({reasons})"
        )


def _whole(source: Path) -> tuple[Path, int]:
    """The path of the clip of which `source` may be a part, CLIP@A:B, in full, and the part's first frame."""
    part = re.fullmatch(r"(.+)@(\d+):\d+", str(source))
    if part is None or source.exists():
        return source.absolute(), 0
    return Path(part[1]).absolute(), int(part[2])


def _claim(folder: Path, clip: Clip, layout: Windows, options: Sequence[str]) -> None:
    """Writes `windows.json`, or compares with it: a folder's windows are of one clip and one configuration."""
    file, digest = folder / FILE_NAME, clip.digest()
    begun = any(folder.glob(f"window-*/{record.FILE_NAME}"))
    if file.is_file() and begun:
        found, wanted = read_windows(folder), (layout, digest, list(options))
        if found == wanted:
            return
        named = ("windows", "clip", "options")
        different = [name for name, one, other in zip(named, found, wanted, strict=True) if one != other]
        raise CheckpointError(
            f"{folder} was begun with another {' and '.join(different)}; give those again, --resume, or another --out"
        )
    for former in (record.CHECKPOINT, record.FILE_NAME, record.CORRECTIONS, "config.yaml"):
        (folder / former).unlink(missing_ok=True)
    for former in ("previews", "tensorboard"):
        shutil.rmtree(folder / former, ignore_errors=True)
    layout.save(file, digest=digest, options=list(options))


def read_windows(folder: Path) -> tuple[Windows, str, list[str]]:
    """The windows of a clip's runs, its digest, and the options they were begun with.

    Raises `CheckpointError` where `windows.json` is missing or damaged.
    """
    file = folder / FILE_NAME
    if not file.is_file():
        raise CheckpointError(f"{file} does not exist; train first with decomo-train")
    layout = Windows.load(file, CheckpointError)
    more: dict[str, Any] = json.loads(file.read_bytes())
    digest, options = more.get("digest"), more.get("options")
    if not isinstance(digest, str) or not isinstance(options, list) or not all(isinstance(o, str) for o in options):
        raise CheckpointError(f"{file} does not tell what the windows were begun with; train again")
    return layout, digest, options
