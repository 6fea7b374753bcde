"""The documentation as a site: built strictly, whole, and without a network."""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from decomotion.commands import COMMANDS

ROOT = Path(__file__).parents[2]
PACKAGES = ("decomotion", "decomo_export", "decomo_runtime", "decomo_eval")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `mkdocs build --strict` makes it: a link that leads nowhere, or a page that is not in `nav`, fails.

    Without torch: the packages are read, not imported.
    """
    for module in ("mkdocs", "material", "mkdocstrings", "mkdocs_click"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed: pip install -e '.[docs]'")
    out = tmp_path_factory.mktemp("site")
    hide_torch = tmp_path_factory.mktemp("hidden")
    (hide_torch / "torch.py").write_text("raise ImportError('torch is hidden')\n")
    paths = [str(hide_torch), *(str(ROOT / folder) for folder in (".", "export", "runtime", "eval"))]
    result = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, "\n".join(line for line in result.stderr.splitlines() if "INFO" not in line)
    return out


def test_every_command_has_a_section_with_its_options(site: Path):
    page = (site / "commands.html").read_text()
    assert "Sentinel" not in page  # of click, where an option has no default
    sections = [each for each in re.split(r'<h2 id="', page)[1:] if each.startswith("decomo-")]
    assert [section.split('"')[0] for section in sections] == [f"decomo-{each.name}" for each in COMMANDS]
    for section in sections:
        assert re.search(r"^ +(-\w, )?--[a-z]", re.sub(r"<[^>]+>", "", section), re.MULTILINE), section[:40]


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_in_the_reference(site: Path, package: str):
    pages = "".join(page.read_text() for page in (site / "api").glob("*.html"))
    names = [name for name in importlib.import_module(package).__all__ if name != "__version__"]
    assert [name for name in names if f'id="{package}.{name}"' not in pages] == []


def test_nothing_is_loaded_from_elsewhere(site: Path):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        loaded = re.findall(r"<(?:script|img|link|iframe|source)\b[^>]*?\b(?:src|href)=\"([^\"]+)", page.read_text())
        assert [each for each in loaded if re.match(r"(https?:)?//", each)] == [], page


def test_no_link_leaves_the_site(site: Path):
    """Neither does one to a file of the repository, which is not there."""
    for page in site.rglob("*.html"):
        if page.name == "404.html":  # served from any depth
            continue
        for target in re.findall(r"<a\b[^>]*?\bhref=\"(?!https?:)([^\"#?]+)", page.read_text()):
            path = (page.parent / target).resolve()
            assert path.is_relative_to(site.resolve()), (page, target)
            assert path.exists(), (page, target)
