"""The folder that a browser needs: the page, the model and, if given, the frames of its clip as JPEG files."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from decomo_runtime.errors import ModelFileError
from decomo_runtime.model_file import ModelFacts
from decomo_runtime.overlay import check_clip
from decomo_runtime.tracker import Tracker
from decomotion.clip import Clip, read_clip
from decomotion.files import naming, new_folder, replacing
from decomotion.images import jpeg
from decomotion.outputs import check_new_folder
from decomotion.windows import FILE_NAME, Windows

PAGE = Path(__file__).parent / "page"
MODEL_NAME, MODEL_FOLDER = "model.onnx", "model"
"""Of the copy of the model."""
SITE_NAME = "site.json"
"""What the page reads first: `{"model": path, "clip": {"name", "frames": [path, ...]} or null, "refit": whether the
server refits}`; of a model folder, the path is that of its `windows.json`."""
_JPEG_QUALITY = 92


def read_inputs(model: Path, clip_path: Path | None) -> tuple[ModelFacts, Clip | None]:
    """The facts of the model, a file or a folder, and the clip, both checked.

    Raises `ModelFileError` where the model is not one that runs, `ClipError` where the clip cannot be read and
    `OverlayError` where it is not the one that the model was fitted to.
    """
    facts = Tracker(model).facts
    if clip_path is None:
        return facts, None
    clip = read_clip(clip_path)
    check_clip(clip, facts)
    return facts, clip


def write_site(folder: Path, model: Path, clip: Clip | None, refit: bool = False) -> None:
    """Fills `folder`, which must exist and be empty, with the page, `model` (a file or a folder) and `clip`'s frames.

    `refit` says that the server refits the model. Raises `OSError`, naming `folder`, where the disk is full.
    """
    with naming(folder):
        for part in PAGE.rglob("*"):
            if part.is_file():  # and not the folders themselves: their permissions would come along
                (folder / part.relative_to(PAGE)).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(part, folder / part.relative_to(PAGE))
        name = _copy_windows(model, folder) if model.is_dir() else _copy(model, folder / MODEL_NAME)
        frames = [] if clip is None else _write_frames(folder / "clip", clip)
        site = {"model": name, "clip": None if clip is None else {"name": clip.name, "frames": frames}, "refit": refit}
        (folder / SITE_NAME).write_text(json.dumps(site) + "\n", encoding="utf-8")


def model_path(model: Path) -> Path:
    """What the page opens of a model, which is a file or a folder."""
    return model / FILE_NAME if model.is_dir() else model


def point_to(folder: Path, model: str) -> None:
    """The page of a served `folder` opens another model from now on: one in it, `model` as in `site.json`."""
    site = json.loads((folder / SITE_NAME).read_text(encoding="utf-8"))
    with replacing(folder / SITE_NAME) as file:
        file.write_text(json.dumps(site | {"model": model}) + "\n", encoding="utf-8")


def export_site(folder: Path, model: Path, clip: Clip | None) -> None:
    """Makes `folder`, whole or not at all; `OutputError` where something is there that would be lost."""
    check_new_folder("--export", folder)
    with new_folder(folder) as temporary:
        write_site(temporary, model, clip)


def _copy(file: Path, copy: Path) -> str:
    """Returns the name of the copy."""
    shutil.copyfile(file, copy)
    return copy.name


def _copy_windows(model: Path, folder: Path) -> str:
    """Copies `windows.json` and the files that it names, and nothing else; returns the path of the former."""
    (folder / MODEL_FOLDER).mkdir()
    layout = Windows.load(model / FILE_NAME, ModelFileError)
    for name in [FILE_NAME, *(f"{window.name}.onnx" for window in layout.windows)]:
        _copy(model / name, folder / MODEL_FOLDER / name)
    return f"{MODEL_FOLDER}/{FILE_NAME}"


def _write_frames(folder: Path, clip: Clip) -> list[str]:
    folder.mkdir()
    names = [f"{folder.name}/{number:05d}.jpg" for number in range(len(clip))]
    for name, frame in zip(names, clip.frames, strict=True):
        (folder.parent / name).write_bytes(jpeg(frame, _JPEG_QUALITY, full_colour=True))
    return names
