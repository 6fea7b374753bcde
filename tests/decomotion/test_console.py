"""Exit codes and the one sentence that comes with them."""

from __future__ import annotations

import errno
import io
import logging
import threading
from collections.abc import Callable

import click
import pytest

import decomotion
from decomotion.console import run
from decomotion.errors import CheckpointError, ClipError, ConfigError, InputError, SupervisionError, TrainingError


def command_that(act: Callable[[], object]) -> click.Command:
    @click.command()
    @click.option("--steps", default=10, show_default=True)
    def command(steps: int) -> object:
        return act()

    return command


def raising(error: BaseException) -> click.Command:
    def act() -> None:
        raise error

    return command_that(act)


def test_success_is_0(capsys: pytest.CaptureFixture[str]):
    assert run(command_that(lambda: click.echo("done")), []) == 0
    assert capsys.readouterr() == ("done\n", "")


def test_help_is_0_and_shows_defaults(capsys: pytest.CaptureFixture[str]):
    assert run(raising(AssertionError("ran")), ["--help"]) == 0
    assert "[default: 10]" in capsys.readouterr().out


@pytest.mark.parametrize("family", [InputError, ClipError, ConfigError, CheckpointError, SupervisionError])
def test_bad_input_is_2_and_one_sentence(family: type[InputError], capsys: pytest.CaptureFixture[str]):
    assert run(raising(family("clip/ has one frame; motion needs at least two")), []) == 2
    assert capsys.readouterr() == ("", "Error: clip/ has one frame; motion needs at least two\n")


@pytest.mark.parametrize("argv", [["--stepz", "3"], ["--steps", "three"], ["surplus"]])
def test_bad_usage_is_2_and_names_the_argument(argv: list[str], capsys: pytest.CaptureFixture[str]):
    assert run(command_that(lambda: None), argv) == 2
    assert argv[-1 if argv[0] != "--stepz" else 0] in capsys.readouterr().err


def test_commands_of_a_group_tell_their_version_too(capsys: pytest.CaptureFixture[str]):
    group = click.Group("tool", commands=[raising(AssertionError("ran"))])
    for argv in (["--version"], ["command", "--version"]):
        assert run(group, argv) == 0
        assert capsys.readouterr().out.endswith(f" {decomotion.__version__}\n")


def test_what_the_output_s_encoding_lacks_is_escaped(monkeypatch: pytest.MonkeyPatch):
    output = io.TextIOWrapper(io.BytesIO(), encoding="cp1252", newline="")
    monkeypatch.setattr("sys.stdout", output)
    assert run(command_that(lambda: click.echo("clip café 猫")), []) == 0
    output.flush()
    assert output.buffer.getvalue() == "clip café ".encode("cp1252") + b"\\u732b\n"


def test_failed_optimisation_is_1(capsys: pytest.CaptureFixture[str]):
    assert run(raising(TrainingError("loss/flow is nan at step 12")), []) == 1
    assert capsys.readouterr().err == "Error: loss/flow is nan at step 12\n"


@pytest.mark.parametrize("interrupt", [KeyboardInterrupt(), click.Abort()])
def test_interrupt_is_130(interrupt: BaseException):
    assert run(raising(interrupt), []) == 130


def test_a_file_that_cannot_be_written_is_2_and_named(tmp_path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "file").write_text("in the way of a folder")
    assert run(command_that((tmp_path / "file" / "tracks.npz").touch), []) == 2
    assert capsys.readouterr().err == f"Error: {tmp_path / 'file' / 'tracks.npz'}: Not a directory\n"


def test_a_full_disk_is_2(capsys: pytest.CaptureFixture[str]):
    def write() -> None:
        with open("/dev/full", "w") as file:
            file.write("tracks")

    assert run(command_that(write), []) == 2
    assert capsys.readouterr().err == "Error: No space left on device\n"


@pytest.mark.parametrize(("error", "shown"), [(OSError(errno.ENOSPC, "full"), False), (ZeroDivisionError(), True)])
def test_a_full_disk_in_a_thread_is_told_by_who_waits_for_it(
    error: Exception, shown: bool, monkeypatch: pytest.MonkeyPatch
):
    seen: list[type[BaseException]] = []
    monkeypatch.setattr(threading, "excepthook", lambda failure: seen.append(failure.exc_type))

    def act() -> None:
        def fail() -> None:
            raise error

        thread = threading.Thread(target=fail)
        thread.start()
        thread.join(timeout=60)

    hook = threading.excepthook
    run(command_that(act), [])
    assert seen == ([type(error)] if shown else [])
    assert threading.excepthook is hook


@pytest.mark.parametrize(
    ("module", "extra"), [("torch.nn", "train"), ("torchvision.models", "raft"), ("timm", "dino"), ("jinja2", "report")]
)
def test_without_an_extra_it_says_what_to_install(module: str, extra: str, capsys: pytest.CaptureFixture[str]):
    assert run(raising(ModuleNotFoundError(f"No module named {module!r}", name=module)), []) == 2
    library = module.split(".")[0]
    assert capsys.readouterr().err == f"Error: {library} is not installed; run: pip install 'decomotion[{extra}]'\n"


@pytest.mark.parametrize(
    "bug", [ZeroDivisionError(), OSError("no file to name"), ModuleNotFoundError(name="decomotion.trian")]
)
def test_our_own_bugs_keep_their_traceback(bug: Exception):
    with pytest.raises(type(bug)):
        run(raising(bug), [])


def test_our_progress_is_shown_and_the_chatter_of_libraries_is_not(caplog: pytest.LogCaptureFixture):
    def report() -> None:
        logging.getLogger("decomo_eval.scoring").info("scored goat")
        logging.getLogger("onnxscript.rewriter").info("replaced an initializer")
        logging.getLogger("onnxscript.rewriter").warning("no rule for Foo")

    run(command_that(report), [])
    assert caplog.messages == ["scored goat", "no rule for Foo"]


def test_what_a_command_returns_is_the_exit_code_when_it_is_one():
    assert run(command_that(lambda: 3), []) == 3
    assert run(command_that(lambda: "text"), []) == 0
