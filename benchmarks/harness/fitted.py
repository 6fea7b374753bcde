"""Procedural clips as files, and models that are fitted to them in few steps."""

from __future__ import annotations

from pathlib import Path

import cv2

from harness.scenery import Scenery

QUALITY = 97
"""Of the clip's JPEGs."""


def written(scenery: Scenery, work: Path) -> Path:
    """The folder of its frames in `work`, as JPEGs; drawn where it is not there yet."""
    folder = work / scenery.name
    if not folder.is_dir():
        unfinished = work / f"{scenery.name}.partial"
        unfinished.mkdir(parents=True, exist_ok=True)
        for number, frame in enumerate(scenery.frames()):
            picture = cv2.cvtColor(frame, cv2.COLOR_RGB2BGR)
            cv2.imwrite(str(unfinished / f"{number:05d}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        unfinished.rename(folder)
    return folder


def fitted_model(clip: Path, steps: int, work: Path) -> Path:
    """The model file of a folder of frames after so many steps, in `work`; fitted where it is not there yet."""
    from decomo_export.cli import main as export
    from decomotion.cli import main as train

    run, model = work / f"{clip.name}-run", work / f"{clip.name}.onnx"
    if not model.is_file():
        fit = [clip, "--out", run, "--steps", steps, "--prepare-budget", "400s", "--shots", "ignore"]
        for command, arguments in ((train, fit), (export, [model, "--run", run, "--force"])):
            if command([str(argument) for argument in arguments]):
                raise SystemExit(1)
    return model
