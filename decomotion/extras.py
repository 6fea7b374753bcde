"""How to install a library that the base installation lacks."""

from __future__ import annotations

EXTRA_OF = {
    "torchvision": "raft",
    "timm": "dino",
    "huggingface_hub": "dino",
    "jinja2": "report",
    "matplotlib": "report",
}
"""The extra that installs a library; all others are of `train`."""


def remedy(library: str) -> str:
    """The command that installs what `library`, a module's name, comes with."""
    return f"pip install 'decomotion[{EXTRA_OF.get(library, 'train')}]'"
