"""How good the correspondences are before any model sees them: the queries of a benchmark carried by flow alone.

    python benchmarks/supervision.py ../shared/data/tapvid_davis32_dev.pkl --clips goat,breakdance,car-shadow

Each row links the `cpu` preset's flow over other gaps (`decomotion/data/linking.py`); gaps of 1 only are chained flow.
"""

from __future__ import annotations

from statistics import fmean

import click
import numpy as np

from decomo_eval.dataset import Video, read_dataset
from decomo_eval.predictions import Prediction
from decomo_eval.scoring import score
from decomo_eval.tapvid import Queries, pixels_to_raster, sample_queries
from decomotion import config as configuration
from decomotion.data.flow import build_flow
from decomotion.data.linking import FieldLookup, link, outside

ROWS: dict[str, tuple[tuple[int, ...], float]] = {
    "gaps 1 (chained), hidden from 1.0 px": ((1,), 1.0),
    "gaps 1 2 4, 1.5 px": ((1, 2, 4), 1.5),
    "gaps 1 2 4 8, 1.5 px": ((1, 2, 4, 8), 1.5),
    "gaps 1 2 4 8 16, 1.5 px": ((1, 2, 4, 8, 16), 1.5),
    "gaps 1 2 4 8 16, 1.0 px": ((1, 2, 4, 8, 16), 1.0),
}
"""Gaps and the cycle error from which a hop ends on a hidden place."""

METRICS = ("average_jaccard", "average_pts_within_thresh", "occlusion_accuracy", "temporal_coherence")


def flow_lookup(video: Video) -> FieldLookup:
    """Flow between any two frames, computed when first asked for."""
    estimate = build_flow(configuration.load("cpu").data.flow)
    frames, kept = video.frames(), {}

    def look_up(source: int, target: int) -> np.ndarray:
        if (source, target) not in kept:
            kept[source, target] = estimate(frames[source], frames[target], (source, target)).astype(np.float16)
        return kept[source, target].astype(np.float32)

    return look_up


def carry(video: Video, queries: Queries, field: FieldLookup, gaps: tuple[int, ...], threshold: float) -> Prediction:
    """Each query's track by linked flow."""
    asked = queries.in_pixels(video.width, video.height)
    frame = asked[:, 0].astype(int)
    place = np.array([(frame[:row] == frame[row]).sum() for row in range(len(frame))])
    points = np.zeros((video.num_frames, place.max() + 1, 2), np.float32)
    points[frame, place] = asked[:, 1:]
    tracks = np.repeat(asked[:, None, 1:], video.num_frames, axis=1)
    occluded = np.zeros(tracks.shape[:2], bool)
    for step in (1, -1):
        for links in link(points, field, gaps, threshold, video.num_frames, step):
            for row, source in enumerate(links.sources):
                mine = np.nonzero(frame == source)[0]
                tracks[mine, links.target] = links.xy[row, place[mine]]
                occluded[mine, links.target] = links.occluded[row, place[mine]]
    occluded |= outside(tracks, video.height, video.width)
    return Prediction(pixels_to_raster(tracks, video.width, video.height), occluded)


@click.command(context_settings={"show_default": True})
@click.argument("dataset", type=click.Path(exists=True))
@click.option("--clips", help="Names, separated by commas.  [default: all]")
def main(dataset: str, clips: str | None) -> None:
    videos = read_dataset(dataset)
    names = clips.split(",") if clips else list(videos)
    results = {row: [] for row in ROWS}
    for name in names:
        field = flow_lookup(videos[name])
        queries = sample_queries(videos[name], "strided")
        for row, (gaps, threshold) in ROWS.items():
            metrics = score(queries, carry(videos[name], queries, field, gaps, threshold), "strided")
            results[row].append([metrics[key] for key in METRICS])
    click.echo(f"clips: {', '.join(names)}; AJ / < delta_avg / OA in percent, TC in px")
    for row, values in results.items():
        for name, one in [
            *zip(names, values, strict=True),
            ("mean", [fmean(column) for column in zip(*values, strict=True)]),
        ]:
            click.echo(f"| {row} | {name} | " + " / ".join(f"{100 * x:.1f}" for x in one[:3]) + f" / {one[3]:.2f} |")


if __name__ == "__main__":
    main()
