"""Which clips are meant: those in a folder, or those that a list names.

A folder holds videos, folders of frames, or both; each is a clip, named as decomo-train names it.
A list is a text file with the path of a clip on each line, or a table (`.csv`) with a header:
    clip        path of the clip; CLIP@A:B takes frames A up to but without B
    name        optional: of what is made of it
    queries     optional: file of points to follow, as of decomo-track --queries
    options     optional: of decomo-train, for this clip, beside those of all
Paths in a list are from the list's own folder on. Empty lines, and those that begin with #, are left out.
"""

from __future__ import annotations

import csv
import logging
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from decomotion.clip import clip_part
from decomotion.errors import BatchError, InputError
from decomotion.frame_files import IMAGE_SUFFIXES
from decomotion.jobs.options import ENGINE_OPTIONS
from decomotion.long_clip import own_files
from decomotion.options import Supervision, forwarded, given_names
from decomotion.tables import opened_table

if TYPE_CHECKING:
    from decomotion.config import Config

logger = logging.getLogger(__name__)

VIDEO_SUFFIXES = (
    *(".avi", ".flv", ".gif", ".m2ts", ".m4v", ".mkv", ".mov", ".mp4"),
    *(".mpeg", ".mpg", ".mts", ".mxf", ".ogv", ".ts", ".webm", ".wmv"),
)
"""Files of a folder that are taken for clips. A list may name others."""
COLUMNS = ("clip", "name", "queries", "options")
COMMENT = "#"
NOT_OF_ONE = ("out", "resume", "rebuild_cache", "prepared", *ENGINE_OPTIONS)
"""Arguments of decomo-train that are not a clip's own."""
BUDGET = {"--time-budget", "--steps"}
"""Of which one is given."""


@dataclass(frozen=True)
class Entry:
    """A clip that is meant."""

    name: str
    source: str
    """Its path, CLIP or CLIP@A:B, in full."""
    queries: Path | None = None
    """File of the points to follow; None: a grid."""
    options: tuple[str, ...] = ()
    """Of decomo-train, beside those of all clips."""


def read_clips(path: str | Path) -> list[Entry]:
    """The clips of a folder, in alphabetic order, or of a list, in its order.

    Raises `BatchError` where there are none, two of one name, or a line that cannot be read.
    """
    path = Path(path)
    if not path.exists():
        raise BatchError(f"{path} does not exist; give a folder of clips, or a list of them")
    entries = _in_folder(path) if path.is_dir() else list(_in_list(path))
    if not entries:
        what = "videos or folders of frames" if path.is_dir() else "paths of clips"
        raise BatchError(f"{path} holds no clips; put {what} there")
    named: dict[str, Entry] = {}
    for entry in entries:
        other = named.setdefault(entry.name.casefold(), entry)  # some file systems know no capitals
        if other is not entry:
            raise BatchError(
                f"the clips {other.source} and {entry.source} would both be called {entry.name}; rename one, or give a "
                "list (.csv) with the columns clip and name"
            )
    return entries


def _in_folder(folder: Path) -> list[Entry]:
    visible = sorted(each for each in folder.iterdir() if not each.name.startswith("."))
    if any(each.suffix.lower() in IMAGE_SUFFIXES for each in visible):
        raise BatchError(
            f"{folder} holds frames, so it is one clip; give the folder in which it lies, or fit it with decomo-train"
        )
    clips = [each for each in visible if _is_clip(each)]
    if left := [each.name for each in visible if each not in clips]:
        logger.warning("in %s, left out for being no clips: %s", folder, ", ".join(left))
    return [_entry(str(each.absolute())) for each in clips]


def _is_clip(path: Path) -> bool:
    if not path.is_dir():
        return path.suffix.lower() in VIDEO_SUFFIXES
    folders = [path, path / "color"]
    return any(
        file.suffix.lower() in IMAGE_SUFFIXES for folder in folders if folder.is_dir() for file in folder.iterdir()
    )


def _in_list(file: Path) -> Iterator[Entry]:
    try:
        if file.suffix.lower() == ".csv":
            yield from _in_table(file)
            return
        for line in file.read_text(encoding="utf-8-sig").splitlines():
            if line.strip() and not line.lstrip().startswith(COMMENT):
                yield _entry(str(file.absolute().parent / line.strip()))
    except (OSError, UnicodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text in UTF-8"
        raise BatchError(
            f"{file} cannot be read ({reason}); give a folder of clips, or a list of their paths"
        ) from error
    except csv.Error as error:
        raise BatchError(f"{file} is no table of comma-separated values: {error}") from error


def _in_table(file: Path) -> Iterator[Entry]:
    with opened_table(file, COMMENT) as table:
        columns = table.columns
        if "clip" not in columns or set(columns) - set(COLUMNS) or len(set(columns)) < len(columns):
            raise BatchError(f"{file} has the columns {', '.join(columns)}; it needs clip, and may have {COLUMNS[1:]}")
        lines = (line for line in table.lines if line.strip() and not line.startswith(COMMENT))
        for number, row in enumerate(csv.reader(lines, delimiter=table.separator, strict=True), 1):
            where = f"row {number} of {file}"
            if len(row) != len(columns):
                raise BatchError(
                    f"{where} has not as many cells as the header; put a text with a comma in double quotes"
                )
            yield _of_row(where, file.absolute().parent, dict(zip(columns, row, strict=True)))


def _of_row(where: str, base: Path, row: Mapping[str, str]) -> Entry:
    clip, name, queries, options = (row.get(column, "").strip() for column in COLUMNS)
    if not clip:
        raise BatchError(f"{where} names no clip")
    if queries and not (base / queries).is_file():
        raise BatchError(f"{where} names the queries {base / queries}, which is no file")
    own = train_options(where, options, base) if options else ()
    return _entry(str(base / clip), name, base / queries if queries else None, own)


def _entry(source: str, name: str = "", queries: Path | None = None, options: tuple[str, ...] = ()) -> Entry:
    path, begin, end = clip_part(Path(source))
    stem = path.name if path.is_dir() else path.stem
    return Entry(name or (stem if end is None else f"{stem}-{begin}-{end}"), source, queries, options)


def train_options(where: str, text: str, base: Path) -> tuple[str, ...]:
    """Options of decomo-train in a line, as arguments, with files from the folder `base` on.

    Raises `BatchError`, which says `where` they stand, where decomo-train would refuse them.
    """
    from decomotion.cli import command

    try:
        context = command.make_context("decomo-train", ["clip", *shlex.split(text)])
        if not_own := [name for name in given_names(context) if name not in given_names(context, NOT_OF_ONE)]:
            raise BatchError(f"{', '.join(not_own)} is of all clips; give it to decomo-batch")
        _config(context.params)
    except click.exceptions.Exit as error:
        raise BatchError(f"{where} asks for help in its options; give such as decomo-train takes for a clip") from error
    except click.ClickException as error:
        raise BatchError(f"{where}, options: {error.format_message()}") from error
    except (InputError, ValueError) as error:  # shlex: a quotation mark that is not closed
        raise BatchError(f"{where}, options: {error}") from error
    return tuple(forwarded(context, NOT_OF_ONE, base))


def check_common(given: Mapping[str, Any]) -> None:
    """Raises `ConfigError` or `BatchError` where these arguments of decomo-train cannot be those of all clips."""
    if files := own_files(_config(given).data):
        raise BatchError(f"{' and '.join(files)} of one clip: give that in a list (.csv), in its column options")


def _config(given: Mapping[str, Any]) -> Config:
    """Raises `ConfigError` or `BatchError` where no fit would take these arguments."""
    if given["time_budget"] is not None and given["steps"] is not None:
        raise BatchError("give --time-budget or --steps, not both")
    return Supervision(**{each.name: given[each.name] for each in fields(Supervision)}).config()


def together(common: Sequence[str], own: Sequence[str]) -> tuple[str, ...]:
    """Options of decomo-train, as names and values: those of all clips, and a clip's own, which come last and count."""
    if not BUDGET.isdisjoint(own):
        common = [
            part for pair in zip(common[::2], common[1::2], strict=True) if pair[0] not in BUDGET for part in pair
        ]
    return (*common, *own)
