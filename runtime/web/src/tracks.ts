/** Tracks: what a model answers to queries, bent through what the user gave. All of it is derived from the document. */

import type { Content, Correction, Given, Point, Query } from "./document";
import { expectedErrors } from "./model/errors";
import type { ModelFacts } from "./model/facts";
import type { Tracked } from "./model/protocol";

/** Where one point is in every frame of the clip. */
export interface Track {
  /** [T, 2], (x, y) in pixels of the clip, pixel centres at integers; NaN in frames that are not answered yet. */
  readonly xy: Float32Array;
  /** [T], score in [0, 1]. */
  readonly occlusion: Float32Array;
  /** [T], true where the score is above the model's threshold. */
  readonly occluded: readonly boolean[];
  /** [T], how far the place may be from the truth, in pixels of the clip; 0 where the user gave it. */
  readonly error: Float32Array;
}

/** A point of the document and where it goes. */
export interface Followed extends Point {
  /** As it is shown and saved: `answer`, bent through `given`. */
  readonly track: Track;
  /** The model's own. */
  readonly answer: Track;
  readonly given: readonly Correction[];
}

/** One model's answers, by their queries. */
export class Answers {
  private readonly known = new Map<string, Track>();
  private followed = new Map<number, Followed>();

  get(query: Query): Track | undefined {
    return this.known.get(keyOf(query));
  }

  set(queries: readonly Query[], tracks: readonly Track[]): void {
    tracks.forEach((track, index) => queries[index] && this.known.set(keyOf(queries[index]), track));
  }

  /** The answered points of `content`; an object is the same as before where nothing has changed for it. */
  follow({ points, corrections }: Pick<Content, "points" | "corrections">): readonly Followed[] {
    const given = new Map<number, Correction[]>();
    for (const each of corrections) given.set(each.point, [...(given.get(each.point) ?? []), each]);
    const all = points.flatMap((point) => {
      const answer = this.get(point);
      return answer === undefined ? [] : [this.kept(point, answer, given.get(point.id) ?? [])];
    });
    this.followed = new Map(all.map((each) => [each.id, each]));
    return all;
  }

  private kept(point: Point, answer: Track, given: readonly Correction[]): Followed {
    const former = this.followed.get(point.id);
    const same = former?.answer === answer && former.given.length === given.length && former.given.every((each, index) => each === given[index]);
    if (!same) return { ...point, answer, given, track: bend(answer, point, given) };
    const unchanged = former.name === point.name && former.colour === point.colour;
    return unchanged ? former : { ...former, ...point };
  }
}

const keyOf = ({ t, x, y }: Query): string => `${t} ${x} ${y}`;

/** Cuts the answer to N queries, `tracks` [N, T, 2] and `occlusion` [N, T], into one track a query. */
export function splitTracks({ tracks, occlusion }: Tracked, queries: readonly Query[], facts: ModelFacts): Track[] {
  const { numFrames, occlusionThreshold } = facts;
  return queries.map(({ t }, row) => {
    const scores = occlusion.slice(row * numFrames, (row + 1) * numFrames);
    return {
      xy: tracks.slice(row * numFrames * 2, (row + 1) * numFrames * 2),
      occlusion: scores,
      occluded: Array.from(scores, (score) => score > occlusionThreshold),
      error: expectedErrors(scores, t, facts),
    };
  });
}

/**
 * The track through all that is given: at the query, where nothing is to be moved, and in the frames of `given`.
 *
 * How far a given place lies from the answer is spread over time in straight lines from one to the next, and held before
 * the first and after the last. A given state, hidden or in sight, holds from its frame on: to the next that is given, or
 * to where the answer itself changes.
 */
export function bend(answer: Track, query: Query, given: readonly Given[]): Track {
  if (given.length === 0) return answer;
  const numFrames = answer.occluded.length;
  const xy = bentPlaces(answer, query, given);
  const error = answer.error.slice();
  for (const { t, place } of given) if (place !== null) error[t] = 0;
  const occlusion = answer.occlusion.slice();
  const occluded = [...answer.occluded];
  const states = [{ t: query.t, hidden: undefined }, ...given.map(({ t, place }) => ({ t, hidden: place === null }))].sort(byFrame);
  states.forEach(({ t, hidden }, index) => {
    if (hidden === undefined) return; // as the model answers
    const end = states[index + 1]?.t ?? numFrames;
    for (let frame = t; frame < end && answer.occluded[frame] === answer.occluded[t]; frame++) {
      if (occluded[frame] === hidden) continue;
      occluded[frame] = hidden;
      occlusion[frame] = hidden ? 1 : 0;
    }
  });
  return { xy, occlusion, occluded, error };
}

function bentPlaces({ xy, occluded }: Track, query: Query, given: readonly Given[]): Float32Array {
  const offsets = given.flatMap(({ t, place }) => {
    const [x, y] = [xy[2 * t] ?? Number.NaN, xy[2 * t + 1] ?? Number.NaN];
    return place === null || Number.isNaN(x) ? [] : [{ t, x: place.x - x, y: place.y - y }];
  });
  const knots = [{ t: query.t, x: 0, y: 0 }, ...offsets].sort(byFrame);
  const bent = xy.slice();
  let next = 0;
  for (let frame = 0; frame < occluded.length; frame++) {
    while ((knots[next]?.t ?? Infinity) <= frame) next++;
    const [before, after] = [knots[next - 1] ?? knots[next], knots[next] ?? knots[next - 1]];
    if (before === undefined || after === undefined) continue;
    const share = after.t === before.t ? 0 : (frame - before.t) / (after.t - before.t);
    bent[2 * frame] = (xy[2 * frame] ?? 0) + before.x + share * (after.x - before.x);
    bent[2 * frame + 1] = (xy[2 * frame + 1] ?? 0) + before.y + share * (after.y - before.y);
  }
  return bent;
}

const byFrame = (a: { t: number }, b: { t: number }): number => a.t - b.t;

/** Pixels by which a bent place must differ from the answer to be shown as such. */
const BENT = 0.05;

/** Whether the track is bent there, away from what the model answers. */
export function isBent({ track, answer }: Pick<Followed, "track" | "answer">, frame: number): boolean {
  if (track === answer) return false;
  const apart = [0, 1].map((axis) => (track.xy[2 * frame + axis] ?? 0) - (answer.xy[2 * frame + axis] ?? 0));
  return Math.hypot(...apart) > BENT;
}

/** How far an answer lies from each given place, in pixels. */
export function misses(answer: Track, given: readonly Given[]): number[] {
  return given.flatMap(({ t, place }) => (place === null ? [] : [distance(answer, t, place)]));
}

const distance = ({ xy }: Track, frame: number, place: { x: number; y: number }): number =>
  Math.hypot((xy[2 * frame] ?? Number.NaN) - place.x, (xy[2 * frame + 1] ?? Number.NaN) - place.y);

/** Runs of frames with one state: `begin` up to but without `end`. */
export function spans(occluded: readonly boolean[]): { begin: number; end: number; occluded: boolean }[] {
  const runs: { begin: number; end: number; occluded: boolean }[] = [];
  occluded.forEach((hidden, frame) => {
    const last = runs.at(-1);
    if (last?.occluded === hidden) last.end = frame + 1;
    else runs.push({ begin: frame, end: frame + 1, occluded: hidden });
  });
  return runs;
}
