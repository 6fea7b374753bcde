"""Files as the tools read them: by point and by frame of the tool, places in its own coordinates.

Each follows what the tool's own importer, or another program's reader of its files, does.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

Read = dict[str, dict[int, tuple[float, float]]]


def read_nuke(text: str) -> Read:
    """The curves of a Tracker4, in the frames in which its track is enabled."""
    table = dict(pairs(nodes(text)["Tracker4"]))["tracks"]
    (version, width, count), columns, rows = table
    names = [column[4] for column in columns]
    assert (version, int(width), int(count)) == ("1", len(names), len(rows))
    found: Read = {}
    for row in rows:
        assert len(row) == len(names)
        cells = dict(zip(names, row, strict=True))
        x, y, on = (read_curve(cells[name]) for name in ("track_x", "track_y", "e"))
        assert x.keys() == y.keys()
        for frame in range(min(x), max(x) + 2):
            assert bool(held(on, frame)) == (frame in x)
        assert not held(on, min(x) - 1) or min(x) == min(on)
        found[cells["name"]] = {frame: (x[frame], y[frame]) for frame in x}
    return found


def read_corner_pin(text: str) -> dict[str, Any]:
    """The knobs of a CornerPin2D: of `to`, a curve each for x and y; of `from`, numbers; the label."""
    knobs = dict(pairs(nodes(text)["CornerPin2D"]))
    curves = {name: tuple(map(read_curve, knobs[name])) for name in ("to1", "to2", "to3", "to4")}
    places = {name: tuple(map(float, knobs[name])) for name in ("from1", "from2", "from3", "from4")}
    return curves | places | {"label": knobs["label"]}


def nodes(text: str) -> dict[str, list[Any]]:
    """The nodes of a script by class; Tcl's lines before the first are commands."""
    commands, _, rest = text.partition("push $cut_paste_input\n")
    assert commands == "set cut_paste_input [stack 0]\nversion 12.0 v1\n"
    words = tcl(rest)
    return dict(zip(words[::2], words[1::2], strict=True))


def pairs(words: list[Any]) -> Iterator[tuple[str, Any]]:
    return zip(words[::2], words[1::2], strict=True)


def tcl(text: str) -> list[Any]:
    """Words, braces being lists."""
    stack: list[list[Any]] = [[]]
    for token in re.findall(r'[{}]|"[^"]*"|[^\s{}]+', text):
        if token == "{":
            stack.append([])
        elif token == "}":
            closed = stack.pop()
            stack[-1].append(closed)
        else:
            stack[-1].append(token.strip('"'))
    assert len(stack) == 1
    return stack[0]


def read_curve(words: list[str]) -> dict[int, float]:
    """Keys of `{curve [K] xFRAME VALUE ...}`."""
    assert words[0] == "curve"
    keys = [word for word in words[1:] if word != "K"]
    return {int(frame.removeprefix("x")): float(value) for frame, value in zip(keys[::2], keys[1::2], strict=True)}


def held(keys: dict[int, float], frame: int) -> float:
    """A curve with constant steps: its first key holds before it too."""
    return keys[max((key for key in keys if key <= frame), default=min(keys))]


def read_after_effects(text: str) -> tuple[dict[str, float], dict[tuple[str, ...], dict[int, tuple[float, ...]]]]:
    """What its clipboard says of the source, and the keys of each property by its path."""
    head, *sections, last = text.split("\n\n")
    assert (head, last) == ("Adobe After Effects 8.0 Keyframe Data", "\nEnd of Keyframe Data\n")
    source = {name: float(value) for _, name, value in (line.split("\t") for line in sections[0].split("\n"))}
    properties = {}
    for section in sections[1:]:
        path, columns, *rows = section.split("\n")
        assert columns.startswith("\tFrame\t")
        assert columns.endswith("\t")
        cells = [row.split("\t") for row in rows]
        assert all(first == last == "" and len(row) == columns.count("\t") - 1 for first, *row, last in cells)
        properties[tuple(path.split("\t"))] = {int(row[1]): tuple(map(float, row[2:-1])) for row in cells}
    return source, properties


def read_3dequalizer(text: str) -> Read:
    lines = iter(text.splitlines())
    found: Read = {}
    for _ in range(int(next(lines))):
        name, colour, count = next(lines), next(lines), int(next(lines))
        assert colour == "0"
        assert count > 0
        keys = [next(lines).split() for _ in range(count)]
        found[name] = {int(frame): (float(x), float(y)) for frame, x, y in keys}
    assert next(lines, None) is None
    return found


def read_syntheyes(text: str) -> tuple[Read, dict[tuple[str, int], int]]:
    """Places, and the outcome codes by point and frame; lines of a tracker follow each other, frames rise."""
    found: Read = {}
    outcomes = {}
    for line in text.splitlines():
        name, frame, u, v, outcome = line.split(" ")
        assert name in (next(reversed(found), name), name)
        assert name == next(reversed(found), name) or name not in found
        assert int(frame) > max(found.get(name, {-1: ()}))
        found.setdefault(name, {})[int(frame)] = float(u), float(v)
        outcomes[name, int(frame)] = int(outcome)
    return found, outcomes


def read_pftrack(text: str) -> Read:
    head, *blocks = text.split("\n\n")
    assert all(line.startswith("# ") for line in head.splitlines())
    found: Read = {}
    for block in blocks:
        name, clip, count, *keys = block.splitlines()
        assert (name[0], name[-1], clip) == ('"', '"', "1")
        assert int(count) == len(keys)
        cells = [key.split(" ") for key in keys]
        assert {similarity for *_, similarity in cells} == {"1.000000"}
        found[name.strip('"')] = {int(frame): (float(x), float(y)) for frame, x, y, _ in cells}
    return found
