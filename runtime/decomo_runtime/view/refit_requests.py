"""Requests about refits, each of them checked: it is for this server, of its own page, and knows this start's token.

| request | does |
|---|---|
| `GET /refit` | nothing |
| `POST /refit`, the text of a corrections.csv | begins a refit |
| `POST /refit/cancel` | ends it |
| `POST /refit/take`, `POST /refit/reject`, the refit's number | decides on it |

All answer with the `State` as JSON or with `{"error": sentence}`: 403 where a check fails, 409 where it cannot be done.
"""

from __future__ import annotations

import hmac
import json
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler

from decomo_runtime.view.refit import Refits
from decomotion.errors import InputError

REFIT = "/refit"
TOKEN_HEADER = "X-Decomo-Token"
"""No page elsewhere can send it: a browser would ask first, and is not answered."""
MOST_BYTES = 4_000_000
"""Of a corrections.csv."""
SECONDS = 10.0
"""In which the content of a request must come."""


def answer(request: BaseHTTPRequestHandler, refits: Refits, own_names: set[str]) -> None:
    """Answers a request whose path is `REFIT` or below; `own_names` are the hosts that mean this server."""
    request.connection.settimeout(SECONDS)
    content = _content(request)  # also of one that is refused: unread, it would cut the answer off
    if content is None:
        return _send(request, HTTPStatus.REQUEST_ENTITY_TOO_LARGE, {"error": "The request is too long, or cut short."})
    if not _is_allowed(request, refits.token, own_names):
        return _send(request, HTTPStatus.FORBIDDEN, {"error": "The request is not one of this server's own page."})
    try:
        known = _act(refits, request.command, request.path.removeprefix(REFIT), content)
    except (InputError, OSError) as error:
        return _send(request, HTTPStatus.CONFLICT, {"error": f"{str(error)[:1].upper()}{str(error)[1:]}."})
    if not known:
        return _send(request, HTTPStatus.NOT_FOUND, {"error": "There is no such request."})
    return _send(request, HTTPStatus.OK, refits.as_json())


def _act(refits: Refits, method: str, action: str, content: bytes) -> bool:
    """Does what is asked for; False where that is nothing known."""
    number = int(content) if content.isdigit() and len(content) < 10 else 0
    if method == "GET":
        return action == ""
    if action == "":
        refits.begin(content)
    elif action == "/cancel":
        refits.cancel()
    elif action == "/take":
        refits.take(number)
    elif action == "/reject":
        refits.reject(number)
    else:
        return False
    return True


def _is_allowed(request: BaseHTTPRequestHandler, token: str, own_names: set[str]) -> bool:
    host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
    if host not in own_names:  # a page elsewhere whose name points to this machine
        return False
    if origin != f"http://{host}" and not (origin is None and request.command == "GET"):  # browsers send it with POST
        return False
    return hmac.compare_digest(request.headers.get(TOKEN_HEADER, "").encode(), token.encode())


def _content(request: BaseHTTPRequestHandler) -> bytes | None:
    """The request's content; None where it is too long or does not come whole."""
    said = request.headers.get("Content-Length", "0")
    if not (said.isdigit() and len(said) < 10 and int(said) <= MOST_BYTES):
        return None
    try:
        content = request.rfile.read(int(said))
    except TimeoutError:
        return None
    return content if len(content) == int(said) else None


def _send(request: BaseHTTPRequestHandler, status: HTTPStatus, answer: dict[str, object]) -> None:
    content = json.dumps(answer).encode()
    request.send_response(status)
    request.send_header("Content-Type", "application/json")
    request.send_header("Content-Length", str(len(content)))
    request.end_headers()
    request.wfile.write(content)
