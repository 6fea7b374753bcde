"""From a clip to its supervision: flow, links, camera, masks and features, kept as one pool in the cache."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from decomotion.clip import Clip
from decomotion.config import DataConfig
from decomotion.data import camera, linking, masks
from decomotion.data.flow import DisFlow, FlowEstimator
from decomotion.data.pool import UNKNOWN_MOTION, Pool, grid_shape, jittered_grid, open_pool

POOL_VERSION = 4
"""Raised whenever the same clip and settings would give another pool."""

ABANDONED_SECONDS = 24 * 3600

CONFIDENT_VARIANCE = 1.0
"""Accumulated squared error, units^2, at which the confidence is one half."""


def cache_root() -> Path:
    """Where prepared supervision is kept: `$DECOMO_CACHE`, or `~/.cache/decomotion`."""
    return Path(os.environ.get("DECOMO_CACHE") or Path.home() / ".cache" / "decomotion")


def prepare(clip: Clip, config: DataConfig, *, rebuild: bool = False, progress: bool = True) -> Pool:
    """The pool of `clip`, from the cache where it was prepared before with the same settings.

    Raises `SupervisionError` where the user's masks do not fit the clip.
    """
    given = (
        None
        if config.masks in ("auto", "none")
        else masks.read_masks(Path(config.masks), len(clip), clip.height, clip.width)
    )
    folder = cache_root() / _key(clip, config, given)
    if rebuild or not folder.is_dir():
        partial = folder.with_name(f"{folder.name}.{os.getpid()}.partial")
        _remove_abandoned(folder)
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        try:
            _build(clip, config, given, partial, progress)
            shutil.rmtree(folder, ignore_errors=True)
            partial.rename(folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    return open_pool(folder)


def _remove_abandoned(folder: Path) -> None:
    """Removes what killed runs left of this entry a day ago or earlier: a younger one may still be at work."""
    for partial in folder.parent.glob(f"{folder.name}.*.partial"):
        if time.time() - partial.stat().st_mtime > ABANDONED_SECONDS:
            shutil.rmtree(partial, ignore_errors=True)


def _key(clip: Clip, config: DataConfig, given: npt.NDArray[np.bool_] | None) -> str:
    parts = [str(POOL_VERSION), clip.digest(), json.dumps(config.model_dump(), sort_keys=True)]
    if given is not None:
        parts.append(hashlib.sha256(np.packbits(given).tobytes()).hexdigest())
    return hashlib.sha256("|".join(parts).encode()).hexdigest()[:20]


def _build(clip: Clip, config: DataConfig, given: npt.NDArray[np.bool_] | None, folder: Path, progress: bool) -> None:
    random = np.random.default_rng(0)
    points = jittered_grid(len(clip), clip.height, clip.width, config.pool.points_per_frame, random)
    np.save(folder / "points.npy", points)
    fields = _flow_fields(clip, config, folder, progress)
    targets, confidence = _link_all(points, fields, clip, config, folder, progress)
    (folder / "flow.npy").unlink()

    grid = grid_shape(clip.height, clip.width, config.pool.points_per_frame)
    moving = _moving(points, targets, confidence, given, clip, config, grid)
    np.save(folder / "moving.npy", moving)
    usable = confidence > 0
    unit = max(clip.height, clip.width) / 256
    of_scene = camera.chain(points, targets, usable & (moving != 1)[:, None], unit)
    of_object = camera.chain(points, targets, usable & (moving != 0)[:, None], unit, similarity=True, fallback=of_scene)
    for name, maps in (("camera", of_scene), ("object", of_object)):
        np.save(folder / f"{name}.npy", camera.to_normalised(maps, clip.height, clip.width))

    np.save(folder / "rgb.npy", np.stack([_at(frame, xy) for frame, xy in zip(clip.frames, points, strict=True)]))
    np.save(folder / "feature.npy", _features(clip, points, config))


def _flow_fields(clip: Clip, config: DataConfig, folder: Path, progress: bool) -> linking.FieldLookup:
    """Flow at the configured intervals both ways, float16 on disk while it is needed."""
    pairs = [
        (first, second)
        for first in range(len(clip))
        for gap in config.flow.intervals
        for second in (first - gap, first + gap)
        if 0 <= second < len(clip) and gap <= config.pool.max_gap
    ]
    index = {pair: row for row, pair in enumerate(pairs)}
    local = threading.local()

    def estimate(pair: tuple[int, int]) -> npt.NDArray[np.float32]:
        if not hasattr(local, "flow"):
            local.flow = DisFlow(config.flow)
        flow: FlowEstimator = local.flow
        return flow(clip.frames[pair[0]], clip.frames[pair[1]])

    first = estimate(pairs[0])
    fields = np.lib.format.open_memmap(
        folder / "flow.npy", mode="w+", dtype=np.float16, shape=(len(pairs), *first.shape)
    )

    def store(row: int) -> None:
        fields[row] = estimate(pairs[row])

    _in_threads(store, len(pairs), "flow", progress)
    return lambda source, target: fields[index[source, target]].astype(np.float32)


def _in_threads(task: Callable[[int], None], count: int, stage: str, progress: bool) -> None:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # one pair a thread is faster than every thread on one pair
    try:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(tqdm(pool.map(task, range(count)), stage, total=count, disable=not progress, leave=False))
    finally:
        cv2.setNumThreads(threads)


def _link_all(
    points: npt.NDArray[np.float32],
    field: linking.FieldLookup,
    clip: Clip,
    config: DataConfig,
    folder: Path,
    progress: bool,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
    """Links every frame's points to every other frame; writes and returns `targets` and `confidence`."""
    frames, count = points.shape[:2]
    targets = np.lib.format.open_memmap(
        folder / "targets.npy", mode="w+", dtype=np.float32, shape=(frames, frames, count, 2)
    )
    confidence = np.lib.format.open_memmap(
        folder / "confidence.npy", mode="w+", dtype=np.uint8, shape=(frames, frames, count)
    )
    raster = field(0, 1).shape[:2]
    shrink = np.array([raster[1] / clip.width, raster[0] / clip.height], np.float32)
    on_raster = (points + 0.5) * shrink - 0.5
    with tqdm(total=2 * frames, desc="link", disable=not progress, leave=False) as bar:
        for step in (1, -1):
            for links in linking.link(
                on_raster, field, config.flow.intervals, config.pool.cycle_threshold, config.pool.max_gap, step
            ):
                targets[links.sources, links.target] = (links.xy + 0.5) / shrink - 0.5
                certain = np.where(links.occluded, 0, CONFIDENT_VARIANCE / (CONFIDENT_VARIANCE + links.variance))
                confidence[links.sources, links.target] = np.round(255 * certain)
                bar.update()
    for frame in range(frames):
        targets[frame, frame] = points[frame]
        confidence[frame, frame] = 255
    return targets, confidence


def _moving(
    points: npt.NDArray[np.float32],
    targets: npt.NDArray[np.float32],
    confidence: npt.NDArray[np.uint8],
    given: npt.NDArray[np.bool_] | None,
    clip: Clip,
    config: DataConfig,
    grid: tuple[int, int],
) -> npt.NDArray[np.uint8]:
    """[frame, point]: 1 on what moves, 0 on the scene; `UNKNOWN_MOTION` everywhere with masks `none`."""
    if config.masks == "none":
        return np.full(points.shape[:2], UNKNOWN_MOTION, np.uint8)
    if given is None:
        given = masks.auto_masks(clip.frames, points, targets, confidence, grid)
    nearest = np.round(points).astype(np.int64)
    frame = np.arange(len(points))[:, None]
    return given[frame, nearest[..., 1], nearest[..., 0]].astype(np.uint8)


def _at(image: npt.NDArray, xy: npt.NDArray[np.float32]) -> npt.NDArray:
    """Bilinear values of [H, W, c] at [point, 2]."""
    return cv2.remap(image, xy[None], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]  # type: ignore[call-overload]


def _features(clip: Clip, points: npt.NDArray[np.float32], config: DataConfig) -> npt.NDArray[np.float16]:
    if config.features == "none":
        return np.zeros((*points.shape[:2], 0), np.float16)
    from decomotion.data.features import dense_sift, reduce_features

    # features are read at the points frame by frame: whole maps of 128 channels would fill the memory
    read = [_read_map(dense_sift(frame), xy, clip) for frame, xy in zip(clip.frames, points, strict=True)]
    return reduce_features(np.stack(read), config.feature_size).astype(np.float16)


def _read_map(image: npt.NDArray[np.float32], xy: npt.NDArray[np.float32], clip: Clip) -> npt.NDArray[np.float32]:
    """Values [point, c] of a map [h, w, c] that covers the clip's image, at `xy` in pixels of the clip."""
    where = (xy + 0.5) * np.array([image.shape[1] / clip.width, image.shape[0] / clip.height], np.float32) - 0.5
    # cv2.remap takes at most 4 channels at a time
    parts = [np.ascontiguousarray(image[..., first : first + 4]) for first in range(0, image.shape[-1], 4)]
    return np.concatenate([_at(part, where).reshape(len(where), -1) for part in parts], axis=-1)
