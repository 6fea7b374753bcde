"""Refits that the page asks for: `decomo-train` and `decomo-export` as processes of their own, one refit at a time.

A refit goes on from a run with the page's corrections and leaves a new run beside it, whole or not at all. Its model is
put beside the page; once it is taken it lies beside the old one too, and the next refit goes on from it.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Literal

from decomo_runtime.errors import ViewError
from decomo_runtime.view.processes import PATIENCE, begin, end
from decomo_runtime.view.site import model_path, point_to
from decomotion.errors import InputError
from decomotion.files import new_folder, replacing
from decomotion.outputs import check_new_folder

TIME_BUDGET = "1m"
TRAIN = (sys.executable, "-m", "decomotion.cli")
EXPORT = (sys.executable, "-m", "decomo_export.cli")
MOST_LINE = 300
"""Characters of a line that are shown."""
_BAR = re.compile(r"^(?P<what>.*?)\s*(?P<percent>\d+)%\|.*\|\s*(?P<more>.*)$")
"""A progress bar as tqdm draws it."""


@dataclass(frozen=True)
class State:
    """What the page is told of the last refit."""

    number: int = 0
    """Of the refit, counted from 1; 0 where there was none."""
    state: Literal["idle", "running", "finished", "taken", "rejected", "cancelled", "failed"] = "idle"
    share: float | None = None
    """What is done of the step that it is at, within 0 .. 1; None where nobody knows."""
    said: str = ""
    """One line of progress, or why it failed."""
    model: str | None = None
    """Of a finished one: path of its model, or of that one's `windows.json`, relative to the page."""
    run: str | None = None
    """Of a finished one: folder of the new run."""
    file: str | None = None
    """Of a taken one: the model beside the old one, a file or a folder."""


class Refits:
    """The refits of one `decomo-view`; its methods may be called from any thread.

    `site` is the folder that is served, `run` the one that `model` was exported from, `train` and `export` the first
    arguments of the commands. Raises `ViewError` where `run` is no folder.
    """

    def __init__(
        self,
        site: Path,
        clip: Path,
        run: Path,
        model: Path,
        *,
        train: Sequence[str] = TRAIN,
        export: Sequence[str] = EXPORT,
    ) -> None:
        if not run.is_dir():
            raise ViewError(f"--run {run} is not a folder; give the one that decomo-train wrote and MODEL is from")
        self.token = secrets.token_urlsafe(32)
        """What a request must know."""
        self._site, self._clip, self._first_run, self._first_model = site, clip, run.absolute(), model.absolute()
        self._run = self._first_run
        self._suffix = "" if model.is_dir() else model.suffix
        self._train, self._export = train, export
        self._lock = threading.Lock()
        self._state = State()
        self._cancelled = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def state(self) -> State:
        """How the last refit is."""
        return self._state

    def as_json(self) -> dict[str, object]:
        """What the page reads."""
        return asdict(self._state)

    def begin(self, corrections: bytes) -> None:
        """Starts a refit with the content of a corrections.csv.

        Raises `ViewError` where one is running, or finished and not decided on, and `OutputError` where the new run
        could not be written.
        """
        with self._lock:
            if self._state.state == "running":
                raise ViewError("a refit is running already; wait for it, or cancel it")
            if self._state.state == "finished":
                raise ViewError("a refit waits for your verdict; take or reject it first")
            name = self._free_name()
            new_run = self._first_run.with_name(name)
            check_new_folder("--run:", new_run)
            number = self._state.number + 1
            self._cancelled.clear()
            self._state = State(number, "running", said="Starting …")
            self._thread = threading.Thread(target=self._refit, args=(number, corrections, new_run), daemon=True)
            self._thread.start()

    def cancel(self) -> None:
        """Ends the refit that runs, if one does, and waits until all that it has written is gone."""
        with self._lock:
            self._cancelled.set()
            thread = self._thread
        if thread is not None:
            thread.join(4 * PATIENCE)

    def take(self, number: int) -> None:
        """The refit `number` is what the page opens and the next one goes on from; its model is put beside the old one.

        Raises `ViewError` where it is not the one that waits for a verdict.
        """
        with self._lock:
            state = self._waiting(number)
            run, served = Path(state.run or ""), self._site / (state.model or "")
            file = self._first_model.with_name(run.name + self._suffix)
            if self._first_model.is_dir():
                with new_folder(file) as temporary:
                    shutil.copytree(served.parent, temporary, dirs_exist_ok=True)
            else:
                with replacing(file) as temporary:
                    shutil.copyfile(served, temporary)
            point_to(self._site, state.model or "")
            self._run = run
            self._state = replace(state, state="taken", file=str(file))

    def reject(self, number: int) -> None:
        """The page goes on with the model it had; the run stays. Raises `ViewError` as `take` does."""
        with self._lock:
            self._state = replace(self._waiting(number), state="rejected")

    def _waiting(self, number: int) -> State:
        if self._state.state != "finished" or self._state.number != number:
            raise ViewError("that refit waits for no verdict; look again at what the page shows")
        return self._state

    def _free_name(self) -> str:
        name, count = f"{self._first_run.name}-corrected", 1
        while True:
            free = name if count == 1 else f"{name}-{count}"
            file = self._first_model.with_name(free + self._suffix)
            if not self._first_run.with_name(free).exists() and not file.exists():
                return free
            count += 1

    def _refit(self, number: int, corrections: bytes, new_run: Path) -> None:
        model = self._site / f"refit-{number}{self._suffix}"
        ended = State(number, "failed", said="the refit broke off; where decomo-view was started is why")
        try:
            with tempfile.TemporaryDirectory(prefix="decomo-view-") as folder, new_folder(new_run) as temporary:
                file = Path(folder) / "corrections.csv"
                file.write_bytes(corrections)
                options = ["--run", self._run, "--corrections", file, "--time-budget", TIME_BUDGET, "--out", temporary]
                self._work([*self._train, self._clip, *options], "decomo-train", number)
                self._work([*self._export, model, "--run", temporary], "decomo-export", number)
            path = model_path(model).relative_to(self._site).as_posix()
            ended = State(number, "finished", model=path, run=str(new_run))
        except _CancelledError:
            ended = State(number, "cancelled")
        except (InputError, OSError) as error:
            ended = State(number, "failed", said=str(error))
        finally:  # whatever it was: a refit that seems to run for ever lets no other begin
            self._state = ended

    def _work(self, command: Sequence[str | Path], name: str, number: int) -> None:
        """Runs a command to its end and tells its progress; `ViewError` with its last line where it fails."""
        said = _Said(lambda line, share: self._say(State(number, "running", share, line)))
        self._say(State(number, "running", said=f"Starting {name} …"))
        if self._cancelled.is_set():
            raise _CancelledError
        process = begin(command)
        with process:
            assert process.stdout is not None
            reader = threading.Thread(target=said.listen, args=(process.stdout,), daemon=True)
            reader.start()
            while process.poll() is None and not self._cancelled.wait(0.1):
                pass
            cancelled = process.poll() is None
            end(process)
            reader.join(PATIENCE)
        if cancelled:
            raise _CancelledError
        if process.returncode != 0:
            silent = f"{name} ended with exit code {process.returncode} and said nothing"
            raise ViewError(said.last.removeprefix("Error: ") or silent)

    def _say(self, state: State) -> None:
        self._state = state


class _CancelledError(Exception):
    """The refit is not wanted any more."""


class _Said:
    """What a command prints: lines, and bars that begin with a carriage return; `tell` hears of each."""

    def __init__(self, tell: Callable[[str, float | None], None]) -> None:
        self._tell = tell
        self.last = ""
        """The last line that is no bar."""

    def listen(self, output: IO[bytes]) -> None:
        """Reads to the end of `output`."""
        rest = b""
        while some := os.read(output.fileno(), 65536):
            *lines, rest = re.split(rb"[\r\n]+", rest + some)
            for line in lines:
                self._hear(line)
            if b"%|" in rest:  # a bar: its end comes with the next one
                self._hear(rest)
        self._hear(rest)

    def _hear(self, line: bytes) -> None:
        text = line.decode(errors="replace").strip()[:MOST_LINE]
        if (bar := _BAR.match(text)) is not None:
            self._tell(f"{bar['what']} {bar['more']}".strip(), min(int(bar["percent"]) / 100, 1.0))
        elif text:
            self.last = text
            self._tell(text, None)
