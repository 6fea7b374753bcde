"""Edits and stabilisation of a procedural clip against its exact truth: one record for each clip.

    python benchmarks/edits.py 32 384 216 --seed 3 --work runs/edits --out benchmarks/results/edits

Draws a clip of that many frames, that wide and high (`harness/scenery.py`), and fits a model to it in few steps; what
exists in `--work` is not made again. A picture of twice the size, discs of many colours, is painted over the middle
frame and drawn in all others, on what is seen, on the static scene and on the objects. Truth samples 3x3 places of each
pixel. In the record, means over frames:

    edits        by owner: `psnr`, dB, of the composite where the true or the drawn edit is; `alpha_error`, mean
                 distance of alpha there, in [0, 1]; `still_psnr`, `still_alpha_error`: of the picture
                 that is not moved at all
    stabilised   by transform: `residual`, pixels: how far points of the ground (300, in sight in both) are from where
                 they are in the frame of reference, root mean square; `shaking`: the same of their second difference
                 in time. `before` is the clip's own; `smoothed` is with --smooth, a third of a second
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

import click
import cv2
import numpy as np
import numpy.typing as npt

from decomo_runtime import Edit, Stabilisation, Tracker, draw_edits, stabilise
from decomo_runtime.mipmaps import Mipmaps
from decomo_runtime.options import DENSE, HOMOGRAPHY, OWNERS, SEEN, SIMILARITY, STATIC, TRANSLATION
from decomo_runtime.sampling import sampled
from decomo_runtime.still_pictures import maps_of
from decomotion.console import run
from decomotion.frame_files import frame_files, open_frames
from harness.fitted import fitted_model, written
from harness.pictures import psnr
from harness.records import Record, provenance, write_record
from harness.scenery import Scenery

_PATH = click.Path(path_type=Path)
FINER, SUBPIXELS = 2, 3
"""Size of the picture over that of the clip; places of a pixel that truth samples, either way."""
EVERY = 5
"""Frames between those in which edits are compared."""
POINTS = 300
SMOOTH = 1 / 3
"""Seconds."""

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]


def discs(height: int, width: int, seed: int) -> Image:
    """RGBA [h, w, 4]: discs of many colours in rows, with rings of another, on a transparent ground."""
    picture = np.zeros((height, width, 4), np.uint8)
    random, step = np.random.default_rng(seed), height // 6
    for y in range(step // 2, height, step):
        for x in range(step // 2, width, step):
            for share in (0.42, 0.28, 0.14):
                colour = (*random.integers(0, 256, 3).tolist(), 255)
                cv2.circle(picture, (x, y), round(share * step), colour, cv2.FILLED, cv2.LINE_AA)
    return picture


def true_layer(scenery: Scenery, edit: Edit, frame: int) -> Floats:
    """[H, W, 4], premultiplied RGBA in [0, 1]: the edit as it really is in a frame."""
    offsets = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    y = (np.arange(scenery.height)[:, None] + offsets).ravel()
    x = (np.arange(scenery.width)[:, None] + offsets).ravel()
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    queries = np.column_stack([np.full(len(places), frame), places])
    on_object = scenery.on_object(queries)
    if edit.on == STATIC:
        there, hidden = scenery.ground(places, frame, edit.frame), on_object
    else:
        xy, occluded = scenery.follow(queries, [edit.frame])
        there, hidden = xy[:, 0], occluded[:, 0] | ((edit.on != SEEN) & ~on_object)
    ratio = edit.picture.shape[0] / scenery.height
    read = Mipmaps(edit.picture).read(((there + 0.5) * ratio - 0.5).astype(np.float32), np.ones(len(there), np.float32))
    read[hidden] = 0
    return read.reshape(scenery.height, SUBPIXELS, scenery.width, SUBPIXELS, 4).mean(axis=(1, 3))


def compared(clip: Image, truth: Floats, drawn: Image, alpha: Floats) -> tuple[float, float] | None:
    """PSNR of the composite and error of alpha, where the true edit or the drawn one is; None where neither is."""
    area = (truth[..., 3] > 0) | (alpha > 0)
    if not area.any():
        return None
    true = np.rint(255 * truth[..., :3] + (1 - truth[..., 3:]) * clip).clip(0, 255).astype(np.uint8)
    return psnr(drawn[area], true[area]), float(np.abs(truth[..., 3] - alpha)[area].mean())


def measure_edits(tracker: Tracker, scenery: Scenery, frames: Sequence[Image], owner: str) -> Record:
    """Of one owner."""
    size = FINER * scenery.height, FINER * scenery.width
    edit = Edit(discs(*size, scenery.seed), scenery.num_frames // 2, owner)
    wanted = [frame for frame in range(0, scenery.num_frames, EVERY) if frame != edit.frame]
    composites = draw_edits(tracker, frames, [edit], wanted)
    layers = draw_edits(tracker, frames, [edit], wanted, alone=True)
    still = cv2.resize(edit.picture, (scenery.width, scenery.height), interpolation=cv2.INTER_AREA)
    cover = (still[..., 3:] / 255).astype(np.float32)
    figures: list[tuple[float, ...]] = []
    for frame, drawn, layer in zip(wanted, composites, layers, strict=True):
        truth = true_layer(scenery, edit, frame)
        moved = compared(frames[frame], truth, drawn, (layer[..., 3] / 255).astype(np.float32))
        unmoved = np.rint(still[..., :3] * cover + frames[frame] * (1 - cover)).astype(np.uint8)
        unmoved = compared(frames[frame], truth, unmoved, cover[..., 0])
        if moved is not None and unmoved is not None:
            figures.append((*moved, *unmoved))
    names = "psnr", "alpha_error", "still_psnr", "still_alpha_error"
    return dict(zip(names, map(fmean, zip(*figures, strict=True)), strict=True))


def measure_stabilised(tracker: Tracker, scenery: Scenery) -> Record:
    """By transform, of the ground."""
    reference = scenery.num_frames // 2
    random = np.random.default_rng(scenery.seed)
    places = random.uniform(0, (scenery.width - 1, scenery.height - 1), (4 * POINTS, 2))
    queries = np.column_stack([np.full(len(places), reference), places])
    queries = queries[~scenery.on_object(queries)][:POINTS]
    xy, hidden = scenery.follow(queries)
    figures = {"before": _motion(xy, hidden, reference)}
    for by in (TRANSLATION, SIMILARITY, HOMOGRAPHY, DENSE):
        found = stabilise(tracker, f"scene@{reference}", by=by)
        figures[by] = _motion(_held(tracker, found, xy), hidden, reference)
    found = stabilise(tracker, "scene", smooth=SMOOTH)
    figures["smoothed"] = {"shaking": _motion(_held(tracker, found, xy), hidden, reference)["shaking"]}
    return figures


def _held(tracker: Tracker, found: Stabilisation, xy: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """[N, T, 2], where points [N, T, 2] of the clip are in the still picture."""
    if found.by != DENSE:
        moved = [cv2.perspectiveTransform(xy[None, :, frame], found.matrices[frame])[0] for frame in found.frames]
        return np.stack(moved, axis=1)
    maps, held = maps_of(tracker, found), np.empty_like(xy)
    for frame in found.frames.tolist():
        places, guess = maps.places(frame), xy[:, found.still.frame].copy()
        for _ in range(10):  # the map leads from the still picture: it is inverted
            guess += xy[:, frame] - sampled(places, guess.astype(np.float32))
        held[:, frame] = guess
    return held


def _motion(xy: npt.NDArray[np.float64], hidden: npt.NDArray[np.bool_], reference: int) -> Record:
    """Root mean squares, pixels, of points [N, T, 2] where they are not `hidden` [N, T]."""
    away = np.linalg.norm(xy - xy[:, reference : reference + 1], axis=-1)
    jumps = np.linalg.norm(np.diff(xy, 2, axis=1), axis=-1)
    seen = ~hidden[:, :-2] & ~hidden[:, 1:-1] & ~hidden[:, 2:]
    return {"residual": _rms(away[~hidden]), "shaking": _rms(jumps[seen])}


def _rms(values: npt.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


@click.command(context_settings={"show_default": True})
@click.argument("frames", type=click.IntRange(min=8))
@click.argument("width", type=click.IntRange(min=32))
@click.argument("height", type=click.IntRange(min=32))
@click.option("--seed", default=0, help="Of the scene.")
@click.option("--steps", default=600, help="Of the fit.")
@click.option("--work", type=_PATH, required=True, help="Folder for clips, runs and models.")
@click.option("--out", type=_PATH, required=True, help="Folder of the records.")
def main(frames: int, width: int, height: int, seed: int, steps: int, work: Path, out: Path) -> None:
    """Measure edits and stabilisation of a procedural clip whose truth is known."""
    cv2.setNumThreads(1)
    scenery = Scenery(frames, width, height, seed)
    folder = written(scenery, work)
    model = fitted_model(folder, steps, work)
    tracker, pictures = Tracker(model, threads=1), list(open_frames(frame_files(folder)))
    record = {
        "clip": scenery.name,
        "steps": steps,
        "model": hashlib.sha256(model.read_bytes()).hexdigest()[:12],
        "edits": {owner: measure_edits(tracker, scenery, pictures, owner) for owner in OWNERS},
        "stabilised": measure_stabilised(tracker, scenery),
    }
    write_record(out / f"{scenery.name}.json", record | provenance())
    click.echo(scenery.name)
    for name, figures in (record["edits"] | record["stabilised"]).items():
        click.echo(f"  {name}: " + ", ".join(f"{key} {value:.3f}" for key, value in figures.items()))


if __name__ == "__main__":
    sys.exit(run(main))
