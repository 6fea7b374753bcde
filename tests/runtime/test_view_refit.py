"""Refits without a browser: the processes, what they leave behind, and who may ask for them."""

from __future__ import annotations

import http.client
import json
import os
import shutil
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from children import child
from decomo_runtime import Tracker, ViewError
from decomo_runtime.view import cli
from decomo_runtime.view import refit as refit_module
from decomo_runtime.view.refit import Refits
from decomo_runtime.view.refit_requests import MOST_BYTES, TOKEN_HEADER
from decomo_runtime.view.server import HOST, make_server
from decomo_runtime.view.site import write_site
from decomotion.clip import read_clip
from decomotion.windows import FILE_NAME, Windows, split
from refitting import Bench, lives, wait_until
from serving import serving
from tiny_model import write_tiny_model

CORRECTIONS = b"t,x,y,target_t,target_x,target_y\n1,10,12,3,14,18\n1,10,12,4,,\n"
"""Two frames later the point is 4 to the right and 6 down: the stand-in's model moves by (2, 3) a frame."""


@pytest.fixture
def bench(model_path: Path, clip_path: Path, tmp_path: Path) -> Bench:
    facts = Tracker(model_path).facts
    (tmp_path / "models").mkdir()
    model = write_tiny_model(
        tmp_path / "models" / "slide.onnx", num_frames=facts.num_frames, height=facts.height, width=facts.width
    )
    return Bench(tmp_path, model, clip_path, num_frames=facts.num_frames, height=facts.height, width=facts.width)


@pytest.fixture
def site(bench: Bench, tmp_path: Path) -> Path:
    site = tmp_path / "site"
    site.mkdir()
    write_site(site, bench.model, read_clip(bench.clip), refit=True)
    return site


@pytest.fixture
def refits(bench: Bench, site: Path) -> Iterator[Refits]:
    made = bench.refits(site)
    yield made
    made.cancel()


def ended(refits: Refits) -> str:
    wait_until(lambda: refits.state.state != "running")
    return refits.state.state


def test_a_refit_goes_on_from_the_run_and_leaves_a_new_one_beside_it(bench: Bench, refits: Refits, site: Path):
    refits.begin(CORRECTIONS)
    wait_until(lambda: refits.state.share == 0.42)
    assert refits.state.said == "fit step 42  3.0/s  0.5 min left"
    bench.let_go()
    assert ended(refits) == "finished", refits.state
    assert bench.begun() == [[str(bench.clip), str(bench.run), "1m"]]
    assert bench.left() == ["slide", "slide-corrected"]
    new_run = bench.run.with_name("slide-corrected")
    assert refits.state.run == str(new_run)
    rows = json.loads((new_run / "checkpoint.pt").read_text())["rows"]
    assert [row["target_x"] for row in rows] == ["14", ""]
    assert refits.state.model == "refit-1.onnx"
    track = Tracker(site / "refit-1.onnx").track([[1, 10, 12]])
    assert track.xy[0, 3].tolist() == pytest.approx([14, 18])
    assert sorted(path.name for path in bench.model.parent.iterdir()) == ["slide.onnx"]


def test_what_is_taken_is_the_next_beginning_and_what_is_rejected_is_not(bench: Bench, refits: Refits, site: Path):
    for count, decide in enumerate((refits.reject, refits.take, refits.take), start=1):
        bench.let_go()
        refits.begin(CORRECTIONS)
        assert ended(refits) == "finished"
        with pytest.raises(ViewError, match="a refit waits for your verdict"):
            refits.begin(CORRECTIONS)
        with pytest.raises(ViewError, match="that refit waits for no verdict"):
            decide(count - 1)
        decide(count)
    runs = [Path(run).name for _, run, _ in bench.begun()]
    assert runs == ["slide", "slide", "slide-corrected-2"]
    assert bench.left() == ["slide", "slide-corrected", "slide-corrected-2", "slide-corrected-3"]
    models = sorted(path.name for path in bench.model.parent.iterdir())
    assert models == ["slide-corrected-2.onnx", "slide-corrected-3.onnx", "slide.onnx"]
    assert refits.state.file == str(bench.model.with_name(models[1]))
    assert json.loads((site / "site.json").read_text())["model"] == "refit-3.onnx"
    assert json.loads((site / "site.json").read_text())["clip"] is not None


def test_of_a_long_clip_the_model_is_a_folder(bench: Bench, tmp_path: Path):
    models = bench.control / "models"
    layout = Windows("walk", 30, 40, 48, 12.5, split(30, [], 14))
    for window in layout.windows:
        write_tiny_model(models / f"{window.name}.onnx", num_frames=len(window), height=40, width=48)
    layout.save(models / FILE_NAME)
    bench.model = shutil.copytree(models, tmp_path / "models" / "walk.v2")
    site = tmp_path / "site"
    site.mkdir()
    write_site(site, bench.model, None, refit=True)
    refits = bench.refits(site)
    bench.let_go()
    refits.begin(CORRECTIONS)
    assert ended(refits) == "finished"
    assert refits.state.model == f"refit-1/{FILE_NAME}"
    refits.take(1)
    assert refits.state.file == str(tmp_path / "models" / "slide-corrected")
    assert Tracker(tmp_path / "models" / "slide-corrected").facts.num_frames == 30
    assert json.loads((site / "site.json").read_text())["model"] == refits.state.model


def test_after_a_refit_that_breaks_off_another_can_begin(bench: Bench, refits: Refits, monkeypatch: pytest.MonkeyPatch):
    told: list[threading.ExceptHookArgs] = []
    with monkeypatch.context() as patch:
        patch.setattr(threading, "excepthook", told.append)
        patch.setattr(refit_module, "begin", lambda _: 1 / 0)
        refits.begin(CORRECTIONS)
        assert ended(refits) == "failed"
        wait_until(lambda: bool(told))
    assert told[0].exc_type is ZeroDivisionError
    assert refits.state.said.startswith("the refit broke off")
    assert bench.left() == ["slide"]
    bench.let_go()
    refits.begin(CORRECTIONS)
    assert ended(refits) == "finished"


def test_a_cancelled_refit_ends_all_its_processes_and_leaves_nothing(bench: Bench, refits: Refits):
    refits.begin(CORRECTIONS)
    process = bench.wait_until_begun()
    assert lives(process)
    refits.cancel()
    assert refits.state.state == "cancelled"
    wait_until(lambda: not lives(process))
    assert bench.left() == ["slide"]
    bench.let_go()
    refits.begin(CORRECTIONS)
    assert ended(refits) == "finished"


def test_one_at_a_time(bench: Bench, refits: Refits):
    refits.begin(CORRECTIONS)
    with pytest.raises(ViewError, match="a refit is running already"):
        refits.begin(CORRECTIONS)
    bench.wait_until_begun()
    assert len(bench.begun()) == 1


def test_a_fit_that_fails_says_why_and_leaves_nothing(bench: Bench, refits: Refits):
    bench.let_go("corrections.csv, row 0: t is 9 but the clip has 6 frames")
    refits.begin(CORRECTIONS)
    assert ended(refits) == "failed"
    assert refits.state.said == "corrections.csv, row 0: t is 9 but the clip has 6 frames"
    assert bench.left() == ["slide"]


def test_refuses_a_run_that_is_no_folder_and_options_that_do_not_go_together(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for options, sentence in (
        (["--run", bench.run], "--run refits to the clip; give it with --clip"),
        (["--run", bench.run, "--clip", bench.clip, "--export", tmp_path / "out"], "leave out --run"),
        (["--run", tmp_path / "none", "--clip", bench.clip], "none is not a folder; give the one that decomo-train"),
    ):
        assert cli.main([str(argument) for argument in (bench.model, *options)]) == 2
        assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_command_prints_an_address_with_a_token_and_cancels_when_it_ends(bench: Bench, tmp_path: Path):
    stand_in = (sys.executable, str(Path(__file__).parents[1] / "stand_in.py"), str(bench.control))
    commands = {"train": (*stand_in, "train"), "export": (*stand_in, "export")}
    script = (
        "from decomo_runtime.view import cli, refit\n"
        f"refit.Refits.__init__.__kwdefaults__.update({commands})\n"
        "raise SystemExit(cli.main())"
    )
    path = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    command = [sys.executable, "-c", script, bench.model, "--clip", bench.clip, "--run", bench.run, "--no-browser"]
    with child(command, os.environ | {"PYTHONPATH": path, "TMPDIR": str(tmp_path)}) as process:
        assert process.stdout is not None
        address, _, token = process.stdout.readline().split()[2].partition("#token=")
        port = int(address.rstrip("/").rpartition(":")[2])
        assert ask(port, token, body=CORRECTIONS)[0] == 200
        sleeper = bench.wait_until_begun()
        process.send_signal(signal.SIGTERM)
    wait_until(lambda: not lives(sleeper))
    assert bench.left() == ["slide"]
    assert list(tmp_path.glob("decomo-view-*")) == []


def ask(
    port: int,
    token: str | None,
    method: str = "POST",
    path: str = "/refit",
    body: bytes = b"",
    changed: Mapping[str, str | None] | None = None,
) -> tuple[int, Any]:
    """Status and JSON of a request as the page makes it; `changed` are headers, None: without it."""
    own = f"{HOST}:{port}"
    headers = {"Host": own, "Origin": f"http://{own}", TOKEN_HEADER: token, "Content-Length": str(len(body))}
    connection = http.client.HTTPConnection(HOST, port, timeout=60)
    connection.putrequest(method, path, skip_host=True)
    for name, value in (headers | dict(changed or {})).items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders(body)
    response = connection.getresponse()
    content = response.read()
    return response.status, json.loads(content) if content.startswith(b"{") else content


@pytest.fixture
def port(refits: Refits, site: Path) -> Iterator[int]:
    with serving(make_server(site, refits=refits)) as port:
        yield port


def test_requests_begin_watch_cancel_and_decide(bench: Bench, refits: Refits, port: int):
    token = refits.token
    assert ask(port, token, "GET")[1]["state"] == "idle"
    assert ask(port, token, "GET", changed={"Origin": None})[0] == 200  # browsers leave it out
    status, state = ask(port, token, body=CORRECTIONS)
    assert (status, state["number"], state["state"]) == (200, 1, "running")
    assert ask(port, token, body=CORRECTIONS) == (
        409,
        {"error": "A refit is running already; wait for it, or cancel it."},
    )
    assert ask(port, token, path="/refit/cancel")[1]["state"] == "cancelled"
    bench.let_go()
    ask(port, token, body=CORRECTIONS)
    assert ended(refits) == "finished"
    assert ask(port, token, path="/refit/take", body=b"1")[0] == 409
    status, state = ask(port, token, path="/refit/take", body=b"2")
    assert (status, state["state"], Path(state["file"]).name) == (200, "taken", "slide-corrected.onnx")


@pytest.mark.parametrize(
    "changed",
    [
        {TOKEN_HEADER: None},
        {TOKEN_HEADER: "guess"},
        {TOKEN_HEADER: ""},
        {"Host": "evil.example", "Origin": "http://evil.example"},  # a name elsewhere that means this machine
        {"Host": "evil.example", "Origin": None},
        {"Origin": "http://evil.example"},
        {"Origin": None},
        {"Origin": "null"},
    ],
)
def test_nobody_else_begins_a_refit(changed: dict[str, str | None], bench: Bench, refits: Refits, port: int):
    assert ask(port, refits.token, body=CORRECTIONS, changed=changed)[0] == 403
    assert refits.state.state == "idle"
    if changed != {"Origin": None}:  # which browsers leave out there
        assert ask(port, refits.token, "GET", changed=changed)[0] == 403


def test_a_token_in_the_address_is_none(refits: Refits, port: int):
    assert ask(port, None, path=f"/refit?token={refits.token}", body=CORRECTIONS)[0] == 501
    assert refits.state.state == "idle"


def test_each_start_has_a_token_of_its_own(bench: Bench, site: Path):
    tokens = {bench.refits(site).token for _ in range(3)}
    assert len(tokens) == 3
    assert min(map(len, tokens)) >= 43  # 256 bits


@pytest.mark.parametrize("length", ["-1", "many", str(MOST_BYTES + 1), "9" * 30])
def test_a_request_that_is_too_long_or_says_nonsense_is_refused(length: str, refits: Refits, port: int):
    assert ask(port, refits.token, changed={"Content-Length": length})[0] == 413
    assert refits.state.state == "idle"


def test_unknown_actions_and_a_server_without_a_run(refits: Refits, port: int, site: Path):
    assert ask(port, refits.token, path="/refit/all")[0] == 404
    assert ask(port, refits.token, "GET", path="/refit/take")[0] == 404
    assert ask(port, refits.token, path="/elsewhere")[0] == 501
    assert ask(port, refits.token, "OPTIONS")[0] == 501  # what a browser asks for a page elsewhere
    with serving(make_server(site)) as other:
        assert ask(other, refits.token)[0] == 501
