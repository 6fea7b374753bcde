"""Csv files as people and spreadsheets write them, line by line.

Cells are separated by commas, semicolons or tabs, whichever the header has most of; where that is not the comma, a
comma in a number is its decimal point. Excel's line `sep=;` before the header says it instead. Text is UTF-8, UTF-16
with its mark, or else Latin-1.
"""

from __future__ import annotations

import codecs
import io
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

SEPARATORS = (",", ";", "\t")
_SAID = {f"sep={separator}": separator for separator in SEPARATORS}
_PIECE = 2**16


@dataclass(frozen=True)
class Table:
    """An open csv file, its header read."""

    columns: list[str]
    """The header's names, in lower case; none of an empty file."""
    separator: str
    lines: Iterator[str]
    """What follows the header."""
    header_line: int
    """Number of the header's line, from 1."""

    def number(self, text: str) -> str:
        """A cell, or a line, as `float` or numpy takes its numbers."""
        return text if self.separator == "," else text.replace(",", ".")


@contextmanager
def opened_table(path: Path, comment: str | None = None) -> Iterator[Table]:
    """Opens a csv file, whose header may follow empty lines and lines that begin with `comment`.

    Raises `OSError` where it cannot be read, `UnicodeError` where it is not text.
    """
    with ExitStack() as stack:
        opened = stack.enter_context(open(path, "rb"))
        content = opened if opened.seekable() else io.BytesIO(opened.read())  # a pipe is read once
        file = stack.enter_context(io.TextIOWrapper(content, encoding=_encoding(content), newline=""))
        header, number = file.readline(), 1
        while comment and header and (not header.strip() or header.startswith(comment)):
            header, number = file.readline(), number + 1
        if header.strip("\r\n ") in _SAID:
            separator, header, number = _SAID[header.strip("\r\n ")], file.readline(), number + 1
        else:
            separator = max(SEPARATORS, key=header.count)
        names = [name.strip().strip('"').strip().lower() for name in header.split(separator)] if header.strip() else []
        yield Table(names, separator, file, number)


def _encoding(file: io.BufferedIOBase) -> str:
    """Of the text of a file, which is led back to its begin. Raises `UnicodeError` where it is none."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    encoding = "utf-8-sig"
    if file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        encoding = "utf-16"
    else:
        file.seek(0)
        while piece := file.read(_PIECE):
            if b"\0" in piece:
                raise UnicodeError("a zero byte")
            try:
                decoder.decode(piece)
            except UnicodeDecodeError:
                encoding = "latin-1"
    file.seek(0)
    return encoding
