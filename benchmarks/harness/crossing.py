"""How fast points are followed from window to window."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import numpy as np

from decomo_runtime import Tracker
from decomotion.windows import FILE_NAME, OVERLAP, Window, Windows
from harness.records import Record


def copied(model: Path, folder: Path, windows: int) -> Path:
    """A model folder whose windows are copies of one model file, which overlap as those of a shot do."""
    facts = Tracker(model).facts
    step = facts.num_frames - min(OVERLAP, facts.num_frames // 2)
    begins = [number * step for number in range(windows)]
    parts = tuple(
        Window(f"window-{number:03d}", begin, begin + facts.num_frames) for number, begin in enumerate(begins)
    )
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for part in parts:
        shutil.copy(model, folder / f"{part.name}.onnx")
    Windows(facts.clip_name, parts[-1].end, facts.height, facts.width, facts.fps, parts).save(folder / FILE_NAME)
    return folder


def crossing_figures(model: Path, points: int) -> Record:
    """Random points of frame 0, followed through the whole clip: point-frames a second of wall time."""
    tracker = Tracker(model)
    place = np.random.default_rng(0).uniform(0, [tracker.width - 1, tracker.height - 1], (points, 2))
    queries = np.column_stack([np.zeros(points), place])
    tracker.track(queries[:1])  # warms up
    begin, processors = time.perf_counter(), time.process_time()
    tracker.track(queries)
    seconds, processors = time.perf_counter() - begin, time.process_time() - processors
    return {
        "frames": tracker.num_frames,
        "seconds": round(seconds, 2),
        "cpu_seconds": round(processors, 2),
        "point_frames_per_second": round(points * tracker.num_frames / seconds),
    }
