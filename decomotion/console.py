"""The shell of every command: runs a click command and turns `InputError` into one sentence and exit code 2."""

from __future__ import annotations

import _thread
import io
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

import click

from decomotion.errors import InputError, TrainingError
from decomotion.extras import remedy
from decomotion.files import DISK_FAILURES

if sys.platform == "win32":
    import _winapi
    import msvcrt

BAD_INPUT = 2
INTERRUPTED = 130
ENDS_WITH_STDIN = "DECOMO_ENDS_WITH_STDIN"
"""Environment variable: with it a command ends when its standard input is closed, as whoever began it has ended."""
PATIENCE = 20
"""Seconds that such a command has to end as by Ctrl-C; a fit saves itself then."""
_GLANCE = 0.5
"""Seconds between two looks at standard input on Windows."""
OUR_PACKAGES = ("decomotion", "decomo_export", "decomo_runtime", "decomo_eval")


def run(command: click.Command, argv: Sequence[str] | None = None) -> int:
    """Runs `command` on `argv` (default: the process's arguments) and returns the exit code.

    0 when it worked, 2 after bad input, a file that cannot be read or written, or a library of an extra that
    is not installed, 1 after a failed optimisation, 130 after Ctrl-C.
    """
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    for package in OUR_PACKAGES:
        logging.getLogger(package).setLevel(logging.INFO)
    if isinstance(
        sys.stdout, io.TextIOWrapper
    ):  # on Windows a file or pipe may be of 256 characters: names have others
        sys.stdout.reconfigure(errors="backslashreplace")
    if os.environ.pop(ENDS_WITH_STDIN, None):
        threading.Thread(target=_end_with_stdin, daemon=True).start()
    try:
        with _threads_quiet_on_disk_failures():
            result = versioned(command).main(args=None if argv is None else list(argv), standalone_mode=False)
    except InputError as error:
        click.echo(f"Error: {error}", err=True)
        return BAD_INPUT
    except click.ClickException as error:
        error.show()
        return BAD_INPUT
    except ModuleNotFoundError as error:
        library = (error.name or "").split(".")[0]
        if library in OUR_PACKAGES:
            raise
        click.echo(f"Error: {library} is not installed; run: {remedy(library)}", err=True)
        return BAD_INPUT
    except OSError as error:
        if error.filename is None and error.errno not in DISK_FAILURES:
            raise
        where = "" if error.filename is None else f"{error.filename}: "
        click.echo(f"Error: {where}{error.strerror}", err=True)
        return BAD_INPUT
    except TrainingError as error:
        click.echo(f"Error: {error}", err=True)
        return 1
    except (click.Abort, KeyboardInterrupt):
        return INTERRUPTED
    return result if isinstance(result, int) else 0


def versioned(command: click.Command) -> click.Command:
    """The same command, with the option `--version`; so are the commands of a group."""
    for each in command.commands.values() if isinstance(command, click.Group) else ():
        versioned(each)
    if all(parameter.name != "version" for parameter in command.params):
        click.version_option(package_name="decomotion", message="%(prog)s %(version)s")(command)
    return command


def _end_with_stdin() -> None:
    with suppress(OSError, ValueError):
        _wait_for_end_of(sys.stdin.fileno())
    if sys.platform == "win32":
        _thread.interrupt_main()  # there `os.kill` ends a process at once
    else:
        os.kill(os.getpid(), signal.SIGINT)
    time.sleep(PATIENCE)
    os._exit(INTERRUPTED)


if sys.platform == "win32":

    def _wait_for_end_of(pipe: int) -> None:
        """Looks now and then: while a thread reads a pipe, Windows lets nobody ask about it, as numpy's import does."""
        handle = msvcrt.get_osfhandle(pipe)
        while True:
            _winapi.PeekNamedPipe(handle, 0)  # raises BrokenPipeError at the end
            time.sleep(_GLANCE)

else:

    def _wait_for_end_of(pipe: int) -> None:
        while os.read(pipe, 1):
            pass


@contextmanager
def interrupt_flag() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C sets, so that a step is never cut in two; a second Ctrl-C interrupts at once."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    former = signal.getsignal(signal.SIGINT)

    def note(*_: object) -> None:
        event.set()
        signal.signal(signal.SIGINT, former)

    signal.signal(signal.SIGINT, note)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, former)


@contextmanager
def _threads_quiet_on_disk_failures() -> Iterator[None]:
    """A thread that writes, such as TensorBoard's, prints no traceback on a full disk: who waits for it raises that."""
    former = threading.excepthook

    def show(failure: threading.ExceptHookArgs) -> None:
        if not (isinstance(failure.exc_value, OSError) and failure.exc_value.errno in DISK_FAILURES):
            former(failure)

    threading.excepthook = show
    try:
        yield
    finally:
        threading.excepthook = former
