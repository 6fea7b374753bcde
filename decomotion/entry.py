"""`decomo`: the one entry to all commands, each of which is loaded when it is asked for."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

import click

from decomotion.commands import COMMANDS
from decomotion.console import run, versioned


class _Commands(click.Group):
    """Those of the table."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """In the order of the work."""
        return [each.name for each in COMMANDS]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Loads its module."""
        for each in COMMANDS:
            if each.name == cmd_name:
                return versioned(getattr(import_module(each.module), each.function))
        return None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Without loading any."""
        with formatter.section("Commands"):
            formatter.write_dl([(each.name, each.purpose) for each in COMMANDS])


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
def decomo() -> None:
    """Track every pixel of a video with one small model that is fitted to it.

    decomo COMMAND --help says what a command takes; decomo-COMMAND is the same command.
    """


def main(argv: Sequence[str] | None = None) -> int:
    """Runs `decomo` on `argv` and returns its exit code."""
    return run(decomo, argv)


if __name__ == "__main__":
    sys.exit(main())
