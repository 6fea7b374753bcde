/**
 * How points go on from window to window of a clip.
 *
 * The rules are those of `decomo_runtime/journey.py`, which states and explains them; both are held to the same cases.
 */

import type { Tracked } from "./protocol";
import type { Models, Returnings, Step } from "./returning";
import { frames, home, shared } from "./windows";

const FORWARD = 1;
const BACKWARD = -1;
/** By how much more occluded a point may be in the middle of the shared frames than at their ends, and yet cross there. */
const OFF_CENTRE = 0.02;

/** A point as it is in one window: what the window's model is asked for it, (t, x, y) of the clip. */
interface Traveller {
  readonly row: number;
  readonly t: number;
  readonly x: number;
  readonly y: number;
  /** The frame beyond which it is this window's. */
  readonly since: number;
}

/**
 * Follows `queries` [N, 3], rows of (t, x, y), through every frame of the clip. `onPart` hears what is answered so far,
 * the rest hidden at NaN, whenever another window has answered, the points' own first, and at the end all.
 */
export async function follow(
  models: Models,
  returnings: Returnings,
  queries: Float32Array,
  onPart: (part: Tracked) => void = () => {},
): Promise<Tracked> {
  const { windows } = models;
  const travellers = frames(0, queries.length / 3).map((row) => {
    const [t = 0, x = 0, y = 0] = queries.subarray(3 * row, 3 * row + 3);
    return { row, t, x, y, since: t };
  });
  const journey = new Journey(models, returnings, travellers, onPart);
  for (const number of windows.keys()) {
    const atHome = travellers.filter(({ row }) => journey.homes[row] === number);
    if (atHome.length > 0) await journey.visit(number, atHome, [FORWARD, BACKWARD]);
  }
  for (const number of windows.keys()) await journey.goOn(number, FORWARD);
  for (const number of [...windows.keys()].reverse()) await journey.goOn(number, BACKWARD);
  onPart(journey.answer);
  return journey.answer;
}

/** Points on their way: where they have been, and where they enter the next window. */
class Journey {
  readonly answer: Tracked;
  /** The window of each point's own frame. */
  readonly homes: readonly number[];
  private readonly entering = new Map<string, Traveller[]>();
  private readonly numFrames: number;

  constructor(
    private readonly models: Models,
    private readonly returnings: Returnings,
    private readonly asked: readonly Traveller[],
    private readonly onPart: (part: Tracked) => void,
  ) {
    this.homes = asked.map(({ t }) => home(models.windows, t));
    this.numFrames = models.windows.at(-1)?.end ?? 0;
    const occlusion = new Float32Array(asked.length * this.numFrames).fill(1);
    this.answer = { tracks: new Float32Array(asked.length * this.numFrames * 2).fill(Number.NaN), occlusion };
  }

  /** Follows all points that enter a window from the one before it in the direction `step`. */
  async goOn(number: number, step: Step): Promise<void> {
    const travellers = this.entering.get(`${number}:${step}`) ?? [];
    this.entering.delete(`${number}:${step}`);
    if (travellers.length > 0) await this.visit(number, travellers, [step]);
  }

  /** Follows points through a window, in the directions `steps`. */
  async visit(number: number, travellers: readonly Traveller[], steps: readonly Step[]): Promise<void> {
    const { begin, end } = this.window(number);
    const [step = FORWARD] = steps;
    const isAhead = (frame: number, since: number): boolean => steps.length > 1 || step * (frame - since) > 0; // what lies behind is answered
    const leaving = steps.map((each) => ({ step: each, places: this.places(number, each) }));
    const rearmost = travellers.reduce((least, { since }) => (step * (since - least) < 0 ? since : least), travellers[0]?.since ?? begin);
    const asked = frames(begin, end).filter(
      (frame) => isAhead(frame, rearmost) || leaving.some(({ places }) => places.includes(frame)),
    );
    const answer = await this.models.track(number, counted(travellers, begin), asked.map((frame) => frame - begin));
    const seen = travellers.map((traveller, index) => new Seen(traveller, asked, answer, index * asked.length));
    for (const each of seen) {
      for (const frame of asked) if (isAhead(frame, each.traveller.since)) this.put(each.traveller.row, frame, each.at(frame), each.hidden(frame));
    }
    if (leaving.some(({ places }) => places.length > 0)) this.onPart(this.answer);
    for (const { step: onward, places } of leaving) if (places.length > 0) await this.leave(number, onward, seen, places);
  }

  /** Sends points on to the next window, from where they are in the frames `places`. */
  private async leave(number: number, step: Step, seen: readonly Seen[], places: readonly number[]): Promise<void> {
    if (this.shared(number, step).length === 0) {
      for (const each of seen) this.stay(each, places[0] ?? 0, step);
      return;
    }
    const lost: Seen[] = [];
    for (const each of seen) {
      const { row, since } = each.traveller;
      const frame = surest(places, (place) => (step * (place - since) < 0 ? Infinity : each.hidden(place)));
      const [x = 0, y = 0] = each.at(frame);
      if (each.hidden(frame) <= this.models.facts.occlusionThreshold) this.enter(number + step, step, { row, t: frame, x, y, since: frame });
      else lost.push(each);
    }
    if (lost.length === 0) return;
    const returning = this.returnings.of(number + step, step);
    const owners = await this.owners(lost);
    const found = await returning.find(
      lost.map((each, index) => {
        const [x = 0, y = 0] = each.at(returning.frame);
        return { x, y, onObject: owners[index] ?? false };
      }),
    );
    lost.forEach((each, index) => {
      const query = found[index];
      if (query === undefined) this.stay(each, returning.frame, step);
      else this.enter(number + step, step, { row: each.traveller.row, ...query, since: returning.frame });
    });
  }

  /** Whether a moving object owns each point where it was asked for. */
  private async owners(lost: readonly Seen[]): Promise<boolean[]> {
    const owned = new Set<number>();
    for (const number of new Set(lost.map(({ traveller }) => this.homes[traveller.row] ?? 0))) {
      const points = this.asked.filter(({ row }) => this.homes[row] === number && lost.some(({ traveller }) => traveller.row === row));
      const owners = await this.models.onObject(number, counted(points, this.window(number).begin));
      points.forEach(({ row }, index) => owners[index] && owned.add(row));
    }
    return lost.map(({ traveller }) => owned.has(traveller.row));
  }

  /** Beyond `frame` a point is hidden where it was in it. */
  private stay(each: Seen, frame: number, step: Step): void {
    const beyond = step > 0 ? frames(frame + 1, this.numFrames) : frames(0, frame);
    for (const other of beyond) this.put(each.traveller.row, other, each.at(frame), 1);
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
    if (this.models.windows[number + step] === undefined) return [];
    const { begin, end } = this.window(number);
    const both = this.shared(number, step);
    return both.length > 0 ? both : [step > 0 ? end - 1 : begin];
  }

  private shared(number: number, step: Step): number[] {
    return shared(this.models.windows, step > 0 ? number : number - 1);
  }

  private window(number: number): { readonly begin: number; readonly end: number } {
    return this.models.windows[number] ?? { begin: 0, end: 0 };
  }
}

/** Where a window's model sees a point in the frames it was `asked` for; its part of the answer begins at `first`. */
class Seen {
  constructor(
    readonly traveller: Traveller,
    private readonly asked: readonly number[],
    private readonly answer: Tracked,
    private readonly first: number,
  ) {}

  at(frame: number): Float32Array {
    const at = this.first + this.asked.indexOf(frame);
    return this.answer.tracks.subarray(2 * at, 2 * at + 2);
  }

  hidden(frame: number): number {
    return this.answer.occlusion[this.first + this.asked.indexOf(frame)] ?? 1;
  }
}

/** Queries [N, 3] whose frames count from `begin`. */
const counted = (points: readonly Traveller[], begin: number): Float32Array =>
  Float32Array.from(points.flatMap(({ t, x, y }) => [t - begin, x, y]));

/** In which of the shared frames, in order, a point is surest to be seen; of nearly equal ones, nearest to their middle. */
function surest(places: readonly number[], hidden: (place: number) => number): number {
  const middle = (places.length - 1) / 2;
  const scores = places.map((place, index) => hidden(place) + (OFF_CENTRE * Math.abs(index - middle)) / places.length);
  return places[scores.indexOf(Math.min(...scores))] ?? 0;
}
