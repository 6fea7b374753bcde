"""How often cuts are found where there are none, and where there are: ours beside PySceneDetect's detectors.

    python benchmarks/cuts.py ../shared --json benchmarks/results/cuts.json
    python benchmarks/cuts.py --table benchmarks/results/cuts.json

False cuts: clips in which any is found, by what is made to happen a third of the way in (`harness/incidents.py`).
Joins: the last 16 frames of one clip, then the first 16 of another; found where a cut is at that frame, or within the
transition. PySceneDetect has its default settings, and frames of the size its own command would give it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, permutations
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from scenedetect import FrameTimecode, detectors
from scenedetect.detector import SceneDetector
from scenedetect.scene_manager import compute_downscale_factor

from decomo_eval.dataset import read_dataset
from decomo_eval.sample import generate
from decomotion.clip import read_clip
from decomotion.data.cuts import find_cuts
from harness.clips import PROCEDURAL_FRAMES, PROCEDURAL_SIZE, UNSEEN_SEEDS
from harness.incidents import INCIDENTS, Frames
from harness.records import provenance, write_record

HALF = 16
"""Frames of either clip of a join: PySceneDetect finds no cut before its fifteenth frame."""
Clips = dict[str, Frames]
Find = Callable[[Frames], list[int]]


def _scenedetect(make: Callable[[], SceneDetector]) -> Find:
    def find(frames: Frames) -> list[int]:
        detector, found, rate = make(), [], 24.0
        height, width = frames.shape[1:3]
        factor = compute_downscale_factor(max(height, width))
        size = (round(width / factor), round(height / factor))
        for number, frame in enumerate(frames):
            small = cv2.cvtColor(cv2.resize(frame, size), cv2.COLOR_RGB2BGR)
            found += detector.process_frame(FrameTimecode(number, rate), np.asarray(small))
        found += detector.post_process(FrameTimecode(len(frames) - 1, rate))
        return [cut.frame_num for cut in found]

    return find


FINDERS: dict[str, Find] = {
    "ours": find_cuts,
    "Content": _scenedetect(detectors.ContentDetector),
    "Adaptive": _scenedetect(detectors.AdaptiveDetector),
    "Hash": _scenedetect(detectors.HashDetector),
    "Histogram": _scenedetect(detectors.HistogramDetector),
    "Threshold": _scenedetect(detectors.ThresholdDetector),
}


@dataclass(frozen=True)
class Join:
    """Frames of two shots; the first frame that belongs to the second one lies in [`first`, `last`]."""

    name: str
    frames: Frames
    first: int = HALF
    last: int = HALF

    def is_found(self, cuts: Sequence[int]) -> bool:
        return any(self.first <= cut <= self.last for cut in cuts)


def _square(frames: Frames) -> Frames:
    """At the datasets' size."""
    size = (PROCEDURAL_SIZE, PROCEDURAL_SIZE)
    return np.stack([cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames]).astype(np.uint8)


def read_sets(shared: Path) -> dict[str, Clips]:
    """Clips by the set the table speaks of; `films` are of 40 frames."""
    small = {
        name: np.asarray(video.frames())
        for file in ("tapvid_davis32_dev.pkl", "tapvid_davis32_dev2.pkl")
        for name, video in read_dataset(shared / "data" / file).items()
    }
    films = {name: np.asarray(read_clip(f"{shared}/data/clips/{name}.mp4@0:40").frames) for name in ("cat", "apple")}
    folders = sorted((shared / "data/davis480p/frames").iterdir())
    full = {path.name: np.asarray(read_clip(path).frames) for path in folders}
    drawn = {f"seed{seed}": generate(seed, PROCEDURAL_FRAMES, PROCEDURAL_SIZE).video for seed in UNSEEN_SEEDS}
    return {"256x256": small, "films": films, "854x480": full, "procedural": drawn}


def blend(one: Frames, other: Frames, num_frames: int) -> Frames:
    """`one`, so many blends of its last frames with `other`'s first ones, and `other`."""
    mixed = []
    for number in range(num_frames):
        share = (number + 1) / (num_frames + 1)
        mixed.append(cv2.addWeighted(one[number - num_frames], 1 - share, other[number], share, 0))
    return np.stack([*one[: len(one) - num_frames], *mixed, *other[num_frames:]]).astype(np.uint8)


def through_black(one: Frames, other: Frames, num_frames: int) -> Frames:
    """`one` fades out and `other` in, over so many frames each."""
    gain = np.linspace(1, 0, num_frames, dtype=np.float32)[:, None, None, None]
    out, back = one[-num_frames:] * gain, other[:num_frames] * gain[::-1]
    return np.concatenate([one[:-num_frames], out, back, other[num_frames:]]).astype(np.uint8)


def joins(sets: dict[str, Clips]) -> Iterator[tuple[str, Iterator[Join]]]:
    """By what the table calls them; of 256x256 all ordered pairs, of what is made from them every fifth."""
    small = sets["256x256"] | {name: _square(frames) for name, frames in sets["films"].items()}

    def pairs(clips: Clips, every: int = 1) -> Iterator[tuple[str, Frames, Frames]]:
        for one, other in islice(permutations(clips, 2), 0, None, every):
            yield f"{one}, {other}", clips[one][-HALF:], clips[other][:HALF]

    def hard(clips: Clips, every: int = 1) -> Iterator[Join]:
        return (Join(name, np.concatenate([one, other])) for name, one, other in pairs(clips, every))

    def soft(length: int, mixed: Callable[[Frames, Frames, int], Frames]) -> Iterator[Join]:
        for name, one, other in pairs(small, 5):
            yield Join(name, mixed(one, other, length), HALF - length, HALF + length)

    yield "different scenes, 256x256", hard(small)
    yield "different scenes, 854x480", hard(sets["854x480"], 3)
    yield "different scenes, procedural", hard(sets["procedural"])
    grey = (join.frames.mean(3, keepdims=True).astype(np.uint8).repeat(3, 3) for join in hard(small, 5))
    yield "different scenes in grey", (Join(str(number), frames) for number, frames in enumerate(grey))
    yield "different scenes at a fifth of their light", (Join(join.name, join.frames // 5) for join in hard(small, 5))
    for length in (1, 3, 6):
        yield f"different scenes, blended over {length}", soft(length, blend)
    yield "different scenes, through black", soft(6, through_black)
    long = {name: frames for name, frames in sets["854x480"].items() if len(frames) >= 60}
    yield (
        "one clip's first and last frames",
        (Join(name, np.concatenate([frames[:HALF], frames[-HALF:]])) for name, frames in long.items()),
    )


def measure(sets: dict[str, Clips]) -> dict[str, Any]:
    """`missed` {joins: {of, finder: [names]}}, `false` {set: {incident: {of, finder: [clips]}}}, `ms_per_frame`."""
    spent, num_frames = dict.fromkeys(FINDERS, 0.0), 0

    def ask(frames: Frames) -> dict[str, list[int]]:
        nonlocal num_frames
        num_frames += len(frames)
        answers = {}
        for name, find in FINDERS.items():
            begin = time.process_time()
            answers[name] = find(frames)
            spent[name] += time.process_time() - begin
        return answers

    record: dict[str, Any] = {"false": {}, "missed": {}}
    for row, of_row in joins(sets):
        missed: dict[str, Any] = {"of": 0} | {finder: [] for finder in FINDERS}
        for join in of_row:
            missed["of"] += 1
            for finder, cuts in ask(join.frames).items():
                if not join.is_found(cuts):
                    missed[finder].append(join.name)
        record["missed"][row] = missed
        click.echo(_line(row, missed))
    for group, clips in sets.items():
        record["false"][group] = {}
        for incident, make in INCIDENTS.items():
            answers = {
                name: ask(make(frames, len(frames) // 3, np.random.default_rng(number)))
                for number, (name, frames) in enumerate(clips.items())
            }
            record["false"][group][incident] = {"of": len(answers)} | {
                finder: [name for name, cuts in answers.items() if cuts[finder]] for finder in FINDERS
            }
            click.echo(_line(f"{group}, {incident}", record["false"][group][incident]))
    record["ms_per_frame"] = {name: round(1e3 * seconds / num_frames, 2) for name, seconds in spent.items()}
    return record


def _line(row: str, counts: dict[str, Any]) -> str:
    return f"| {row} | {counts['of']} | " + " | ".join(str(len(counts[finder])) for finder in FINDERS) + " |"


def _sum(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    return {"of": sum(row["of"] for row in rows)} | {
        finder: [name for row in rows for name in row[finder]] for finder in FINDERS
    }


def table(record: dict[str, Any]) -> str:
    """Both rates; incidents over all sets, then all incidents by set."""
    head = " | ".join(FINDERS)
    rule = "|---|" + "---|" * (1 + len(FINDERS))
    by_set = record["false"]
    lines = [f"| joins missed | of | {head} |", rule]
    lines += [_line(row, counts) for row, counts in record["missed"].items()]
    lines += ["", f"| clips with a false cut | of | {head} |", rule]
    lines += [_line(incident, _sum([rows[incident] for rows in by_set.values()])) for incident in INCIDENTS]
    lines += [_line(f"**all, {group}**", _sum(list(rows.values()))) for group, rows in by_set.items()]
    lines += ["", "ms of CPU a frame: " + ", ".join(f"{name} {ms}" for name, ms in record["ms_per_frame"].items())]
    return "\n".join(lines)


@click.command()
@click.argument("shared", type=click.Path(exists=True, path_type=Path), required=False)
@click.option("--json", "out", type=click.Path(path_type=Path))
@click.option("--table", "made", type=click.Path(exists=True, path_type=Path), help="Only print this record's tables.")
def main(shared: Path | None, out: Path | None, made: Path | None) -> None:
    if made is not None:
        record = json.loads(made.read_text())
    elif shared is not None:
        record = provenance() | measure(read_sets(shared))
    else:
        raise click.UsageError("give the folder of shared data, or --table RECORD")
    if out is not None:
        write_record(out, record)
    click.echo(table(record))


if __name__ == "__main__":
    main()
