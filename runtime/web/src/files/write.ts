/** What the user did as files: points and tracks as `decomo-track` has them, corrections, and the project with it all. */

import { zipSync } from "fflate";
import Papa from "papaparse";
import type { Content, Point } from "../document";
import type { Drawing } from "../drawings";
import type { ModelFacts } from "../model/facts";
import type { Followed } from "../tracks";
import { drawingsRecord } from "./drawings";
import { writeNpy } from "./npy";

export const JSON_FORMAT = "decomotion.points";
export const JSON_VERSION = 1;

/** A line for each point, header `t,x,y,name,colour`: `decomo-track --queries` takes it. */
export function pointsCsv(points: readonly Point[]): string {
  const fields = ["t", "x", "y", "name", "colour"];
  return `${Papa.unparse({ fields, data: points.map(({ t, x, y, name, colour }) => [t, x, y, name, colour]) }, { newline: "\n" })}\n`;
}

/** A line for each point and frame, as `decomo-track --out tracks.csv`. */
export function tracksCsv(points: readonly Followed[], { times }: ModelFacts): string {
  const decimals = (value: number | undefined): string => (value ?? 0).toFixed(4);
  const lines = points.flatMap(({ t, x, y, track }, row) =>
    track.occluded.map((hidden, frame) => {
      const answer = [track.xy[2 * frame], track.xy[2 * frame + 1], track.occlusion[frame]].map(decimals);
      return [row, frame, ...answer, hidden ? 1 : 0, t, ...[x, y].map(decimals), (times[frame] ?? 0).toFixed(6), decimals(track.error[frame])].join(",");
    }),
  );
  return `${["point,frame,x,y,occlusion,occluded,query_t,query_x,query_y,time,error", ...lines].join("\n")}\n`;
}

/** The arrays of `decomo-track --out tracks.npz`. */
export function tracksNpz(points: readonly Followed[], { numFrames, width, height, times }: ModelFacts): Uint8Array {
  const count = points.length;
  const flat = (values: (point: Followed) => Iterable<number>): number[] => points.flatMap((point) => [...values(point)]);
  const arrays = {
    queries: writeNpy("<f4", [count, 3], flat(({ t, x, y }) => [t, x, y])),
    tracks: writeNpy("<f4", [count, numFrames, 2], flat(({ track }) => track.xy)),
    occluded: writeNpy("|b1", [count, numFrames], flat(({ track }) => track.occluded.map(Number))),
    occlusion: writeNpy("<f4", [count, numFrames], flat(({ track }) => track.occlusion)),
    error: writeNpy("<f4", [count, numFrames], flat(({ track }) => track.error)),
    frames: writeNpy("<i8", [numFrames], Array.from({ length: numFrames }, (_, frame) => frame)),
    times: writeNpy("<f8", [numFrames], [...times]),
    height: writeNpy("<i8", [], [height]),
    width: writeNpy("<i8", [], [width]),
  };
  return zipSync(Object.fromEntries(Object.entries(arrays).map(([key, bytes]) => [`${key}.npy`, bytes])));
}

export const CORRECTION_FIELDS = ["t", "x", "y", "target_t", "target_x", "target_y"] as const;

/** A line for each correction, as `decomo-train --corrections` takes it: the last two are empty where it is hidden. */
export function correctionsCsv({ points, corrections }: Pick<Content, "points" | "corrections">): string {
  const queries = new Map(points.map((point) => [point.id, point]));
  const lines = corrections.flatMap(({ point, t, place }) => {
    const query = queries.get(point);
    return query === undefined ? [] : [[query.t, query.x, query.y, t, place?.x ?? "", place?.y ?? ""].join(",")];
  });
  return `${[CORRECTION_FIELDS.join(","), ...lines].join("\n")}\n`;
}

/** The project: the points, what is given of them, their tracks, which `decomo-convert` reads, and what is drawn. */
export function projectJson(points: readonly Followed[], facts: ModelFacts, drawings: readonly Drawing[] = []): string {
  const { clipName, numFrames, width, height, fps } = facts;
  const content = {
    format: JSON_FORMAT,
    version: JSON_VERSION,
    clip: { name: clipName, num_frames: numFrames, width, height, fps },
    points: points.map(({ name, colour, t, x, y, track, given }) => ({
      ...{ name, colour, t, x, y },
      tracks: Array.from({ length: numFrames }, (_, frame) => [rounded(track.xy[2 * frame]), rounded(track.xy[2 * frame + 1])]),
      occlusion: Array.from(track.occlusion, rounded),
      occluded: track.occluded,
      error: Array.from(track.error, rounded),
      ...(given.length > 0 ? { corrections: given.map(({ t, place }) => (place ? { t, ...place } : { t, hidden: true })) } : {}),
    })),
    ...(drawings.length > 0 ? { drawings: drawingsRecord(drawings) } : {}),
  };
  return `${JSON.stringify(content)}\n`;
}

const rounded = (value: number | undefined): number => Math.round((value ?? 0) * 10000) / 10000;
