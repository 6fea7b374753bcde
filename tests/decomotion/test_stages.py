"""Stages on disk: done once, gone on with where they were stopped, and believed only when whole."""

from __future__ import annotations

import dataclasses
import os
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from decomotion.data.stages import Stage, remove_abandoned, remove_all, write_whole
from refitting import wait_until


def stage(root: Path, **settings: Any) -> Stage:
    return Stage("part", {"clip": "abc", **settings}, root)


def build(folder: Path) -> dict[str, Any]:
    (folder / "array").write_text("content")
    return {"points": 7}


def fail(folder: Path) -> dict[str, Any]:
    raise AssertionError("nothing was to be built")


def test_done_once(tmp_path: Path):
    first = stage(tmp_path).run(build)
    assert first.facts == {"points": 7}
    assert (first.folder / "array").read_text() == "content"
    assert first.bytes > len("content")
    assert set(first.seconds) == {"part"}
    assert not first.cached
    assert stage(tmp_path).run(fail) == dataclasses.replace(first, cached=True)


def test_other_settings_are_another_stage(tmp_path: Path):
    folders = {stage(tmp_path, side=side).run(build).folder for side in (1, 2, 2)}
    assert len(folders) == 2


def test_rebuilt_where_asked_for(tmp_path: Path):
    stage(tmp_path).run(build)
    again = stage(tmp_path).run(lambda folder: {"points": 8, "seconds": {"a": 1.0, "b": 2.0}}, rebuild=True)
    assert again.facts == {"points": 8}
    assert again.seconds == {"a": 1.0, "b": 2.0}
    assert not (again.folder / "array").exists()


@pytest.mark.parametrize("failure", [KeyboardInterrupt, MemoryError])
def test_a_stopped_stage_is_not_believed_but_gone_on_with(tmp_path: Path, failure: type[BaseException]):
    def stopped(folder: Path) -> dict[str, Any]:
        (folder / "first half").touch()
        raise failure

    with pytest.raises(failure):
        stage(tmp_path).run(stopped)
    assert not stage(tmp_path).finished

    def go_on(folder: Path) -> dict[str, Any]:
        assert (folder / "first half").exists()
        return {}

    stage(tmp_path).run(go_on)
    assert stage(tmp_path).finished


def test_a_folder_without_a_record_is_not_believed(tmp_path: Path):
    stage(tmp_path).folder.mkdir()
    (stage(tmp_path).folder / "array").write_text("half")
    record = stage(tmp_path).run(build)
    assert (record.folder / "array").read_text() == "content"


def test_two_at_a_time_build_once(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    built = []
    caplog.set_level("INFO")
    waiting = "another run is preparing the part of this clip; waiting for it"

    def slowly(folder: Path) -> dict[str, Any]:
        built.append(folder)
        wait_until(lambda: caplog.text.count(waiting) == 2)
        return build(folder)

    runs = [threading.Thread(target=lambda: stage(tmp_path).run(slowly)) for _ in range(3)]
    for run in runs:
        run.start()
    for run in runs:
        run.join(60)
    assert len(built) == 1
    assert stage(tmp_path).finished
    assert caplog.text.count(waiting) == 2


def test_what_was_left_long_ago_goes(tmp_path: Path):
    for side in (1, 2):
        with pytest.raises(AssertionError):
            stage(tmp_path, side=side).run(fail)
    old, young = (tmp_path / f".{stage(tmp_path, side=side).folder.name}.partial" for side in (1, 2))
    os.utime(old, (0, time.time() - 7.1 * 24 * 3600))
    os.utime(young, (0, time.time() - 6.9 * 24 * 3600))
    remove_abandoned(tmp_path)
    assert not old.exists()
    assert young.exists()


def test_all_of_a_clip_goes_unless_a_run_is_at_work_on_it(tmp_path: Path):
    stage(tmp_path).run(build)
    with pytest.raises(AssertionError):
        stage(tmp_path, side=2).run(fail)
    begun = tmp_path / f".{stage(tmp_path, side=2).folder.name}.partial"

    def meanwhile(_: Path) -> dict[str, Any]:
        remove_all(tmp_path)
        assert stage(tmp_path).finished
        assert begun.exists()
        return {}

    stage(tmp_path, side=3).run(meanwhile)
    remove_all(tmp_path)
    assert not any(each.is_dir() for each in tmp_path.iterdir())
    remove_all(tmp_path / "never prepared")


def test_a_file_is_whole_or_not_there(tmp_path: Path):
    def half(path: Path) -> None:
        path.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "file", half)
    assert not (tmp_path / "file").exists()
    write_whole(tmp_path / "file", lambda path: path.write_text("whole"))
    assert (tmp_path / "file").read_text() == "whole"
