"""How far an answer may be from the truth, in pixels: `Tracks.error`.

An answer's error e is told so that of answers that are told e, `SHARE` are within e of the truth. It is made of what
the model itself says of an answer, its occlusion score, which grows where the way there and back does not close; of the
frames between query and answer; and of how far the fit is from links that were held out of it, where its file says so:

    e = unit * curve(score) * gap^gap_power * (median / typical_median)^quality_power

and of an answer that was found in the clip's own pixels (`refinement.py`), refined_factor times that.

The distances of answers that are told e from the truth are spread so that of them

    1 / (1 + (1 / SHARE - 1) * (e / distance)^TAIL)

are within a distance: half of them within 0.4 e, nine of ten within 1.7 e.

The numbers are in `expected_error.json`, measured by `benchmarks/calibration.py` on clips whose truth is known where
they are in sight: of a hidden answer e is what it would be if the point were in sight after all.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from decomo_runtime.model_file import ModelFacts
from decomotion.units import unit

FILE = Path(__file__).with_suffix(".json")
LOWEST_SCORE = 1e-3
"""Scores below it tell nothing more."""
FARTHEST_FACTOR = 4.0
"""At most, for the quality of a fit, either way: beyond it nothing was measured."""

TAIL = 1.5
"""How fast shares within distances near all, by the same clips (`benchmarks/calibration.py`)."""
NEAR = 4.0
"""Units within which an answer is taken for right where a likelihood is told: the middle of TAP-Vid's thresholds."""

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Calibration:
    """The numbers of the rule above."""

    share: float
    """Of answers told e that are within e of the truth."""
    scores: tuple[float, ...]
    """Occlusion scores, rising, from `LOWEST_SCORE` to 1 at most."""
    errors: tuple[float, ...]
    """The curve's values there, units, not falling; between them it is straight in logarithms of both."""
    gap_power: float
    quality_power: float
    typical_median: float
    """Units that held-out links are missed by in the median, in a fit whose quality changes nothing."""
    refined_factor: float = 1.0
    clips: tuple[str, ...] = ()
    """By which the numbers were measured."""

    def error(
        self, score: npt.NDArray[np.floating], gap: npt.NDArray[np.integer], median: float | None
    ) -> npt.NDArray[np.float32]:
        """In units, of answers with these scores so many frames from their queries; arrays of shapes that go together.

        `median` is that of the fit's held-out links, in units; None where it is not known.
        """
        scores, errors = np.log(self.scores), np.log(self.errors)
        log_error = np.interp(np.log(np.maximum(score, LOWEST_SCORE)), scores, errors)
        log_error += self.gap_power * np.log(np.maximum(gap, 1)) + np.log(self.quality_factor(median))
        return np.where(gap == 0, 0, np.exp(log_error)).astype(np.float32)

    def quality_factor(self, median: float | None) -> float:
        """What the quality of a fit makes of an error."""
        if median is None:
            return 1.0
        factor = (max(median, 1e-9) / self.typical_median) ** self.quality_power
        return float(np.clip(factor, 1 / FARTHEST_FACTOR, FARTHEST_FACTOR))

    def save(self, path: Path) -> None:
        """Writes what `load` reads."""
        path.write_text(json.dumps(asdict(self), indent=2) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Calibration:
        """Of a file that `save` wrote."""
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        lists = {key: tuple(content[key]) for key in ("scores", "errors", "clips")}
        return cls(**{**content, **lists})


@cache
def calibration() -> Calibration:
    """That of this version."""
    return Calibration.load(FILE)


def expected_error(
    score: Floats, queries: npt.NDArray[np.floating], frames: Sequence[int] | npt.NDArray[np.int64], model: ModelFacts
) -> Floats:
    """[N, M], pixels of the clip, of answers with occlusion `score` [N, M] to `queries` [N, 3] in `frames` [M].

    0 in the query's own frame.
    """
    gap = np.abs(np.asarray(frames) - queries[:, :1].astype(np.int64))
    median = None if model.quality is None else model.quality.all.median
    return calibration().error(score, gap, median) * np.float32(unit(model.height, model.width))


def refined_error(error: Floats, refined: npt.NDArray[np.bool_]) -> Floats:
    """[N, M], of answers of which some are `refined`, from the model's own."""
    return np.where(refined, np.float32(calibration().refined_factor), np.float32(1)) * error


def share_within(
    error: npt.NDArray[np.floating], distance: float, share: float, tail: float = TAIL
) -> npt.NDArray[np.float64]:
    """[...], of answers that are told errors [...], of which `share` are within, those that are within `distance`.

    1 where the error is 0, and 0 where it is no number.
    """
    over = np.nan_to_num(error.astype(np.float64), nan=np.inf, posinf=np.inf).clip(0) / distance
    return 1 / (1 + (1 / share - 1) * over**tail)


def chance_near(error: npt.NDArray[np.floating], height: int, width: int) -> npt.NDArray[np.float64]:
    """[...], the chance of answers with these expected errors, pixels, to be within `NEAR` units of the truth."""
    return share_within(error, NEAR * unit(height, width), calibration().share)
