"""Exported models: files, and folders of runs that hold some."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click


def model_files(paths: Sequence[Path]) -> list[Path]:
    """The `.onnx` files among `paths` and, in order of their names, those anywhere in the folders among them.

    Raises `click.UsageError` where a folder holds none.
    """
    files: list[Path] = []
    for path in paths:
        found = sorted(path.rglob("*.onnx"), key=lambda file: file.name) if path.is_dir() else [path]
        if not found:
            raise click.UsageError(f"{path} holds no .onnx file; export its runs with decomo-export")
        files += found
    return files
