"""Flow baselines, scored as the fits are: how far the supervision gets before any model sees it. One record a clip.

    python benchmarks/baselines.py ../shared/data/tapvid_davis32_dev.pkl \
        --object-masks ../shared/data/davis32_dev_mask.npz --out benchmarks/results/baselines
    python benchmarks/baselines.py ../shared/data/tapvid_davis32_dev.pkl --methods linked \
        --set 'data.flow.intervals=[1,2,4]' --out benchmarks/results/gaps-up-to-4
    python benchmarks/baselines.py ../shared/data/tapvid_davis32_dev.pkl --methods prepared \
        --set 'data.flow.intervals=[1,2,4,8]' --out benchmarks/results/prepared

`eval/decomo_eval/baselines.py` has the methods and their occlusion rules. Rows are named `<row>-<flow>`, by `ROWS`.
`prepared` asks the very links that a fit learns from, with their matches and own flow (`harness/prepared.py`).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import click

from decomo_eval.baselines import Fields, track
from decomo_eval.dataset import Video
from decomo_eval.predictions import Prediction
from decomo_eval.tapvid import Queries
from decomotion import config as configuration
from decomotion.console import run
from decomotion.data.config import DataConfig
from decomotion.data.flow import build_flow
from decomotion.data.flow.config import ESTIMATORS
from decomotion.device import choose_device
from harness.clips import read_clips
from harness.prepared import follow_links, prepared_links
from harness.records import config_digest, is_done, provenance, score_clip, write_record

ROWS = {"chained": "chain", "direct": "direct", "linked": "multi"}
"""How the records name the methods of `decomo_eval.baselines`."""
PREPARED = "prepared"
"""The links of a fit."""


@click.command(context_settings={"show_default": True})
@click.argument("dataset")
@click.option("--object-masks", type=click.Path(exists=True, path_type=Path), help="Splits scores: .npz by clip name.")
@click.option("--methods", default=",".join(ROWS), help="Separated by commas.")
@click.option("--flows", default="dis", help=f"Of {', '.join(ESTIMATORS)}, separated by commas.")
@click.option("--raft-weights", help="File of weights for RAFT.  [default: torchvision's, by download]")
@click.option("--preset", default="cpu", help="Its `data` section sets up flow and links.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Of the preset.")
@click.option("--clips", help="Names, separated by commas.  [default: all]")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the records.")
def main(
    dataset: str,
    object_masks: Path | None,
    methods: str,
    flows: str,
    raft_weights: str | None,
    preset: str,
    overrides: tuple[str, ...],
    clips: str | None,
    out: Path,
) -> None:
    """Track the queries of DATASET, a TAP-Vid pickle or the word `procedural`, by flow alone or by a fit's links."""
    for kind, given, known in (("method", methods, (*ROWS, PREPARED)), ("flow", flows, ESTIMATORS)):
        for name in given.split(","):
            if name not in known:
                raise click.UsageError(f"there is no {kind} {name}; choose of {', '.join(known)}")
    data: dict[str, DataConfig] = {}
    for flow in flows.split(","):
        weights = (f"data.flow.weights={raft_weights}",) if raft_weights and flow.startswith("raft") else ()
        data[flow] = configuration.load(preset, overrides=(*overrides, *weights), flow=flow).data
    for name, clip in read_clips(dataset, clips.split(",") if clips else None, object_masks).items():
        for flow, config in data.items():
            facts = {"preset": preset, "overrides": list(overrides), "config": config_digest(config)}
            paths = {method: out / f"{method}-{flow}" / f"{name}.json" for method in methods.split(",")}
            left = {method: path for method, path in paths.items() if not is_done(path, facts)}
            if not left:
                continue
            fields = Fields(clip.video.frames(), build_flow(config.flow, choose_device("auto")))
            for method, path in left.items():
                about = {"row": path.parent.name, "clip": name, **facts, "dataset": Path(dataset).name, **provenance()}
                begin = time.monotonic()
                scores = score_clip(clip, tracker(method, clip.video, fields, config))
                seconds = round(time.monotonic() - begin, 1)  # fields that an earlier method used are there already
                write_record(path, {**about, "stages": {"track": {"seconds": seconds}}, **scores})
                strided = scores["metrics"]["strided"]
                click.echo(
                    f"{path.parent.name} {name}: AJ {strided['average_jaccard']:.3f}, "
                    f"delta {strided['average_pts_within_thresh']:.3f}"
                )


def tracker(method: str, video: Video, fields: Fields, config: DataConfig) -> Callable[[Queries], Prediction]:
    """One of `ROWS` by `fields`, or `PREPARED`, for whose links preparation makes fields of its own."""
    if method != PREPARED:
        return lambda queries: track(ROWS[method], queries, fields, config)
    pool = prepared_links(video, config)
    return lambda queries: follow_links(queries, pool, video.width, video.height)


if __name__ == "__main__":
    sys.exit(run(main))
