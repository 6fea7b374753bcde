"""What the README and the pages of docs/ keep to."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from docs_pages import shown_commands, unknown_options

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
PAGES = [ROOT / "README.md", *sorted(p for p in (ROOT / "docs").rglob("*.md") if "research" not in p.parts)]
LOG = sorted((ROOT / "docs" / "research").glob("*.md"))

FOLDERS = ("decomotion", "export/decomo_export", "runtime/decomo_runtime", "eval/decomo_eval")
MOST_WORDS = 40
"""Of a sentence; a semicolon or colon ends one."""
HISTORY = re.compile(r"\b(as before|no longer|used to be|formerly|previously|since then|was not kept)\b", re.IGNORECASE)


def named(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def prose(page: Path) -> str:
    """The page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)


def test_readme_is_short():
    assert len(README.splitlines()) <= 130


def test_readme_has_one_headline_with_its_command_machine_and_date():
    paragraph = README.split("<!-- the headline", 1)[1].split("-->", 1)[1].strip().split("\n\n")[0]
    assert len(re.findall(r"\*\*[\d.]+\*\*", README)) == len(re.findall(r"\*\*[\d.]+\*\*", paragraph)) == 1
    assert "benchmarks/" in paragraph
    assert re.search(r"\bon\s+an?\s+[A-Z]", paragraph)
    assert re.search(r"\b20\d\d-\d\d-\d\d\b", paragraph)
    figure = re.search(r"\*\*([\d.]+)\*\*", paragraph)
    assert figure is not None
    assert f"**{figure[1]} / " in (ROOT / "docs" / "benchmarks.md").read_text(), "the table says something else"


def test_the_moving_picture_moves_and_is_small():
    picture = (ROOT / "docs" / "images" / "tracks.webp").read_bytes()
    assert picture[8:12] == b"WEBP"
    assert b"ANIM" in picture[:64]
    assert len(picture) < 3_000_000
    assert "docs/images/tracks.webp" in README


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_a_page_says_what_is(page: Path):
    """History, and what was tried, is in the research log; a commit says nothing to a reader."""
    text = prose(page)
    assert HISTORY.findall(text) == []
    assert re.findall(r"\bcommit `?[0-9a-f]{7,}", text) == []


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=named)
def test_commands_that_are_shown_have_these_options(page: Path):
    assert [each for line in shown_commands(page) for each in unknown_options(line)] == []


def test_an_option_that_a_command_lacks_is_seen():
    line = "for f in a; do decomo-sample a --size 3 --seeds 4; done"
    assert list(unknown_options(line)) == ["decomo-sample --seeds"]
    assert list(unknown_options("decomo-trane clip --steps 3")) == ["decomo-trane"]
    line = "python benchmarks/preparation.py CLIP --frames 3 --sizes 3x3 && decomo-track m.onnx --grids=3@0"
    assert list(unknown_options(line)) == ["benchmarks/preparation.py --sizes", "decomo-track --grids=3@0"]


def test_commands_are_found_in_blocks_and_sentences(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text("Give `decomo-track m.onnx\n--grid 3@0` or `--grid`.\n```sh\na \\\n  b\n```\n```text\nc\n```\n")
    assert shown_commands(page) == ["a    b", "decomo-track m.onnx --grid 3@0"]


def sentences(page: Path) -> list[str]:
    """Those of the page's paragraphs and lists; a link, and what is set as code, is as long as what is read of it."""
    text = re.sub(r"^(?:[|#!]|<!--).*$", "", prose(page), flags=re.MULTILINE)
    text = re.sub(r"`[^`]*`", "code", re.sub(r"\]\([^)]*\)", "]", text))
    paragraphs = re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", text)
    return [sentence for each in paragraphs for sentence in re.split(r"(?<=[.!?:;])\s+", each)]


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_sentences_are_short(page: Path):
    assert [each for each in sentences(page) if len(each.split()) > MOST_WORDS] == []


@pytest.mark.parametrize("page", [*PAGES, *LOG], ids=named)
def test_cells_of_tables_are_short(page: Path):
    rows = [line for line in prose(page).splitlines() if line.startswith("|")]
    assert [cell for row in rows for cell in row.split("|") if len(cell) > 500] == []


def said_by_programs() -> str:
    """All text of our packages, a line for each; what is put into it when it is said is `…`."""

    def text(node: ast.AST) -> str | None:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return re.sub(r"%[.\dl]*[a-z]", "…", node.value)
        if isinstance(node, ast.JoinedStr):
            return "".join(text(part) or "…" for part in node.values)
        return None

    files = (file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py"))
    nodes = (node for file in files for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    return "\n".join(found for node in nodes if (found := text(node)))


def test_what_programs_are_told_to_say_they_say():
    """Sentences of the table of troubleshooting."""
    table = (ROOT / "docs" / "troubleshooting.md").read_text().split("\n| it says |")[1].split("\n\n")[0]
    quoted = [cell[1:-1] for cell in re.findall(r"^\| (`[^|]+`) \|", table, re.MULTILINE)]
    assert len(quoted) > 12
    said = said_by_programs()
    assert [each for each in quoted if each not in said] == []


def test_no_two_pages_have_one_title():
    titles = [page.read_text().partition("\n")[0] for page in [*PAGES[1:], *LOG] if page.name != "index.md"]
    assert sorted(title for title in set(titles) if titles.count(title) > 1) == []


def test_what_was_not_run_is_said_in_one_place():
    place = (ROOT / "docs" / "limits.md").read_text().split("\n## What was not run\n")[1]
    assert [what for what in ("Windows", "macOS", "hosted notebook", "PyPI", "3.13") if what not in place] == []
    for page in ("docs/index.md", "docs/install.md"):
        assert "limits.md#what-was-not-run" in (ROOT / page).read_text()


@pytest.mark.parametrize("page", LOG, ids=named)
def test_an_entry_of_the_log_says_what_was_measured_or_decided(page: Path):
    for entry in re.split(r"^### (?=[SKM]\d+$)", page.read_text(), flags=re.MULTILINE)[1:]:
        assert re.search(r"^(Measured|Verdict):", entry, re.MULTILINE), entry[:60]
