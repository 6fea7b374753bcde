/**
 * How points go on from window to window of a clip.
 *
 * The rules are those of `decomo_runtime/windows.py`, which states and explains them; both are held to the same cases.
 */

import type { Tracked } from "./protocol";
import { type Window, frames, home, shared } from "./windows";

/** Asks the model of window `number` for `queries` [N, 3] in `frames` [M], both counted from the window's first frame. */
export type Ask = (number: number, queries: Float32Array, frames: readonly number[]) => Promise<Tracked>;

const FORWARD = 1;
const BACKWARD = -1;
type Step = typeof FORWARD | typeof BACKWARD;
/** By how much more occluded a point may be in the middle of the shared frames than at their ends, and yet cross there. */
const OFF_CENTRE = 0.02;

/** A point where it enters a window, or is asked for: frame `t` of the clip. */
interface Traveller {
  readonly row: number;
  readonly t: number;
  readonly x: number;
  readonly y: number;
}

/**
 * Follows `queries` [N, 3], rows of (t, x, y), through every frame of the clip. `onPart` hears what is answered so far,
 * the rest hidden at NaN, whenever points have gone through another window: their own first.
 */
export async function follow(
  windows: readonly Window[],
  queries: Float32Array,
  ask: Ask,
  onPart: (part: Tracked) => void = () => {},
): Promise<Tracked> {
  const journey = new Journey(windows, queries.length / 3, ask, onPart);
  const travellers = frames(0, queries.length / 3).map((row) => {
    const [t = 0, x = 0, y = 0] = queries.subarray(3 * row, 3 * row + 3);
    return { row, t, x, y };
  });
  const homes = travellers.map(({ t }) => home(windows, t));
  for (const number of windows.keys()) {
    const atHome = travellers.filter(({ row }) => homes[row] === number);
    if (atHome.length > 0) await journey.visit(number, atHome, [FORWARD, BACKWARD]);
  }
  for (const number of windows.keys()) await journey.goOn(number, FORWARD);
  for (const number of [...windows.keys()].reverse()) await journey.goOn(number, BACKWARD);
  return journey.answer;
}

/** Points on their way: where they have been, and where they enter the next window. */
class Journey {
  readonly answer: Tracked;
  private readonly entering = new Map<string, Traveller[]>();
  private readonly numFrames: number;

  constructor(
    private readonly windows: readonly Window[],
    points: number,
    private readonly ask: Ask,
    private readonly onPart: (part: Tracked) => void,
  ) {
    this.numFrames = windows.at(-1)?.end ?? 0;
    const occlusion = new Float32Array(points * this.numFrames).fill(1);
    this.answer = { tracks: new Float32Array(points * this.numFrames * 2).fill(Number.NaN), occlusion };
  }

  /** Follows all points that enter a window from the one before it in the direction `step`. */
  async goOn(number: number, step: Step): Promise<void> {
    const travellers = this.entering.get(`${number}:${step}`) ?? [];
    this.entering.delete(`${number}:${step}`);
    if (travellers.length > 0) await this.visit(number, travellers, [step]);
  }

  /** Follows points through a window, in the directions `steps`. */
  async visit(number: number, travellers: readonly Traveller[], steps: readonly Step[]): Promise<void> {
    const { begin, end } = this.windows[number] ?? { begin: 0, end: 0 };
    const [step = FORWARD] = steps;
    const isAhead = (frame: number, t: number): boolean => steps.length > 1 || step * (frame - t) > 0; // what lies behind is answered
    const leaving = steps.map((each) => ({ step: each, places: this.places(number, each) }));
    const rearmost = travellers.reduce((least, { t }) => (step * (t - least) < 0 ? t : least), travellers[0]?.t ?? begin);
    const asked = frames(begin, end).filter(
      (frame) => isAhead(frame, rearmost) || leaving.some(({ places }) => places.includes(frame)),
    );
    const queries = Float32Array.from(travellers.flatMap(({ t, x, y }) => [t - begin, x, y]));
    const { tracks, occlusion } = await this.ask(number, queries, asked.map((frame) => frame - begin));
    travellers.forEach((traveller, index) => {
      const { row, t } = traveller;
      const at = (frame: number): number => index * asked.length + asked.indexOf(frame);
      asked.forEach((frame, column) => {
        const source = index * asked.length + column;
        if (isAhead(frame, t)) this.put(row, frame, tracks.subarray(2 * source, 2 * source + 2), occlusion[source] ?? 1);
      });
      for (const { step: onward, places } of leaving) {
        if (places.length === 0) continue;
        if (this.shared(number, onward).length > 0) {
          const frame = surest(places, (place) => (onward * (place - t) < 0 ? Infinity : (occlusion[at(place)] ?? 1)));
          const [x = 0, y = 0] = tracks.subarray(2 * at(frame), 2 * at(frame) + 2);
          this.enter(number + onward, onward, { row, t: frame, x, y });
        } else {
          const last = places[0] ?? begin;
          const place = tracks.subarray(2 * at(last), 2 * at(last) + 2);
          const beyond = onward > 0 ? frames(last + 1, this.numFrames) : frames(0, last);
          for (const frame of beyond) this.put(row, frame, place, 1);
        }
      }
    });
    this.onPart(this.answer);
  }

  private put(row: number, frame: number, place: Float32Array, occlusion: number): void {
    const at = row * this.numFrames + frame;
    this.answer.tracks.set(place, 2 * at);
    this.answer.occlusion[at] = occlusion;
  }

  private enter(number: number, step: Step, traveller: Traveller): void {
    const key = `${number}:${step}`;
    const others = this.entering.get(key) ?? [];
    this.entering.set(key, others);
    others.push(traveller);
  }

  /** The frames in which a point may leave for the next window; at a cut the last one; none where there is no window. */
  private places(number: number, step: Step): number[] {
    const window = this.windows[number];
    if (window === undefined || this.windows[number + step] === undefined) return [];
    const both = this.shared(number, step);
    return both.length > 0 ? both : [step > 0 ? window.end - 1 : window.begin];
  }

  private shared(number: number, step: Step): number[] {
    return shared(this.windows, step > 0 ? number : number - 1);
  }
}

/** In which of the shared frames, in order, a point is surest to be seen; of nearly equal ones, nearest to their middle. */
function surest(places: readonly number[], hidden: (place: number) => number): number {
  const middle = (places.length - 1) / 2;
  const scores = places.map((place, index) => hidden(place) + (OFF_CENTRE * Math.abs(index - middle)) / places.length);
  return places[scores.indexOf(Math.min(...scores))] ?? 0;
}
