"""Writes `src/model/contract.ts`, what the page shares with the runtime, which states it.

python runtime/web/contract.py
"""

from __future__ import annotations

import json
from pathlib import Path

from decomo_runtime import contract

TARGET = Path(__file__).parent / "src" / "model" / "contract.ts"
NAMES = (
    "FORMAT_VERSION",
    "INPUTS",
    "TRACKING",
    "APPEARANCE",
    "OUTPUTS",
    "REQUIRED_OUTPUTS",
    "LAYERS",
    "FARTHEST",
    "HOLE",
)


def as_typescript() -> str:
    """The text of `TARGET`."""
    lines = [f"export const {name} = {json.dumps(getattr(contract, name))} as const;\n" for name in NAMES]
    return "".join(["/** Of `decomo_runtime/contract.py`, written by `contract.py`: do not edit. */\n\n", *lines])


if __name__ == "__main__":
    TARGET.write_text(as_typescript(), encoding="utf-8")
