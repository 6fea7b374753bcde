"""What a page of the documentation tells its reader to type, to be typed by a test."""

from __future__ import annotations

import importlib.util
import re
import shlex
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click

ROOT = Path(__file__).parents[1]
SCRIPTS: dict[str, str] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
"""Of each command, module and function."""
SOURCES = [str(ROOT / part) for part in ("", "export", "runtime", "eval")]
"""Where the packages are imported from."""
OF_TORCH = ("decomo-prepare", "decomo-train", "decomo-export")
"""Commands that load torch, which takes as long as all else that they do on a page."""

_BLOCK = re.compile(r"^(?P<comment><!-- (?P<mark>[^\n]*) -->\n)?```(?P<language>\w+)\n(?P<text>.*?)^```$", re.M | re.S)
_NEEDS = re.compile(r"needs ([\w.]+)")
_NUMBER = re.compile(r"\d[\d.e+-]*")
_FENCED = re.compile(r"^```.*?^```$", re.M | re.S)
_SHELL = re.compile(r"^```(?:sh|bash)\n(.*?)^```$", re.M | re.S)
_CODE = re.compile(r"`([^`]+)`")
_OPTION = re.compile(r"\B--[a-z][a-z0-9-]*")
"""As a program writes it where it declares it, or tells of it."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    language: str
    """sh, python: to be run; text: what the block before prints."""
    text: str
    line: int
    """Of the page, from 1, on which the fence opens."""
    not_run: str | None = None
    """Why it is not run here; None: it is."""


def blocks(page: Path) -> list[Block]:
    """The blocks of a page, in order.

    A comment in the line above a fence says what becomes of it. `<!-- not run: REASON -->`: nothing.
    `<!-- needs MODULE: HINT -->`: it is run where the module can be imported.
    """
    content = page.read_text(encoding="utf-8")
    found = []
    for match in _BLOCK.finditer(content):
        mark = match["mark"] or ""
        reason = mark.removeprefix("not run: ") if mark.startswith("not run: ") else None
        needed = _NEEDS.match(mark)
        if needed and not _is_there(needed[1]):
            reason = mark
        if mark and reason is None and not needed:
            raise ValueError(f"{page}: a comment above a block that says nothing to it: {mark}")
        line = content.count("\n", 0, match.start("language")) + 1
        found.append(Block(match["language"], match["text"], line, reason))
    return found


def _is_there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # nor is what holds it
        return False


def write_commands(folder: Path, python: str) -> Path:
    """Writes this tree's commands into `folder`, as an installation would; those of torch go to `warm_start.serve`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, place in SCRIPTS.items():
        module, function = place.split(":")
        script = folder / name
        lines = [f"from {module} import {function}", f"sys.exit({function}())"]
        if name in OF_TORCH:
            lines = [
                f"sys.path.append({str(ROOT / 'tests')!r})",
                "from warm_start import call",
                f"sys.exit(call({module!r}, {function!r}))",
            ]
        script.write_text("\n".join([f"#!{python}", "import sys", *lines, ""]))
        script.chmod(0o755)
    return folder


def missing(expected: str, printed: str) -> list[str]:
    """Lines of `expected` that were not printed in this order, numbers aside; `…` stands for any text."""
    lines = iter([line.strip() for line in re.split(r"[\r\n]+", printed)])
    wanted = [line.strip() for line in expected.splitlines() if line.strip()]
    for number, line in enumerate(wanted):
        pattern = re.compile(_likeness(line))
        if not any(pattern.fullmatch(each) for each in lines):
            return wanted[number:]
    return []


def _likeness(line: str) -> str:
    parts = (re.escape(part) for part in re.split(r"…", _NUMBER.sub("\0", line)))
    return ".*".join(parts).replace(re.escape("\0"), _NUMBER.pattern).replace("\\ ", r"\s+")


def shown_commands(page: Path) -> list[str]:
    """What a page shows of the shell: the lines of its blocks, and commands named in its sentences."""
    content = page.read_text(encoding="utf-8")
    lines = [line for text in _SHELL.findall(content) for line in text.replace("\\\n", " ").splitlines()]
    named = (" ".join(code.split()) for code in _CODE.findall(_FENCED.sub("", content)))
    return lines + [code for code in named if code.startswith(("decomo-", "python benchmarks/", "benchmarks/"))]


def unknown_options(line: str) -> Iterator[str]:
    """Options that our own commands and programs, in a line of the shell, do not have; commands that there are not."""
    words = shlex.split(line, comments=True)
    for place, word in enumerate(words):
        if place == 0 and re.fullmatch(r"decomo-[a-z]+", word) and word not in SCRIPTS:
            yield word
        known = _options(word)
        if known is None:
            continue
        rest = words[place + 1 :]
        ends = [end for end, each in enumerate(rest) if each in ("&&", "||", "|", ";", "&", "done")]
        yield from (
            f"{word} {option}"
            for option in rest[: min(ends, default=len(rest))]
            if option.startswith("--") and option.split("=")[0].rstrip(";") not in known
        )


def _options(word: str) -> set[str] | None:
    """Those of a command or of a program of `benchmarks/`; None: it is neither."""
    if word in SCRIPTS and word != "decomo":
        return _of_command(word)
    if word.startswith("benchmarks/") and word.endswith(".py"):
        return set(_OPTION.findall((ROOT / word).read_text(encoding="utf-8"))) | {"--help"}
    return None


def _of_command(name: str) -> set[str]:
    module = importlib.import_module(SCRIPTS[name].split(":")[0])
    commands = [each for each in vars(module).values() if isinstance(each, click.Command)]
    return {
        option
        for each in commands
        for parameter in each.params
        for option in (*parameter.opts, *parameter.secondary_opts)
    } | {"--help"}
