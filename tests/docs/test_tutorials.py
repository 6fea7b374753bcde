"""Each tutorial, run from its own text in an empty folder."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import warm_start
from children import child, run_with_all
from docs_pages import ROOT, SOURCES, Block, blocks, missing, write_commands
from refitting import lives, wait_until

PAGES = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
SECONDS = 600
"""That a block may take: some ten are usual."""
SESSION = 7200
"""That all of them may take."""
LANGUAGES = {"sh", "python", "text", "csv", "yaml"}

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]  # on a machine that does much else


@dataclass(frozen=True)
class Begun:
    """What a block has made in an empty folder, and printed."""

    folder: Path
    printed: str


@pytest.fixture(scope="session")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Of a shell that has this tree's commands, and one thread."""
    folder = tmp_path_factory.mktemp("bin")
    paths = [str(write_commands(folder, sys.executable)), str(Path(sys.executable).parent), os.environ["PATH"]]
    variables = {
        **os.environ,
        "PATH": os.pathsep.join(paths),
        "PYTHONPATH": os.pathsep.join(SOURCES),
        "PYTHONUTF8": "1",
        "OMP_NUM_THREADS": "1",
        "MPLBACKEND": "Agg",
        warm_start.ADDRESS: str(folder / "warm"),
    }
    with child([sys.executable, warm_start.__file__, folder / "warm"], variables, SESSION) as server:
        assert server.stdout is not None
        assert server.stdout.readline() == "ready\n"
        yield variables


def run(block: Block, environment: dict[str, str], folder: Path, seconds: float = SECONDS) -> str:
    """What the block prints, both streams in one."""
    start = [sys.executable, "-c"] if block.language == "python" else ["bash", "-euo", "pipefail", "-c"]
    code, printed = run_with_all([*start, block.text], folder, environment, seconds)
    assert code == 0, f"the block of line {block.line} ends with {code}:\n{printed[-4000:]}"
    return printed


@pytest.fixture(scope="session")
def beginnings(environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path], Begun]:
    """What the first block of a page makes in an empty folder: once of those that begin with the same one."""
    known: dict[str, Begun] = {}

    def begin(page: Path) -> Begun:
        first = blocks(page)[0]
        if first.text not in known:
            folder = tmp_path_factory.mktemp("begun")
            known[first.text] = Begun(folder, run(first, environment, folder))
        return known[first.text]

    return begin


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_a_tutorial_says_works(
    page: Path, environment: dict[str, str], beginnings: Callable[[Path], Begun], tmp_path: Path
):
    begun = beginnings(page)
    shutil.copytree(begun.folder, tmp_path, dirs_exist_ok=True)
    printed = begun.printed
    for block in blocks(page)[1:]:
        if block.language in ("sh", "python"):
            printed = "" if block.not_run else run(block, environment, tmp_path)
        elif block.language == "text" and printed:
            lacking = missing(block.text, printed)
            assert not lacking, f"line {block.line}: not printed: {lacking[0]}\nbut:\n{printed[-4000:]}"


@pytest.mark.parametrize(
    ("page", "block"),
    [
        pytest.param(page, block, id=f"{page.stem}:{block.line}")
        for page in PAGES
        for block in blocks(page)
        if block.not_run
    ],
)
def test_what_is_not_run_is_told(page: Path, block: Block):
    assert block.not_run is not None
    pytest.skip(f"{page.name}, line {block.line}: {block.not_run}")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_tutorial_tells_its_time_and_its_blocks_have_a_language(page: Path):
    text = page.read_text(encoding="utf-8")
    assert re.search(r"^\*\*Time\.\*\* ", text, re.M)
    assert {block.language for block in blocks(page)} <= LANGUAGES
    assert 2 * len(blocks(page)) == len(re.findall(r"^```", text, re.M)), "a fence without a language, or indented"


def test_a_block_that_does_not_end_is_ended_with_its_children(environment: dict[str, str], tmp_path: Path):
    block = Block("sh", "sleep 600 & echo $! > child; wait", 1)
    with pytest.raises(subprocess.TimeoutExpired):
        run(block, environment, tmp_path, seconds=3)  # bash has long begun by then
    process = int((tmp_path / "child").read_text())
    wait_until(lambda: not lives(process))


WARM = """
import os, subprocess, sys

def main():
    print(sys.argv[1:], os.environ["SAID"], os.getcwd(), "torch" in sys.modules)
    print("to errors", file=sys.stderr)
    if "wait" in sys.argv:
        open("children", "w").write(f"{os.getpid()} {subprocess.Popen(['sleep', '600']).pid}")
        os.rename("children", "child")
        os.wait()
    if "fail" in sys.argv:
        raise RuntimeError("no such luck")
    sys.exit(int(sys.argv[-1]))
"""
CALL = "import sys, warm_start; sys.exit(warm_start.call('told', 'main'))"


def test_a_warm_command_is_like_one_of_its_own(
    environment: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    Path("told.py").write_text(WARM)
    own = {**environment, "SAID": "so", "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT / "tests")])}
    called = [sys.executable, "-c", CALL]
    answer = run_with_all([*called, "a b", "3"], tmp_path, own, SECONDS)
    assert answer == (3, f"['a b', '3'] so {tmp_path} True\nto errors\n")
    code, printed = run_with_all([*called, "fail"], tmp_path, own, SECONDS)
    assert code == 1
    assert printed.endswith("RuntimeError: no such luck\n")
    with child([*called, "wait"], own) as waiting:
        wait_until(Path("child").exists)
        waiting.kill()
        for each in Path("child").read_text().split():
            wait_until(lambda each=each: not lives(int(each)))


def test_lines_are_compared_but_for_their_numbers():
    assert missing("12 points, 3.5 s\n…done", "7 points, 0.1 s\r\nnoise\nall done\n") == []
    assert missing("12 points", "twelve points") == ["12 points"]
    assert missing("a\nb", "b\na") == ["b"], "in this order"
