"""YAML as plain values: mappings with text as keys, each of them once."""

from __future__ import annotations

from typing import Any

import yaml

_TEXT, _MERGE = "tag:yaml.org,2002:str", "tag:yaml.org,2002:merge"


class _Loader(yaml.SafeLoader):
    """PyYAML's own keeps the last of several values of one key, without a word."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = set()
        for key, _ in node.value:
            if key.tag not in (_TEXT, _MERGE):
                raise yaml.constructor.ConstructorError(None, None, "a key is no text", key.start_mark)
            if key.value in keys:
                raise yaml.constructor.ConstructorError(None, None, f"{key.value} is there twice", key.start_mark)
            keys.add(key.value)
        return super().construct_mapping(node, deep)


def parse(text: str) -> Any:
    """The value of a document; `ValueError` says what is wrong and where."""
    try:
        return yaml.load(text, _Loader)
    except Exception as error:  # constructors of numbers, dates and the like raise what they come upon
        raise ValueError(str(error) or type(error).__name__) from error
