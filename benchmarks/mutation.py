"""Which faults the tests notice: by room, the share of small faults, put in one at a time, that make a test fail.

    python benchmarks/mutation.py --json benchmarks/results/mutation.json          # an hour or more
    python benchmarks/mutation.py --room losses --room model --count 60 --seed 1   # others, of two rooms
    python benchmarks/mutation.py --again before.json --json after.json            # when there are tests for survivors

`mutation.yaml` names the rooms and their tests. Each mutant runs in a copy of the working tree, in a fork of a process
that has the libraries loaded, until the first test fails; one that exceeds its time is noticed too. A survivor is a
hole in the tests, or changes nothing: then it goes into the list `equivalent` of its room, with the reason.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import yaml

from harness.mutants import Mutant, sample

ROOT = Path(__file__).parents[1]
PACKAGES = ("", "export", "runtime", "eval", "tests", "benchmarks")
LIBRARIES = ("av", "cv2", "numpy", "onnx", "onnxruntime", "pydantic", "pytest", "torch", "torchvision")
"""Loaded once, before the forks. Ours and plugins of pytest are not: its import hooks must see them first."""
LOG, ASIDE = "mutation.log", "mutation.aside"
"""In a copy: what pytest said, and the file as it was."""
BROKEN = 70
"""The exit code of a fork whose pytest did not come to an end."""
LEAST_SECONDS, PATIENCE = 60, 6
"""A mutant has so many times the seconds that the tests take without a fault, and never less than the first."""


@dataclass
class Job:
    """The tests of one mutant (None: of the tree as it is) while they run."""

    room: str
    tests: tuple[str, ...]
    mutant: Mutant | None
    limit: float
    copy: Path = Path()
    process: int = 0
    began: float = field(default_factory=time.monotonic)
    seconds: float = 0.0
    noticed: str | None = None
    """The test that failed, or `timeout`; None where all passed."""


def tests_of(room: dict[str, Any], file: str, copy: Path) -> tuple[str, ...]:
    """The room's tests that there are, the mirror of `file` first."""
    paths = [f"tests/{name}.py" for name in room["tests"] if (copy / f"tests/{name}.py").exists()]
    return tuple(sorted(paths, key=lambda path: Path(path).stem != f"test_{Path(file).stem}"))


def copied(target: Path) -> Path:
    """A copy of the working tree without records and pages of documents."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    for name in listed:
        if (ROOT / name).is_file() and not name.startswith("benchmarks/results/"):
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)
    return target


def start(job: Job, copy: Path) -> Job:
    """Forks a process that runs the tests of `job` in that copy, with its fault written there."""
    job.copy, job.began = copy, time.monotonic()
    if job.mutant is not None:
        (copy / job.mutant.file).rename(copy / ASIDE)
        (copy / job.mutant.file).write_text(job.mutant.changed)
    sys.stdout.flush()
    job.process = os.fork()
    if job.process == 0:
        try:
            code = _run_tests(copy, job.tests)
        except BaseException:
            traceback.print_exc()
            code = BROKEN
        os._exit(code)
    return job


def _run_tests(copy: Path, tests: Sequence[str]) -> int:
    """In the fork: pytest, all that it says in a file."""
    import pytest

    os.setsid()
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup has it ignored, by the children of the tests too
    log = os.open(copy / LOG, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.chdir(copy)
    folders = [str(copy / name) for name in PACKAGES]
    sys.path[:] = folders + [path for path in sys.path if not Path(path or ".").resolve().is_relative_to(ROOT)]
    os.environ |= {"PYTHONPATH": os.pathsep.join(folders[:4]), "PYTHONDONTWRITEBYTECODE": "1"}
    os.environ.setdefault("DECOMO_SHARED", str(ROOT.parent / "shared"))
    sys.dont_write_bytecode = True
    for name in [name for name in sys.modules if name.partition(".")[0] == "harness"]:
        del sys.modules[name]
    options = ["-x", "-q", "-p", "no:cacheprovider", "--no-header", "--tb=no", "--hypothesis-seed=0", "-m", "not gpu"]
    return int(pytest.main([*options, f"--basetemp={copy / 'tmp'}", *tests]))


def ended(job: Job) -> bool:
    """Whether the tests are through; then the job says what they found, and its copy is whole again."""
    process, status = os.waitpid(job.process, os.WNOHANG)
    job.seconds = time.monotonic() - job.began
    late = process == 0 and job.seconds > job.limit
    if process == 0 and not late:
        return False
    _kill(job.process)
    if late:
        os.waitpid(job.process, 0)
    code = os.waitstatus_to_exitcode(status) if not late else -signal.SIGKILL
    said = (job.copy / LOG).read_text(errors="replace") if code else ""
    failed = re.search(r"^(?:FAILED|ERROR) (?:tests/)?(\S+)", said, re.MULTILINE)
    job.noticed = None if code == 0 else "timeout" if late else failed[1] if failed else f"exit {code}"
    if job.mutant is not None:
        (job.copy / ASIDE).rename(job.copy / job.mutant.file)
    return True


def _kill(group: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


def finished(jobs: list[Job], copies: list[Path]) -> Iterator[Job]:
    """The jobs as they end, as many at a time as there are copies."""
    waiting, free, running = jobs[::-1], list(copies), []
    try:
        while waiting or running:
            while waiting and free:
                running.append(start(waiting.pop(), free.pop()))
            for job in [job for job in running if ended(job)]:
                running.remove(job)
                free.append(job.copy)
                yield job
            time.sleep(0.02)
    finally:
        for job in running:
            _kill(job.process)


def survived(record: dict[str, Any], name: str, drawn: Sequence[Mutant]) -> list[Mutant]:
    """Of a room's sample those that no test noticed in an earlier run, with those that change nothing.

    Raises `click.UsageError` where the sample is another one by now.
    """
    room = record["rooms"][name]
    known = [(each["file"], each["before"], each["after"]) for each in (*room["survivors"], *room["equivalent"])]
    found = [mutant for mutant in drawn if (mutant.file, mutant.before, mutant.after) in known]
    if len(found) != len(known) or len(drawn) != room["mutants"] + len(room["equivalent"]):
        raise click.UsageError(f"the sources of {name} have changed since that record; run the whole sample")
    return found


def described(room: dict[str, Any], jobs: Sequence[Job], drawn: int) -> dict[str, Any]:
    """What a room's record says, of so many that were drawn; those without a job were noticed in an earlier run."""
    reasons = {(each["line"], each["becomes"]): each["why"] for each in room.get("equivalent", ())}
    survivors = [
        (job.mutant, reasons.get((job.mutant.before, job.mutant.after)))
        for job in jobs
        if job.mutant is not None and job.noticed is None
    ]
    holes = [mutant.record() for mutant, reason in survivors if reason is None]
    equivalent = [mutant.record() | {"why": reason} for mutant, reason in survivors if reason is not None]
    counted = drawn - len(equivalent)
    return {
        "mutants": counted,
        "killed": counted - len(holes),
        "share": round((counted - len(holes)) / counted, 3) if counted else None,
        "timeouts": sum(job.noticed == "timeout" for job in jobs),
        "survivors": sorted(holes, key=lambda each: (each["file"], each["line"])),
        "equivalent": equivalent,
    }


@click.command(context_settings={"show_default": True})
@click.option("--room", "names", multiple=True, help="Only this one; may be repeated.  [default: all]")
@click.option("--count", default=30, type=click.IntRange(1), help="Mutants in each room, or all there are.")
@click.option("--seed", default=0, help="Of the sample.")
@click.option("--workers", default=2, type=click.IntRange(1), help="Tests at a time.")
@click.option(
    "--again",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="A record: of its rooms and sample try only what survived; the rest was noticed.",
)
@click.option("--json", "record_path", type=click.Path(path_type=Path), help="Write the record there.")
def main(
    names: tuple[str, ...], count: int, seed: int, workers: int, again: Path | None, record_path: Path | None
) -> None:
    """Put faults in, one at a time, and say which no test noticed."""
    rooms = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())
    if unknown := set(names) - set(rooms):
        raise click.UsageError(f"there is no room {', '.join(sorted(unknown))}; there are {', '.join(rooms)}")
    earlier = None if again is None else json.loads(again.read_text())
    if earlier is not None:
        names, count, seed = tuple(earlier["rooms"]), earlier["count"], earlier["seed"]
    for library in LIBRARIES:
        __import__(library)
    with tempfile.TemporaryDirectory(prefix="decomotion-mutation-") as folder:
        copies = [copied(Path(folder, str(number))) for number in range(workers)]
        drawn = {name: sample(ROOT, _files(rooms[name]), count, seed) for name in rooms if not names or name in names}
        tried = drawn if earlier is None else {name: survived(earlier, name, drawn[name]) for name in drawn}
        seconds = {}
        for job in finished([Job(name, tests_of(rooms[name], "", copies[0]), None, 3600) for name in drawn], copies):
            if job.noticed is not None:
                said = (job.copy / LOG).read_text(errors="replace")[-2000:]
                raise click.ClickException(f"the tests of {job.room} fail as they are: {job.noticed}\n{said}")
            seconds[job.room] = job.seconds
            click.echo(f"{job.room}: {len(tried[job.room])} mutants; its tests take {job.seconds:.0f} s")
        jobs = [
            Job(
                name,
                tests_of(rooms[name], mutant.file, copies[0]),
                mutant,
                max(LEAST_SECONDS, PATIENCE * seconds[name]),
            )
            for name, mutants in tried.items()
            for mutant in mutants
        ]
        for number, job in enumerate(finished(jobs, copies), 1):
            assert job.mutant is not None
            where = f"{job.mutant.file}:{job.mutant.line}"
            click.echo(
                f"{number}/{len(jobs)} {job.seconds:.0f} s {job.noticed or 'SURVIVED'} {where} {job.mutant.after}"
            )
    found = {
        name: described(rooms[name], [job for job in jobs if job.room == name], len(drawn[name])) for name in drawn
    }
    for name, room in found.items():
        click.echo(f"{name:10} {room['killed']:3} of {room['mutants']:3}: {room['share']}")
    if record_path is not None:
        from harness.records import provenance, write_record  # it loads our packages: not before the forks

        write_record(record_path, {"seed": seed, "count": count, **provenance(), "rooms": found})


def _files(room: dict[str, Any]) -> list[str]:
    """The room's source files that there are."""
    found = {path for pattern in room["sources"] for path in ROOT.glob(pattern)}
    return sorted(str(path.relative_to(ROOT)) for path in found)


if __name__ == "__main__":
    main()
