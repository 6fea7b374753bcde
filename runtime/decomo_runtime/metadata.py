"""Reads entries of a model file's metadata; `ModelFileError`, naming file and key, where one is missing or wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from decomo_runtime.errors import ModelFileError

Value = TypeVar("Value")


def text(metadata: Mapping[str, str], key: str, path: Path) -> str:
    """An entry that every file has."""
    if key not in metadata:
        raise ModelFileError(f"{path} lacks the metadata {key}; export the model again")
    return metadata[key]


def parsed(
    metadata: Mapping[str, str],
    key: str,
    path: Path,
    parse: Callable[[str], Value],
    valid: Callable[[Value], bool],
) -> Value:
    """The same, read by `parse`, which may raise `ValueError`, `TypeError` or `LookupError`, and found `valid`."""
    content = text(metadata, key, path)
    try:
        value = parse(content)
    except (ValueError, TypeError, LookupError, RecursionError):
        value = None
    if value is None or not valid(value):
        raise ModelFileError(f"{path} has the impossible metadata {key} = {content[:80]!r}; export the model again")
    return value


def parsed_if_there(
    metadata: Mapping[str, str],
    key: str,
    path: Path,
    parse: Callable[[str], Value],
    valid: Callable[[Value], bool],
) -> Value | None:
    """The same of an entry that older files lack; None where this one does."""
    return parsed(metadata, key, path, parse, valid) if key in metadata else None
