"""The server of the page: this folder, this machine, and nothing else."""

from __future__ import annotations

import http.client
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import pytest

from decomo_runtime import ViewError
from decomo_runtime.view.server import CONTENT_SECURITY_POLICY, HOST, Handler, make_server
from serving import serving


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A site beside a file that must stay unread."""
    site = tmp_path / "site"
    (site / "clip").mkdir(parents=True)
    (site / "index.html").write_text("<p>page")
    (site / "runtime.mjs").write_text("export {}")
    (tmp_path / "secret.txt").write_text("secret")
    (site / "way_out").symlink_to(tmp_path / "secret.txt")
    (site / "parent").symlink_to(tmp_path)
    return site


@pytest.fixture
def port(folder: Path) -> Iterator[int]:
    with serving(make_server(folder)) as port:
        yield port


def ask(port: int, path: str, method: str = "GET", host: str | None = None) -> tuple[http.client.HTTPResponse, bytes]:
    connection = http.client.HTTPConnection(HOST, port, timeout=60)
    connection.putrequest(method, path, skip_host=True)
    connection.putheader("Host", host or f"{HOST}:{port}")
    connection.endheaders()
    response = connection.getresponse()
    return response, response.read()


def test_serves_the_page_with_its_headers(port: int):
    response, body = ask(port, "/")
    assert (response.status, body) == (200, b"<p>page")
    assert response.headers["Content-Security-Policy"] == CONTENT_SECURITY_POLICY
    assert response.headers["Cross-Origin-Opener-Policy"] == "same-origin"
    assert response.headers["Cross-Origin-Embedder-Policy"] == "require-corp"
    assert response.headers["X-Content-Type-Options"] == "nosniff"
    assert ask(port, "/runtime.mjs")[0].headers["Content-Type"].startswith("text/javascript")
    assert ask(port, "/index.html?x=1")[0].status == 200


@pytest.mark.parametrize(
    "path",
    [
        "/../secret.txt",
        "/%2e%2e/secret.txt",
        "/clip/%2e%2e/%2e%2e/secret.txt",
        "/..%2fsecret.txt",
        "/..%5csecret.txt",
        "//etc/passwd",
        "/%00",
        "/way_out",
        "/parent/secret.txt",
        "/clip",
        "/clip/",
        "/none",
    ],
)
def test_nothing_outside_the_folder_and_no_listing(port: int, path: str):
    response, body = ask(port, path)
    assert response.status == 404
    assert b"secret" not in body.replace(b"/secret.txt", b"")
    assert response.headers["Content-Security-Policy"] == CONTENT_SECURITY_POLICY


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE"])
def test_reads_only(port: int, method: str):
    assert ask(port, "/", method)[0].status == 501


def test_answers_to_its_own_address_only(port: int):
    """A page elsewhere whose name resolves to 127.0.0.1 gets nothing."""
    assert ask(port, "/", host=f"localhost:{port}")[0].status == 200
    assert ask(port, "/", host=f"evil.example:{port}")[0].status == 403


@pytest.mark.parametrize(("port", "bare"), [(80, True), (8080, False)])
def test_a_browser_leaves_port_80_out(port: int, bare: bool):
    handler = Handler.__new__(Handler)
    handler.connection = Mock(getsockname=lambda: (HOST, port))
    names = handler.own_names()
    assert f"localhost:{port}" in names
    assert ({HOST, "localhost"} <= names) == bare


def test_listens_on_loopback_only_and_refuses_a_port_in_use(folder: Path, port: int):
    with pytest.raises(ViewError, match=f"port {port} is in use"):
        make_server(folder, port)
    with make_server(folder) as other:
        assert other.server_address[0] == "127.0.0.1"
