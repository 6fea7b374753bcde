"""All commands, in the order of the work; pyproject.toml installs each by its own name, `decomo-NAME`, too."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """One command: `decomo NAME` and `decomo-NAME`."""

    name: str
    module: str
    """Whose `main` runs it."""
    function: str
    """Of the module, the click command."""
    purpose: str
    """For the list of commands."""


COMMANDS = (
    Command(
        "prepare", "decomotion.prepare_cli", "command", "Make a clip's supervision ahead of the fit, and look at it."
    ),
    Command("train", "decomotion.cli", "command", "Fit a model to a clip."),
    Command("export", "decomo_export.cli", "command", "Freeze a fitted model into one .onnx file."),
    Command("info", "decomo_runtime.info_cli", "info", "Show a model's card: its clip, its fit, how good it is."),
    Command("track", "decomo_runtime.cli", "track", "Follow points through the clip."),
    Command("convert", "decomo_runtime.convert_cli", "convert", "Bring tracks into the files of other tools."),
    Command("flow", "decomo_runtime.flow.cli", "flow", "Write where all pixels of a frame are in others."),
    Command("measure", "decomo_runtime.measure.cli", "measure", "Measure motion and strain, in units of length."),
    Command(
        "propagate", "decomo_runtime.propagation.cli", "propagate", "Carry what is drawn on a few frames to all others."
    ),
    Command(
        "render", "decomo_runtime.render_cli", "render", "Render static scene and objects, or the clip without them."
    ),
    Command("view", "decomo_runtime.view.cli", "view", "Look at a model in the browser: a click draws a path."),
    Command("batch", "decomotion.batch.cli", "command", "Fit, export and track all clips of a folder or list."),
    Command("eval", "decomo_eval.cli", "cli", "Score tracks against ground truth."),
    Command("bench", "decomo_eval.bench.cli", "command", "Fit, export and score all videos of a benchmark."),
    Command("sample", "decomo_eval.sample.cli", "command", "Write a procedural clip with exact ground truth."),
)
