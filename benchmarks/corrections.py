"""What corrections make better, and whether they make anything worse: full-length clips with annotated joints.

    python benchmarks/corrections.py ../shared /tmp/decomotion-footage/default --steps 600
    python benchmarks/corrections.py --table

Of each clip of BADJA's joints (`harness/full_length.py`), whose finished fits lie in RUNS (`footage.py` makes them:
`<clip>-<digest>/run`), the five worst tracks are told the truth at one, two and four frames, and `decomo-train
--corrections` fits anew. One record for each clip and number of frames; distances in pixels of the clip, of tracks
from their first annotated frame. Each of the figures is [before, after]:

    given        median error of corrected tracks at the frames that were given
    elsewhere    their mean and median error at annotated frames that were not
    neighbours   median distance of points 6 pixels from a corrected one, on the same volume, from where they would
                 be if they kept their offset to the true track, at frames that were not given
    joints       median error of the joints that were not corrected
    first32      median error of TAP-Vid's tracks in frames 0 to 31, none of which was corrected

`moved` says how far other tracks move: medians of the first32's tracks, and of 300 random points that are in sight,
`near`, at some time within 60 pixels of a corrected track, and `far`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt

from decomo_eval.dataset import Video
from decomotion import checkpoint
from decomotion.console import run
from decomotion.corrections.file import HEADER
from decomotion.corrections.following import follow, see
from decomotion.model.fusion import DecoMotion
from harness.full_length import ANNOTATED, FIRST_32, JOINTS, annotated, clip_folder
from harness.records import Record, provenance, write_record
from harness.usage import measured, toolkit

RESULTS = Path(__file__).parent / "results" / "corrections"
GIVEN = (1, 2, 4)
WORST = 5
RANDOM, NEAR = 300, 60.0
AROUND = 6.0
HIDDEN = 0.5

Floats = npt.NDArray[np.floating]


class Truth:
    """Annotated tracks of a clip, asked for in their first annotated frame."""

    def __init__(self, video: Video, size: tuple[int, int]) -> None:
        self.xy: Floats = np.asarray(video.points) * size - 0.5
        """[N, T, 2], pixels of the clip."""
        seen = ~np.asarray(video.occluded)
        row, first = np.arange(len(seen)), seen.argmax(axis=1)
        self.queries: Floats = np.column_stack([first.astype(np.float64), self.xy[row, first]])
        seen[row, first] = False
        self.later: npt.NDArray[np.bool_] = seen
        """[N, T]: where there is something to compare with."""

    def errors(self, xy: Floats) -> Floats:
        """[N, T], NaN where nothing is known."""
        return np.where(self.later, np.linalg.norm(xy - self.xy, axis=-1), np.nan)


def given_frames(frames: npt.NDArray[np.int64], count: int) -> npt.NDArray[np.int64]:
    """One in the middle of the annotated frames, or several evenly up to the last."""
    share = np.array([0.5]) if count == 1 else np.linspace(0, 1, count + 1)[1:]
    return frames[np.round(share * (len(frames) - 1)).astype(int)]


def corrections(truth: Truth, tracks: npt.NDArray[np.int64], frames: list[npt.NDArray[np.int64]]) -> str:
    """The file that says the truth about `tracks` at their `frames`."""
    lines = [HEADER]
    for track, given in zip(tracks, frames, strict=True):
        t, x, y = truth.queries[int(track)]
        ends = ((frame, *truth.xy[track, frame]) for frame in given)
        lines += [f"{t:.0f},{x:.3f},{y:.3f},{frame},{there_x:.3f},{there_y:.3f}" for frame, there_x, there_y in ends]
    return "\n".join(lines) + "\n"


def neighbours(model: DecoMotion, queries: Floats) -> tuple[Floats, npt.NDArray[np.int64], Floats]:
    """Queries beside others on the same volume, the row of the other, and their offsets."""
    offsets = AROUND * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    found: list[tuple[Floats, int, Floats]] = []
    for row, (t, *xy) in enumerate(queries):
        owners = see(model, int(t), np.array([xy, *(np.array(xy) + offsets)])).moving
        found += [
            (np.array([t, *(np.array(xy) + offset)]), row, offset)
            for offset, owner in zip(offsets, owners[1:], strict=True)
            if owner == owners[0]
        ]
    beside, rows, moved = zip(*found, strict=True)
    return np.array(beside), np.array(rows), np.array(moved)


def compared(
    before: DecoMotion,
    after: DecoMotion,
    truth: Truth,
    others: Truth,
    tracks: npt.NDArray[np.int64],
    given: list[npt.NDArray[np.int64]],
) -> Record:
    """The figures of one fit."""
    told = np.zeros(truth.later.shape, bool)
    for track, frames in zip(tracks, given, strict=True):
        told[track, frames] = True
    corrected = np.isin(np.arange(len(told)), tracks)
    beside, rows, offsets = neighbours(before, truth.queries[tracks])
    pairs: dict[str, list[float]] = {}
    paths = []
    for model in (before, after):
        paths.append(follow(model, truth.queries).xy)
        error = truth.errors(paths[-1])
        rest = error[corrected][~told[corrected]]
        moved = follow(model, beside).xy - offsets[:, None] - truth.xy[tracks][rows]
        known = (truth.later & ~told)[tracks][rows]
        figures = {
            "given": np.nanmedian(error[told]),
            "elsewhere_mean": np.nanmean(rest),
            "elsewhere_median": np.nanmedian(rest),
            "neighbours": np.median(np.linalg.norm(moved, axis=-1)[known]),
            "joints": np.nanmedian(error[~corrected]),
            "first32": np.nanmedian(others.errors(follow(model, others.queries).xy)[:, :ANNOTATED]),
        }
        for name, figure in figures.items():
            pairs.setdefault(name, []).append(round(float(figure), 3))
    frames, plane = before.num_frames, before.plane
    random = np.random.default_rng(0)
    places = random.random((RANDOM, 2)) * (plane.width - 1, plane.height - 1)
    asked = np.column_stack([random.integers(frames, size=RANDOM).astype(np.float64), places])
    one, two = follow(before, asked), follow(after, asked)
    moved, seen = np.linalg.norm(one.xy - two.xy, axis=-1), one.occlusion < HIDDEN
    ways = np.concatenate([path[tracks] for path in paths])
    near = (np.linalg.norm(one.xy[:, None] - ways[None], axis=-1) < NEAR).any(axis=(1, 2))
    shifts = np.linalg.norm(follow(before, others.queries).xy - follow(after, others.queries).xy, axis=-1)
    return {
        **pairs,
        "moved": {
            "first32": round(float(np.median(shifts[:, :ANNOTATED][others.later[:, :ANNOTATED]])), 3),
            "near": round(float(np.median(moved[near][seen[near]])), 3),
            "far": round(float(np.median(moved[~near][seen[~near]])), 3),
        },
    }


def measure(shared: Path, runs: Path, name: str, steps: int, work: Path, out: Path) -> None:
    """The records of one clip."""
    (fitted,) = sorted(runs.glob(f"{name}-*/run"))
    saved = checkpoint.load(fitted / checkpoint.FILE_NAME)
    size = (saved.clip.width, saved.clip.height)
    truth, others = (Truth(annotated(shared, kind, work)[name], size) for kind in (JOINTS, FIRST_32))
    error = truth.errors(follow(saved.model, truth.queries).xy)
    enough = truth.later.sum(axis=1) >= max(GIVEN) + 2
    worst = np.argsort(-np.where(enough, np.nan_to_num(np.nanmean(error, axis=1)), -1))[:WORST]
    for count in GIVEN:
        record = out / f"{name}-{count}.json"
        if record.is_file():
            continue
        given = [given_frames(np.flatnonzero(truth.later[track]), count) for track in worst]
        new = work / f"{name}-{count}-{steps}"
        file = work / f"{name}-{count}.csv"
        file.write_text(corrections(truth, worst, given))
        taken: Record = {}
        if not new.is_dir():
            line = ("decomo-train", clip_folder(shared, name), "--run", fitted, "--corrections", file)
            taken = {"stages": {"train": measured(toolkit(*line, "--out", new, "--steps", steps))}}
        model = checkpoint.load(new / checkpoint.FILE_NAME).model
        figures = compared(saved.model, model, truth, others, worst, given)
        about = {"clip": name, "given": count, "steps": steps, "tracks": worst.tolist(), **provenance()}
        write_record(record, about | taken | figures)
        click.echo(f"{record}: {figures}")


def table(out: Path) -> list[str]:
    """Of all records, as documentation has it."""
    titles = ("clip", "frames given", "given", "elsewhere, mean", "elsewhere, median", "neighbours", "other joints")
    titles = (*titles, "first32", "moved: first32", "near", "far")
    lines = ["| " + " | ".join(titles) + " |", "|---" * len(titles) + "|"]
    for file in sorted(out.glob("*.json")):
        record = json.loads(file.read_text())
        names = ("given", "elsewhere_mean", "elsewhere_median", "neighbours", "joints", "first32")
        cells = [record["clip"], str(record["given"])]
        cells += ["{:.1f} → {:.1f}".format(*record[name]) for name in names]
        cells += [f"{record['moved'][name]:.2f}" for name in ("first32", "near", "far")]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


@click.command(context_settings={"show_default": True})
@click.argument("shared", type=click.Path(path_type=Path), required=False)
@click.argument("runs", type=click.Path(path_type=Path), required=False)
@click.option("--table", "print_table", is_flag=True, help="Measure nothing, print the table of the records.")
@click.option("--clips", default="camel,dog,horsejump-high", help="Separated by commas.")
@click.option("--steps", default=600, help="Of a fit.")
@click.option("--work", type=click.Path(path_type=Path), default=Path("/tmp/decomotion-corrections"))
@click.option("--out", type=click.Path(path_type=Path), default=RESULTS, show_default="results/corrections")
def main(
    shared: Path | None, runs: Path | None, print_table: bool, clips: str, steps: int, work: Path, out: Path
) -> None:
    """Measure with the clips of SHARED, the folder of real data, and the finished fits in RUNS."""
    if print_table:
        click.echo("\n".join(table(out)))
        return
    if shared is None or runs is None:
        raise click.UsageError("give SHARED and RUNS, or --table")
    work.mkdir(parents=True, exist_ok=True)
    for name in clips.split(","):
        measure(shared, runs, name, steps, work, out)


if __name__ == "__main__":
    sys.exit(run(main))
