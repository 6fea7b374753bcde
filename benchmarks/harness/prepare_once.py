"""Prepares one clip with the code that is on the path, and says what it cost and how good its links and masks are.

    PYTHONPATH=TREE python benchmarks/harness/prepare_once.py FOLDER RECORD.json '{"overrides": [...], ...}'

A process of its own for `benchmarks/preparation.py`, which compares states of the code: what is imported here has to be
in all of them. Seconds are the processor's, of all threads.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import threading
import time
from contextlib import nullcontext, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

MIB = 2**20
DRAWS = 100
UNITS = (1, 2, 4)
"""Links within so many pixels of a 256-pixel frame are counted."""


class Watch:
    """The most that a folder takes on disk while it is watched, in bytes; and the process's memory."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._stop = folder, threading.Event()
        self.disk = self.anonymous = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.5):
            size = 0
            for file in self._folder.rglob("*"):
                with suppress(OSError):
                    size += file.stat().st_blocks * 512
            self.disk = max(self.disk, size)
            self.anonymous = max(self.anonymous, anonymous_memory())

    def finish(self) -> None:
        self._stop.set()
        self._thread.join()


def anonymous_memory() -> int:
    """Bytes of memory that no file backs: what cannot be dropped where memory is short. 0 where not known."""
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("RssAnon:"):
                return int(line.split()[1]) * 1024
    return 0


def link_errors(pool: Any, xy: np.ndarray, occluded: np.ndarray, size: tuple[int, int]) -> dict[str, np.ndarray]:
    """The links of the pool's points nearest to true tracks, over all pairs of annotated frames.

    Args:
        pool: the pool of a prepared clip.
        xy: true tracks in pixels, [track, frame, 2], and
        occluded: whether they are hidden, [track, frame].
        size: width and height of the clip.

    Returns `error` [link] in pixels of a 256-pixel frame, `confidence` 0 to 1, `gap` and `hidden`, whether the track is
    hidden where the link leads; its error is then of no use.
    """
    unit = max(size) / 256
    found: dict[str, list[np.ndarray]] = {"error": [], "confidence": [], "gap": [], "hidden": []}
    for first in range(xy.shape[1]):
        seen = np.flatnonzero(~occluded[:, first])
        if not len(seen):
            continue
        distance = np.linalg.norm(xy[seen, first, None] - np.asarray(pool.points[first])[None], axis=-1)
        nearest = distance.argmin(axis=1)
        shift = xy[seen, first] - pool.points[first][nearest]
        for second in range(xy.shape[1]):
            if second != first:
                led = pool.targets[first, second][nearest] + shift
                found["error"].append(np.linalg.norm(led - xy[seen, second], axis=-1) / unit)
                found["confidence"].append(pool.confidence[first, second][nearest] / 255)
                found["gap"].append(np.full(len(seen), abs(second - first)))
                found["hidden"].append(occluded[seen, second])
    return {name: np.concatenate(values) for name, values in found.items()}


def summary(links: dict[str, np.ndarray]) -> dict[str, float]:
    """Of links onto places in sight: the share that is linked, and of those the median error and the shares within
    `UNITS`; of all of them the share that is linked and within 4; of links onto hidden places the mean confidence."""
    seen, linked = ~links["hidden"], links["confidence"] > 0
    error = links["error"][seen & linked]
    figures = {"linked": float(linked[seen].mean()), "median": float(np.median(error))}
    figures |= {f"within_{units}": float((error < units).mean()) for units in UNITS}
    figures |= {f"linked_within_{units}": float((linked & (links["error"] < units))[seen].mean()) for units in UNITS}
    hidden = links["confidence"][links["hidden"]]
    return figures | {"confidence_of_hidden": float(hidden.mean()) if len(hidden) else 0.0}


def mask_overlap(pool: Any, masks: np.ndarray) -> float:
    """Intersection over union of the points that move and those on the true masks [frame, H, W], mean over frames."""
    scores = []
    for frame, mask in enumerate(masks):
        x, y = np.round(np.asarray(pool.points[frame])).astype(int).T
        true, found = mask[y, x], np.asarray(pool.moving[frame]) == 1
        either = (true | found).sum()
        scores.append((true & found).sum() / either if either else 1.0)
    return float(np.mean(scores))


def draw_ms(pool: Any, optim: Any) -> dict[str, float]:
    """What drawing a batch for the fit takes, the first time and in the median."""
    sampler = import_module("decomotion.data.batch").Sampler(pool, optim)
    generator, seconds = import_module("decomotion.chance").torch_generator, []
    for number in range(DRAWS):
        begin = time.perf_counter()
        sampler.draw(pool.num_frames - 1, generator(0, "batch", number))
        seconds.append(time.perf_counter() - begin)
    return {"first": 1e3 * seconds[0], "median": 1e3 * float(np.median(seconds))}


def main(clip: str, record: str, settings: str) -> None:
    asked = json.loads(settings)
    time.monotonic = time.process_time  # by which stages are timed
    config = import_module("decomotion.config").load(asked["preset"], overrides=tuple(asked["overrides"]))
    prepare_in_stages = import_module("decomotion.data.prepare").prepare_in_stages
    read_clip = import_module("decomotion.clip").read_clip
    kept_memory = nullcontext
    for module in ("decomotion.memory", "decomotion.data.memory"):
        with suppress(ModuleNotFoundError):
            kept_memory = import_module(module).kept_memory
    before, cpu, wall = anonymous_memory(), time.process_time(), time.perf_counter()
    watch = Watch(Path(os.environ["DECOMO_CACHE"]))
    frames = read_clip(clip)
    read = time.process_time()
    with kept_memory():  # as the commands do
        prepared = prepare_in_stages(frames, config.data, progress=False)
    done = time.process_time()
    watch.finish()
    parts = {part: each for stage in prepared.stages for part, each in stage.seconds.items()}
    pool = prepared.pool
    content: dict[str, Any] = {
        "frames": len(frames),
        "points": pool.num_points,
        "intervals": prepared.stages[0].facts["intervals"],
        "cpu_seconds": {"reading": read - cpu, **parts, "all": done - cpu},
        "wall_seconds": time.perf_counter() - wall,
        "pool_mib": sum(stage.bytes for stage in prepared.stages) / MIB,
        "disk_peak_mib": watch.disk / MIB,
        "memory_mib": {
            "before": before / MIB,
            "peak": watch.anonymous / MIB,
            "peak_with_mapped_files": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        },
    }
    with suppress(ModuleNotFoundError):  # of older states
        content["draw_ms"] = draw_ms(pool, config.optim)
    if asked.get("truth"):
        truth = np.load(asked["truth"])
        links = link_errors(pool, truth["xy"], truth["occluded"], (frames.width, frames.height))
        content["links"] = summary(links)
        near = {name: values[links["gap"] <= 4] for name, values in links.items()}
        content["links_near"] = summary(near)
        if "masks" in truth:
            content["masks"] = mask_overlap(pool, truth["masks"])
    Path(record).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
