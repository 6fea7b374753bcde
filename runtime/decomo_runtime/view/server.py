"""Serves one folder to the browsers of this machine, and nothing else of its disk; and refits, where it is told to."""

from __future__ import annotations

import errno
import sys
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from decomo_runtime.errors import ViewError
from decomo_runtime.view.refit import Refits
from decomo_runtime.view.refit_requests import REFIT, answer

HOST = "127.0.0.1"
HTTP_PORT = 80
"""Browsers leave it out of the name that they ask for."""
CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self' 'wasm-unsafe-eval'",
        "worker-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob:",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
HEADERS = {
    "Cache-Control": "no-cache",
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "Cross-Origin-Embedder-Policy": "require-corp",  # this and the next give the page threads
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Handler(SimpleHTTPRequestHandler):
    """GET and HEAD of the files below `directory`; no listings, no links that lead out, no other host's name."""

    extensions_map = {  # noqa: RUF012 - as the parent has it; what the system's own table says must not matter
        ".css": "text/css; charset=utf-8",
        ".gz": "application/octet-stream",
        ".html": "text/html; charset=utf-8",
        ".jpg": "image/jpeg",
        ".js": "text/javascript; charset=utf-8",
        ".json": "application/json",
        ".mjs": "text/javascript; charset=utf-8",
        ".svg": "image/svg+xml",
        ".txt": "text/plain; charset=utf-8",
        "": "application/octet-stream",
    }
    server_version, sys_version = "decomo-view", ""

    def __init__(self, *args: Any, refits: Refits | None = None, **options: Any) -> None:
        self.refits = refits
        super().__init__(*args, **options)  # answers

    def do_GET(self) -> None:
        """A file, or how a refit is."""
        if self.refits is not None and self.path == REFIT:
            answer(self, self.refits, self.own_names())
        else:
            super().do_GET()

    def do_POST(self) -> None:
        """Begins, ends or decides on a refit."""
        if self.refits is not None and (self.path == REFIT or self.path.startswith(f"{REFIT}/")):
            answer(self, self.refits, self.own_names())
        else:
            self.send_error(HTTPStatus.NOT_IMPLEMENTED, f"Unsupported method ({self.command!r})")

    def send_head(self) -> Any:
        """The file asked for, opened, once it is sure that it may be read."""
        if self.headers.get("Host", "") not in self.own_names():  # a page elsewhere whose name points to this machine
            self.send_error(HTTPStatus.FORBIDDEN, "This server answers to its own address only")
            return None
        if not self._may_be_read():
            self.send_error(HTTPStatus.NOT_FOUND)
            return None
        return super().send_head()

    def end_headers(self) -> None:
        """Adds what makes the page safe, and gives it threads."""
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Says nothing."""

    def _may_be_read(self) -> bool:
        root = Path(self.directory).resolve()
        try:
            path = Path(self.translate_path(self.path)).resolve()
        except ValueError:  # a NUL in it
            return False
        return path == root or (path.is_relative_to(root) and path.is_file())

    def own_names(self) -> set[str]:
        """What browsers ask for when they mean this server: hosts with the port."""
        names, port = {HOST, "localhost"}, self.connection.getsockname()[1]
        return {f"{name}:{port}" for name in names} | (names if port == HTTP_PORT else set())


class Server(ThreadingHTTPServer):
    """Says nothing where a browser hangs up, as one does that reloads the page."""

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Leaves all other errors to the parent, which prints them."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


def make_server(folder: Path, port: int = 0, refits: Refits | None = None) -> ThreadingHTTPServer:
    """A server of `folder` on 127.0.0.1, port 0 meaning any that is free; `ViewError` where `port` is taken.

    With `refits` it also runs them for whoever knows their token.
    """
    try:
        return Server((HOST, port), partial(Handler, directory=str(folder), refits=refits))
    except OSError as error:
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        raise ViewError(
            f"port {port} is in use or not allowed; give another, or leave --port out for a free one"
        ) from error
