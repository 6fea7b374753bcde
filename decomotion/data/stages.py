"""Stages of the preparation on disk: each is done once, goes on where it was stopped, and is believed only when whole.

A stage is a folder `<name>-<key>`, where the key hashes everything that decides its content. It is written under a
hidden name with the suffix `.partial`, which a later run with the same key finds and goes on with, and is renamed when
it is complete. A lock, which the system releases when its process ends in whatever way, keeps two runs apart: the
second waits and then finds the work done.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from filelock import FileLock, Timeout
from pydantic import BaseModel, FiniteFloat, ValidationError

from decomotion.files import naming, put_in_place

log = logging.getLogger(__name__)

RECORD = "stage.json"
"""Written last: what the stage was made from, how long it took, and facts worth keeping."""
ABANDONED_SECONDS = 7 * 24 * 3600
"""What a killed run left is kept this long for another to go on with."""


class _Content(BaseModel):
    """Of `stage.json`, beside the settings."""

    seconds: dict[str, FiniteFloat]
    facts: dict[str, Any]
    files: dict[str, int]


@dataclass(frozen=True)
class Stage:
    """One part of the preparation, not necessarily done yet."""

    name: str
    settings: dict[str, Any]
    """All that decides its content, as plain values."""
    root: Path
    """The folder of the clip in the cache."""

    @property
    def key(self) -> str:
        """Hash of the settings."""
        return hashlib.sha256(json.dumps(self.settings, sort_keys=True).encode()).hexdigest()[:20]

    @property
    def folder(self) -> Path:
        """Where the finished stage lies."""
        return self.root / f"{self.name}-{self.key}"

    @property
    def finished(self) -> bool:
        """Whether it is there, whole: no file is missing or has another size than it had."""
        if not (self.folder / RECORD).is_file():
            return False
        try:
            files = self._content().files
        except ValidationError:
            return False
        return all(_size(self.folder / name) == size for name, size in files.items())

    @property
    def made(self) -> str:
        """Of the finished stage: hash of its record, another for each time that it is made."""
        return hashlib.sha256((self.folder / RECORD).read_bytes()).hexdigest()[:20]

    def record(self, cached: bool) -> Record:
        """Of the finished stage; `cached`: not made by this call."""
        content = self._content()
        size = sum(file.stat().st_size for file in self.folder.rglob("*") if file.is_file())
        return Record(self.name, self.folder, content.seconds, content.facts, size, cached)

    def _content(self) -> _Content:
        return _Content.model_validate_json((self.folder / RECORD).read_bytes())

    def run(self, build: Callable[[Path], dict[str, Any]], rebuild: bool = False) -> Record:
        """Makes the stage with `build` unless it is finished; `rebuild` forgets what there is.

        `build` fills the folder that it is given, where an earlier attempt may have left files, and returns the facts
        to record: plain values, with `seconds`, a mapping of seconds by part, where it has several.
        """
        if self.finished and not rebuild:
            return self.record(cached=True)
        self.root.mkdir(parents=True, exist_ok=True)
        with _waiting(self.root / f".{self.folder.name}.lock", self.name):
            if self.finished and not rebuild:  # another run was faster
                return self.record(cached=True)
            partial = self.root / f".{self.folder.name}.partial"
            if rebuild:
                shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir(exist_ok=True)
            os.utime(partial)
            begin = time.monotonic()
            with naming(self.folder, partial):
                facts = build(partial)
            seconds = {**facts.pop("seconds", {self.name: time.monotonic() - begin})}
            files = {file.relative_to(partial).as_posix(): _size(file) for file in partial.rglob("*") if file.is_file()}
            content = {"settings": self.settings, "seconds": seconds, "facts": facts, "files": files}
            (partial / RECORD).write_text(json.dumps(content, indent=1), encoding="utf-8")
            if self.folder.exists():  # it keeps serving those that have it open
                shutil.rmtree(self.folder)
            put_in_place(partial, self.folder)
        return self.record(cached=False)


@dataclass(frozen=True)
class Record:
    """A finished stage."""

    name: str
    folder: Path
    seconds: dict[str, float]
    """Wall time that it took when it was made, by part."""
    facts: dict[str, Any]
    bytes: int
    """On disk."""
    cached: bool
    """Whether it was there already."""


def settings_of_finished(name: str, root: Path) -> Iterator[dict[str, Any]]:
    """Of all stages of that name in the folder of a clip that have a record: what each was made from."""
    for record in sorted(root.glob(f"{name}-*/{RECORD}")):
        yield json.loads(record.read_text(encoding="utf-8"))["settings"]


def _size(file: Path) -> int | None:
    return file.stat().st_size if file.is_file() else None


@contextmanager
def _waiting(path: Path, name: str) -> Iterator[None]:
    lock = FileLock(path)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        log.info("another run is preparing the %s of this clip; waiting for it", name)
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


def remove_abandoned(root: Path) -> None:
    """Removes what killed runs left of a clip's stages a week ago or earlier, unless a run is at work on it."""
    for partial in root.glob(".*.partial"):
        if time.time() - partial.stat().st_mtime > ABANDONED_SECONDS:
            with suppress(Timeout), FileLock(partial.with_suffix(".lock"), timeout=0):
                shutil.rmtree(partial, ignore_errors=True)


def remove_all(root: Path) -> None:
    """Removes a clip's stages, finished or not, unless a run is at work on some: then all stay."""
    locks = [FileLock(path) for path in root.glob(".*.lock")]
    with ExitStack() as held, suppress(Timeout):
        for lock in locks:
            held.enter_context(lock.acquire(timeout=0))
        for folder in root.glob("*-*"):
            shutil.rmtree(folder, ignore_errors=True)


def write_whole(path: Path, write: Callable[[Path], Any]) -> None:
    """Writes a file of a partial stage under a temporary name and renames it: a kill leaves it whole or not at all."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    write(temporary)
    put_in_place(temporary, path)


def write_array(path: Path, values: npt.NDArray[Any]) -> None:
    """Writes a `.npy` file as `write_whole` does."""

    def save(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.save(file, values)

    write_whole(path, save)


def readable(path: Path) -> bool:
    """Whether a whole `.npy` file is there."""
    try:
        np.load(path, mmap_mode="r")
    except Exception:  # numpy evaluates the header: what a damaged one brings it to is not limited
        return False
    return True
