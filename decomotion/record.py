"""`run.json`: what a run was begun with, from its first moment on; a run that is stopped early goes on from it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from decomotion.config import Config
from decomotion.errors import CheckpointError
from decomotion.files import replacing
from decomotion.schedule import Budget

FILE_NAME = "run.json"
CHECKPOINT = "checkpoint.pt"
"""Beside it, as soon as there is a model: `decomotion.checkpoint`, which needs torch."""

CORRECTIONS = "corrections.csv"
"""Beside it in a run that was made from another by corrections, which cannot be resumed: `decomotion.corrections`."""


@dataclass(frozen=True)
class Record:
    """What decides a run."""

    clip: str
    """Digest of its clip."""
    config: Config
    seed: int
    budget: Budget
    finished: bool = False
    """Whether the budget is spent."""

    def write(self, folder: Path) -> None:
        """Into the run's folder, whole or not at all."""
        content = {**asdict(self), "config": self.config.model_dump(mode="json")}
        with replacing(folder / FILE_NAME) as file:
            file.write_bytes(TypeAdapter(dict).dump_json(content, indent=1))

    def finish(self, folder: Path) -> None:
        """Notes that the budget is spent."""
        replace(self, finished=True).write(folder)

    def is_like(self, config: Config, seed: int) -> bool:
        """Whether these are the run's own, whatever time there is for preparation."""
        data = config.data.model_copy(update={"prepare_budget": self.config.data.prepare_budget})
        return seed == self.seed and config.model_copy(update={"data": data}) == self.config


def read_record(folder: Path) -> Record | None:
    """Of the run in `folder`; None where there is none. Raises `CheckpointError` where it is damaged."""
    file = folder / FILE_NAME
    if not file.is_file():
        return None
    try:
        return TypeAdapter(Record).validate_json(file.read_bytes())
    except ValidationError as error:
        raise CheckpointError(f"{file} does not tell what the run was begun with; train again") from error


def is_finished(folder: Path) -> bool:
    """Whether the budget of the run in `folder` is spent. Raises `CheckpointError` as `read_record`."""
    found = read_record(folder)
    return found is not None and found.finished and (folder / CHECKPOINT).is_file()


def check_resumable(folder: Path) -> None:
    """Raises `CheckpointError` where the run in `folder` was made from another by corrections."""
    if (folder / CORRECTIONS).is_file():
        raise CheckpointError(
            f"{folder} was made by corrections and is finished; give them to decomo-train --run --corrections again, "
            "with a longer --time-budget, or correct this one further"
        )
