"""`decomo-view`: shows an exported model in the browser, where one click on a pixel draws its whole path."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import click

from decomotion.console import run

_PATH = click.Path(path_type=Path)


@click.command(context_settings={"show_default": True})
@click.argument("model", type=_PATH)
@click.option("--clip", "clip_path", metavar="CLIP", type=_PATH, help="Frames or video that the model was fitted to.")
@click.option("--run", "run_folder", metavar="DIR", type=_PATH, help="Run that MODEL is from: refits it; needs --clip.")
@click.option("--export", "export_folder", metavar="DIR", type=_PATH, help="Write the page there and serve nothing.")
@click.option("--port", metavar="N", type=click.IntRange(0, 65535), default=0, show_default="any that is free")
@click.option("--browser/--no-browser", default=True, help="Open the page, or only print its address.")
def view(
    model: Path, clip_path: Path | None, run_folder: Path | None, export_folder: Path | None, port: int, browser: bool
) -> None:
    """Opens a page on which MODEL follows the points that you click.

    MODEL is a file, or the folder of a clip of several windows, written by decomo-export. The page runs it itself, on
    this machine and offline; without --clip the model's own rendering is the picture. With --run it offers to refit
    the model to what you corrected, which leaves a new run beside that one. --export writes a folder that any web host
    can serve.
    """
    import tempfile

    from decomo_runtime.errors import ViewError
    from decomo_runtime.view.refit import Refits
    from decomo_runtime.view.server import make_server
    from decomo_runtime.view.site import export_site, read_inputs, write_site

    if export_folder is not None and (port != 0 or not browser):
        raise ViewError("--export serves nothing; leave out --port and --no-browser")
    if export_folder is not None and run_folder is not None:
        raise ViewError("--export writes a page that nobody refits for; leave out --run")
    if run_folder is not None and clip_path is None:
        raise ViewError("--run refits to the clip; give it with --clip")
    facts, clip = read_inputs(model, clip_path)
    if export_folder is not None:
        export_site(export_folder, model, clip)
        click.echo(f"wrote {export_folder}")
        return
    with ExitStack() as stack:
        stack.enter_context(_ended_by_signals())
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="decomo-view-")))
        refits = None
        if run_folder is not None and clip_path is not None:
            refits = Refits(folder, clip_path, run_folder, model)
            stack.callback(refits.cancel)
        server = stack.enter_context(make_server(folder, port, refits))
        write_site(folder, model, clip, refit=refits is not None)
        address = f"http://{server.server_address[0]}:{server.server_address[1]}/"
        if refits is not None:
            address += f"#token={refits.token}"
        click.echo(f"{facts.clip_name} at {address} (Ctrl-C ends)")
        if browser:
            click.launch(address)
        with suppress(KeyboardInterrupt):
            server.serve_forever()


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """SIGTERM, and SIGHUP of a closed terminal, end the block as Ctrl-C does, unless they are ignored (nohup)."""
    wanted = {signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)}
    handled = [each for each in wanted if signal.getsignal(each) is signal.SIG_DFL]
    for each in handled:
        signal.signal(each, signal.default_int_handler)
    try:
        yield
    finally:
        for each in handled:
            signal.signal(each, signal.SIG_DFL)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs `decomo-view` on `argv` and returns its exit code."""
    return run(view, argv)
