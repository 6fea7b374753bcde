"""What the site makes of pages that are read on GitHub too.

Links to files outside of `docs/` would lead nowhere: they lead to the `repo_url` of `mkdocs.yml`, or become mere words.
The page of commands gets a section for each command of the table.
"""

from __future__ import annotations

import posixpath
import re

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.pages import Page

from decomotion.commands import COMMANDS, Command

LINK = re.compile(r"(?<!!)\[(?P<text>[^\]]+)\]\((?P<target>(?:\.\./)+[^)#\s]*)(?P<anchor>#[^)\s]*)?\)")
PLACE = "<!-- commands -->"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **_: object) -> str:
    """The page's text as the site has it."""

    def within(link: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join(posixpath.dirname(page.file.src_uri), link["target"]))
        if not path.startswith("../"):
            return link[0]
        if config.repo_url:
            return f"[{link['text']}]({config.repo_url.rstrip('/')}/blob/main/{path[3:]}{link['anchor'] or ''})"
        return link["text"]

    return LINK.sub(within, markdown.replace(PLACE, commands()))


def commands() -> str:
    """A table of all commands, in the order of the work, and a section for each."""
    rows = [f"| [`decomo-{each.name}`](#decomo-{each.name}) | {each.purpose} |" for each in COMMANDS]
    return "\n".join(["| command | |", "|---|---|", *rows, *map(section, COMMANDS)])


def section(command: Command) -> str:
    """What mkdocs-click makes a section of."""
    return f"""

::: mkdocs-click
    :module: {command.module}
    :command: {command.function}
    :prog_name: decomo-{command.name}
    :depth: 1
    :style: plain
"""
