"""A file that is read more than once, and has to be the same each time."""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path

from decomotion.errors import ClipError
from decomotion.files import digest_of


class SourceFile:
    """A file as it is when this is made.

    Raises `OSError` where there is none.
    """

    def __init__(self, path: Path) -> None:
        self.shown, self.path = path, path.absolute()  # the working directory may change
        status = self.path.stat()
        self._stamp = _stamp(status)
        self.identity = str(self.path), *self._stamp, status.st_ctime_ns, status.st_ino
        """What tells this file, as it is, from all others, without reading it."""

    @property
    def url(self) -> str:
        """For ffmpeg: of a bare path, a colon in a name would end that of a protocol."""
        return f"file:{self.path}"

    def check(self) -> None:
        """Raises `ClipError` where the file is not there any more, or was written to."""
        try:
            same = _stamp(self.path.stat()) == self._stamp
        except OSError as error:
            raise ClipError(f"{self.shown} cannot be read any more ({error.strerror}); put it back") from error
        if not same:
            raise self.changed()

    def changed(self) -> ClipError:
        """The error that says so."""
        return ClipError(f"{self.shown} has changed since it was opened; leave it as it is, and start again")

    @cached_property
    def digest(self) -> str:
        """SHA-256 of its bytes, in hexadecimal digits. Raises `ClipError` as `check`."""
        self.check()
        digest = digest_of(self.path)
        self.check()
        return digest


def _stamp(status: os.stat_result) -> tuple[int, int]:
    return status.st_size, status.st_mtime_ns
