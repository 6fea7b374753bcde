"""What the site does to pages that are read on GitHub too: links to files outside of `docs/` become their names.

The site holds `docs/` alone, and a link that leaves it would lead nowhere. Where `mkdocs.yml` has a `repo_url`, it
leads there.
"""

from __future__ import annotations

import posixpath
import re

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.pages import Page

LINK = re.compile(r"(?<!!)\[(?P<text>[^\]]+)\]\((?P<target>(?:\.\./)+[^)#\s]*)(?P<anchor>#[^)\s]*)?\)")


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **_: object) -> str:
    """The page's text with each link that leaves `docs/` brought to the repository, or to its words."""

    def within(link: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join(posixpath.dirname(page.file.src_uri), link["target"]))
        if not path.startswith("../"):
            return link[0]
        if config.repo_url:
            return f"[{link['text']}]({config.repo_url.rstrip('/')}/blob/main/{path[3:]}{link['anchor'] or ''})"
        return link["text"]

    return LINK.sub(within, markdown)
