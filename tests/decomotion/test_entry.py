"""`decomo` and its table: the same commands as those with hyphens, loaded when they are asked for."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import click
import cv2
import numpy as np
import pytest

from decomotion import __version__
from decomotion.commands import COMMANDS, Command
from decomotion.entry import decomo, main

ROOT = Path(__file__).parents[2]
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
each_command = pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)


def modules_after(*argv: str) -> set[str]:
    """What a process has loaded after `decomo` ran on `argv`."""
    code = "import sys; from decomotion.entry import main; main(sys.argv[1:]); print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code, *argv], capture_output=True, text=True, timeout=60, check=True)
    return set(done.stderr.split())


def test_what_is_installed_is_the_table():
    assert {
        "decomo": "decomotion.entry:main",
        **{f"decomo-{command.name}": f"{command.module}:main" for command in COMMANDS},
    } == SCRIPTS


def test_help_lists_all_in_the_order_of_the_work(capsys: pytest.CaptureFixture[str]):
    assert main(["--help"]) == 0
    listed = re.findall(r"^  ([a-z]+)  +(.*\.)$", capsys.readouterr().out.partition("Commands:")[2], re.MULTILINE)
    assert listed == [(command.name, command.purpose) for command in COMMANDS]
    names = [command.name for command in COMMANDS]
    work = ["prepare", "train", "export", "track", "render", "view", "eval"]
    assert [name for name in names if name in work] == work
    assert decomo.list_commands(click.Context(decomo)) == names  # what a shell completes


def test_help_loads_no_command():
    loaded = modules_after("--help")
    assert not loaded & {command.module for command in COMMANDS}
    assert not loaded & {"numpy", "torch", "cv2", "onnxruntime"}


def test_a_command_loads_no_other():
    loaded = modules_after("track", "--help")
    assert loaded & {command.module for command in COMMANDS} == {"decomo_runtime.cli"}


@each_command
def test_both_names_are_one_command(command: Command, capsys: pytest.CaptureFixture[str]):
    module = import_module(command.module)
    assert isinstance(getattr(module, command.function), click.Command)
    texts = []
    for run, argv in ((module.main, ["--help"]), (main, [command.name, "--help"])):
        assert run(argv) == 0
        usage, _, text = capsys.readouterr().out.partition("\n")
        assert usage.startswith("Usage: ")
        texts.append(text.replace("-h, --help", "--help    "))
    assert "--version" in texts[0]
    assert re.sub(r"\s+", " ", texts[0]) == re.sub(r"\s+", " ", texts[1])


@pytest.mark.parametrize("argv", [[], *([command.name] for command in COMMANDS)])
def test_version(argv: list[str], capsys: pytest.CaptureFixture[str]):
    assert main([*argv, "--version"]) == 0
    assert capsys.readouterr().out.endswith(f" {__version__}\n")


@each_command
def test_version_by_the_other_name(command: Command, capsys: pytest.CaptureFixture[str]):
    for _ in range(2):  # the option is there once
        assert import_module(command.module).main(["--version"]) == 0
        assert capsys.readouterr().out.endswith(f" {__version__}\n")


def test_bad_input_is_told_as_by_the_other_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    argv = [str(tmp_path / "no.onnx"), "--point", "0,1,2", "--out", str(tmp_path / "a.npz")]
    told = []
    for run, words in ((import_module("decomo_runtime.cli").main, argv), (main, ["track", *argv])):
        assert run(words) == 2
        told.append(capsys.readouterr())
    assert told[0] == told[1]
    assert told[0].err.startswith("Error: ")


def test_without_torch_it_says_what_to_install(tmp_path: Path):
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((24, 40, 3), np.uint8))
    hidden = "import sys; sys.modules['torch'] = None; from decomotion.entry import main; sys.exit(main(sys.argv[1:]))"
    asked = [sys.executable, "-c", hidden, "train", str(tmp_path), "--out", str(tmp_path / "run")]
    done = subprocess.run(asked, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert (
        done.stderr.splitlines(keepends=True)[-1]
        == "Error: torch is not installed; run: pip install 'decomotion[train]'\n"
    )


def test_no_such_command(capsys: pytest.CaptureFixture[str]):
    assert main(["trian"]) == 2
    assert "No such command 'trian'" in capsys.readouterr().err


def test_the_program_s_name_is_in_the_usage():
    code = "import sys; sys.argv[0] = 'decomo'; from decomotion.entry import main; sys.exit(main())"
    done = subprocess.run([sys.executable, "-c", code, "flow"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("Usage: decomo flow [OPTIONS] MODEL\nTry 'decomo flow --help' for help.")
