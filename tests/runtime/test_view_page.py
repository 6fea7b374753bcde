"""The committed page is the build of the committed sources: told by digests, without Node."""

from __future__ import annotations

import json
import re
import runpy
from hashlib import sha256
from pathlib import Path

from decomo_runtime.view.server import CONTENT_SECURITY_POLICY
from decomo_runtime.view.site import PAGE

WEB = Path(__file__).parents[2] / "runtime" / "web"
NAMED = (
    "../decomo_runtime/expected_error.json",
    "index.html",
    "package-lock.json",
    "package.json",
    "tsconfig.json",
    "vite.config.ts",
)
RECORD = json.loads((PAGE / "build.json").read_text())
BUILD_AGAIN = "build the page again: cd runtime/web && npm ci && npm run build"


def digest_of_sources() -> str:
    """As `digests` in `vite.config.ts` computes it."""
    names = sorted([*NAMED, *(file.relative_to(WEB).as_posix() for file in (WEB / "src").rglob("*") if file.is_file())])
    lines = [f"{name} {sha256((WEB / name).read_bytes()).hexdigest()}\n" for name in names]
    return sha256("".join(lines).encode()).hexdigest()


def test_page_is_built_from_these_sources():
    assert RECORD["sources"] == digest_of_sources(), BUILD_AGAIN


def test_page_holds_what_was_built_and_nothing_else():
    files = {
        file.relative_to(PAGE).as_posix(): sha256(file.read_bytes()).hexdigest()
        for file in PAGE.rglob("*")
        if file.is_file() and file.name != "build.json"
    }
    assert files == RECORD["files"], BUILD_AGAIN


def test_page_is_small_enough_to_be_committed():
    assert sum(file.stat().st_size for file in PAGE.rglob("*") if file.is_file()) < 26e6


def test_page_and_server_set_the_same_policy():
    policy = re.search(r'http-equiv="Content-Security-Policy"\s+content="([^"]+)"', (PAGE / "index.html").read_text())
    assert policy is not None
    assert f"{policy[1]}; frame-ancestors 'none'" == CONTENT_SECURITY_POLICY  # which a page cannot say of itself


def test_page_opened_as_a_file_says_how_to_open_it():
    """Browsers run none of its scripts then."""
    assert re.search(r'<p id="loading">[^<]*decomo-view[^<]*</p>', (PAGE / "index.html").read_text())


def test_page_names_no_other_host():
    for name in ("index.html", "assets/index.css"):
        assert not re.search(r"https?://|src=\"//", (PAGE / name).read_text())


def test_what_the_page_shares_with_the_runtime_is_the_runtime_s():
    written = runpy.run_path(str(WEB / "contract.py"))
    assert written["TARGET"].read_text() == written["as_typescript"](), "write it again: python runtime/web/contract.py"
