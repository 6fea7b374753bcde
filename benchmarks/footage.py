"""Clips as people have them: full length, 480p to 4K. A record for each measurement, and the table of them.

    python benchmarks/footage.py ../shared                                    # all parts, the default budget
    python benchmarks/footage.py ../shared --part joints --part ends --time-budget 20m --name 20m
    python benchmarks/footage.py ../shared --table

What has a record is not measured again, and a fit that was stopped goes on, as long as the folder `--work` is there.
The parts:

    joints      < delta_avg of BADJA's joints, three clips; chained DIS flow beside the model
    ends        tracks' last frames: errors, 59 tracks of eight clips; chained flow beside the model
    first32     TAP-Vid's first 32 frames, of a fit of the whole clip
    masks       J of the mask of frame 0, carried to all other frames
    memory      300 frames of 1920x1080: peak memory of each command
    length      2,000 frames of 640x360, and 200: memory, disk, seconds a frame
    precision   60 frames of 3840x2160: error in pixels of that frame, without and with `decomo-track --refine`
    whole       300 frames of 1920x1080, fitted to the end: likewise
    removal     `decomo-render --remove-objects` of a whole clip, processor seconds a frame
    crossing    4,096 points through ten windows, which are copies of one model: point-frames a second

The first four, `removal` and `crossing` share one fit of each clip of ../shared/data/davis480p; the other four are of
procedural clips (`harness/scenery.py`). `memory` and `length` fit few steps (`--few-steps`), in a cache of their own.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click
import numpy as np

from decomo_eval.baselines import FlowBaseline
from decomo_eval.dataset import Video
from decomo_runtime import Tracker, Tracks
from decomotion.console import run
from harness.crossing import copied, crossing_figures
from harness.footage_table import table
from harness.full_length import (
    CLIPS,
    ENDS,
    FIRST_32,
    JOINTS,
    Ask,
    annotated,
    clip_folder,
    clip_names,
    end_figures,
    first_frames_figures,
    mask_figures,
    model_asked,
    object_masks,
    position_figures,
)
from harness.plan import Plan, model, size, stage, timed, train
from harness.records import Record
from harness.scenery import Scenery, precision_figures
from harness.usage import measured, toolkit

RESULTS = Path(__file__).parent / "results"
CHAINED = "chained"
"""Names the folder of the baseline's records."""
LONGEST = "parkour"
"""The clip of which objects are removed and whose model is every window, where no clips are named."""
MEMORY, LONG, PRECISE = Scenery(300, 1920, 1080), Scenery(2000, 640, 360), Scenery(60, 3840, 2160)
SHORTER = 10
"""How much shorter the clip is that the long one is compared with."""
GRID = "32@0"
"""Points of the tracks that are drawn."""
RENDERED = 4
"""Frames of which objects are removed where it is memory that matters."""
WINDOWS, POINTS = 10, 4096


@dataclass(frozen=True)
class Task:
    """What is measured."""

    shared: Path
    plan: Plan
    few_steps: int
    clips: tuple[str, ...] | None
    every: int
    """Rows and columns between the pixels whose mask is carried."""
    smaller: int
    """Divides length and size of procedural clips, numbers of points and of frames without objects: a trial."""

    def wanted(self, names: Iterable[str]) -> list[str]:
        """Of these clips."""
        return [name for name in names if self.clips is None or name in self.clips]

    @property
    def one(self) -> str:
        """The clip of a part that needs but one."""
        return self.clips[0] if self.clips else LONGEST

    def fit(self, name: str) -> Path:
        """The model of a full-length clip."""
        return self.plan.fit(name, clip_folder(self.shared, name))

    def scenery(self, clip: Scenery) -> Scenery:
        """A procedural clip, smaller in a trial."""
        width, height = (side // self.smaller // 2 * 2 for side in (clip.width, clip.height))
        return Scenery(max(4, clip.num_frames // self.smaller), width, height)


def sparse(task: Task, kind: str, figures: Callable[[Video, Ask], Record]) -> None:
    """A part that scores tracks with few annotated frames, of the models and of chained flow."""
    videos, flow = annotated(task.shared, kind, task.plan.work), FlowBaseline("chain")
    for name in task.wanted(videos):
        about = {"tracker": flow.name, "kind": kind}
        task.plan.record(kind, name, about, lambda n=name: timed(figures, videos[n], flow), name=CHAINED)
        scored = lambda n=name: timed(figures, videos[n], model_asked(task.fit(n)))  # noqa: E731
        task.plan.record(kind, name, task.plan.facts, scored)


def joints(task: Task) -> None:
    sparse(task, JOINTS, position_figures)


def ends(task: Task) -> None:
    sparse(task, ENDS, end_figures)


def first32(task: Task) -> None:
    videos = annotated(task.shared, FIRST_32, task.plan.work)
    for name in task.wanted(videos):
        scored = lambda n=name: timed(first_frames_figures, videos[n], model_asked(task.fit(n)))  # noqa: E731
        task.plan.record(FIRST_32, name, task.plan.facts, scored)


def masks(task: Task) -> None:
    for name in task.wanted(clip_names(task.shared)):
        drawn = object_masks(task.shared, name)
        scored = lambda n=name, m=drawn: timed(mask_figures, Tracker(task.fit(n)), m, task.every)  # noqa: E731
        task.plan.record("masks", name, task.plan.facts | {"every": task.every}, scored)


def memory(task: Task) -> None:
    commands(task, "memory", task.scenery(MEMORY), prepared=True)


def length(task: Task) -> None:
    long = task.scenery(LONG)
    for clip in (replace(long, num_frames=max(4, long.num_frames // SHORTER)), long):
        commands(task, "length", clip, prepared=False)


def commands(task: Task, part: str, clip: Scenery, *, prepared: bool) -> None:
    """A record of what each command takes: few steps, tracks of a grid, few frames without objects.

    Without `prepared` there is no decomo-prepare, which takes a clip as one window.
    """
    plan, budget = task.plan, ("--steps", str(task.few_steps))
    facts = plan.facts | {"budget": " ".join(budget), **asdict(clip)}
    here = plan.folder(f"{part}-{clip.name}", facts)
    run, cache = here / "run", here / "cache"
    begin = clip.num_frames // 2
    shown = f"{begin}:{min(clip.num_frames, begin + RENDERED)}"

    def measure() -> Record:
        source = clip.write(plan.work / "clips")
        here.mkdir(parents=True, exist_ok=True)

        def command(name: str, *arguments: object) -> Record:
            return measured(toolkit(name, *arguments), [here], {"DECOMO_CACHE": str(cache)})

        lines: dict[str, Callable[[], Record]] = {
            "prepare": lambda: command("decomo-prepare", source, *plan.options),
            "train": lambda: train(source, run, plan.options, budget, [here], {"DECOMO_CACHE": str(cache)}),
            "export": lambda: command("decomo-export", model(run), "--run", run),
            "track": lambda: command(
                *("decomo-track", model(run), "--grid", GRID, "--out", here / "tracks.npz"),
                *("--clip", source, "--overlay", here / "tracks.mp4"),
            ),
            "render": lambda: command(
                *("decomo-render", model(run), "--remove-objects", "--clip", source, "--frames", shown),
                *("--out", here / "removed.mp4"),
            ),
        }
        left_out = () if prepared else ("prepare",)
        stages = {name: stage(here / f"{name}.json", line) for name, line in lines.items() if name not in left_out}
        return {"stages": stages, "model_bytes": size(model(run))}

    plan.record(part, clip.name, facts, measure)
    shutil.rmtree(cache, ignore_errors=True)


def precision(task: Task) -> None:
    errors(task, "precision", task.scenery(PRECISE))


def whole(task: Task) -> None:
    errors(task, "whole", task.scenery(MEMORY))


def errors(task: Task, part: str, clip: Scenery) -> None:
    """Records of how far tracks of a procedural clip are from the truth, without and with refinement on its frames."""
    source = clip.write(task.plan.work / "clips")
    ways: dict[str, tuple[object, ...]] = {"plain": (), "refined": ("--refine", "--clip", source)}
    for way, options in ways.items():

        def measure(way: str = way, options: tuple[object, ...] = options) -> Record:
            fitted = task.plan.fit(clip.name, source)
            asked, answers = fitted.parent / "queries.csv", fitted.parent / f"{way}.npz"
            xy, occluded = clip.truth()
            frame = occluded.argmin(axis=1)  # the first in which the point is in sight
            queries = np.column_stack([frame, xy[np.arange(len(xy)), frame]])
            np.savetxt(asked, queries, fmt=("%d", "%.4f", "%.4f"), delimiter=",", header="t,x,y", comments="")
            taken = measured(toolkit("decomo-track", fitted, "--queries", asked, "--out", answers, *options))
            return {"stages": {"track": taken}, **precision_figures(Tracks.load(answers), frame, xy, occluded)}

        task.plan.record(part, way, task.plan.facts | asdict(clip), measure)


def removal(task: Task) -> None:
    clip = clip_folder(task.shared, task.one)
    frames = max(1, len(list(clip.iterdir())) // task.smaller)

    def measure() -> Record:
        fitted = task.fit(task.one)
        options = ("--clip", clip, "--frames", f"0:{frames}", "--out", fitted.parent / "removed.mp4")
        taken = measured(toolkit("decomo-render", fitted, "--remove-objects", *options))
        return {"stages": {"render": taken}, "cpu_seconds_per_frame": round(taken["cpu_seconds"] / frames, 2)}

    task.plan.record("removal", task.one, task.plan.facts | {"frames": frames}, measure)


def crossing(task: Task) -> None:
    points = POINTS // task.smaller

    def measure() -> Record:
        fitted = task.fit(task.one)
        return crossing_figures(copied(fitted, fitted.parent / "copies", WINDOWS), points)

    task.plan.record("crossing", task.one, task.plan.facts | {"points": points, "windows": WINDOWS}, measure)


PARTS: dict[str, Callable[[Task], None]] = {
    part.__name__: part for part in (joints, ends, first32, masks, memory, length, precision, whole, removal, crossing)
}


def _budget(time_budget: str | None, steps: int | None, window: str | None) -> Iterator[str]:
    if time_budget is not None and steps is not None:
        raise click.UsageError("give --time-budget or --steps, not both")
    if time_budget is not None:
        yield from ("--time-budget", time_budget)
    if steps is not None:
        yield from ("--steps", str(steps))
    if window is not None:
        yield from ("--window", window)


@click.command(context_settings={"show_default": True})
@click.argument("shared", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--part", "parts", multiple=True, type=click.Choice(list(PARTS)), help="[default: all]")
@click.option("--table", "print_table", is_flag=True, help="Measure nothing, print the table of the records.")
@click.option("--name", default="default", help="Of the configuration and budget: a folder of records.")
@click.option("--preset", default="cpu")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Of the preset.")
@click.option("--time-budget", help="Of a fit, as for decomo-train.  [default: decomo-train's]")
@click.option("--steps", type=click.IntRange(min=1), help="Of each window, instead of a time.")
@click.option("--window", help="Frames fitted as one, as for decomo-train.  [default: auto]")
@click.option("--few-steps", default=200, help="Of each window where memory and time are measured.")
@click.option("--clips", help="Names of the full-length clips, separated by commas.  [default: all]")
@click.option("--every", default=2, type=click.IntRange(min=1), help="Carry masks at every so many rows and columns.")
@click.option("--smaller", default=1, type=click.IntRange(min=1), help="A trial: lengths and sizes by so much.")
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    default=RESULTS / "seeds" / "cpu",
    show_default="results/seeds/cpu",
    help="Records of fits of the first 32 frames.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=RESULTS / "footage",
    show_default="results/footage",
    help="Folder of the records.",
)
@click.option("--work", type=click.Path(path_type=Path), default=Path("/tmp/decomotion-footage"), help="Runs, models.")
def main(
    shared: Path,
    parts: tuple[str, ...],
    print_table: bool,
    name: str,
    preset: str,
    overrides: tuple[str, ...],
    time_budget: str | None,
    steps: int | None,
    window: str | None,
    few_steps: int,
    clips: str | None,
    every: int,
    smaller: int,
    reference: Path,
    out: Path,
    work: Path,
) -> None:
    """Measure with the clips of SHARED, the folder of real data, and with procedural ones."""
    if print_table:
        click.echo("\n".join(table(out / name, out / CHAINED, reference)))
        return
    wanted = tuple(clips.split(",")) if clips else None
    known = clip_names(shared)
    if unknown := [clip for clip in wanted or () if clip not in known]:
        raise click.UsageError(f"{shared / CLIPS} has no clip {', '.join(unknown)}; it has {', '.join(known)}")
    if name == CHAINED:
        raise click.UsageError(f"{CHAINED} names the baseline's records; give another --name")
    plan = Plan(out, work, name, preset, overrides, tuple(_budget(time_budget, steps, window)))
    task = Task(shared, plan, few_steps, wanted, every, smaller)
    for part in parts or PARTS:
        PARTS[part](task)
    if plan.failures:
        raise click.ClickException(f"{', '.join(plan.failures)} failed; the same command tries again")


if __name__ == "__main__":
    sys.exit(run(main))
