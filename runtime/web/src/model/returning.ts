/** Finds points again that are hidden where two windows meet: as `decomo_runtime/returning.py`, which says how. */

import type { Place } from "../geometry";
import type { ModelFacts } from "./facts";
import type { Tracked } from "./protocol";
import { type Window, frames, shared } from "./windows";

/** The models of a clip's windows; `queries` [N, 3] and `frames` [M] count from the first frame of window `number`. */
export interface Models {
  readonly windows: readonly Window[];
  readonly facts: Pick<ModelFacts, "height" | "width" | "occlusionThreshold">;
  track(number: number, queries: Float32Array, frames: readonly number[]): Promise<Tracked>;
  /** Whether a moving object owns each query. */
  onObject(number: number, queries: Float32Array): Promise<readonly boolean[]>;
}

/** In which direction of time a point goes. */
export type Step = 1 | -1;

/** Between points of the grid, in pixels of a frame whose longer side is 256; so are the next two. */
const SPACING = 4;
/** How far from a point its neighbour may be hidden. */
const REACH = 6;
/** How far from its own place a point that was found may be traced back to. */
const MISS = 2;
/** A grid is picked in one of so many frames. */
const STRIDE = 4;

/** A point of the grid: where it is asked for, where it is hidden in the shared frame, and whether it is an object's. */
interface Hidden {
  readonly t: number;
  readonly x: number;
  readonly y: number;
  readonly there: Place;
  readonly onObject: boolean;
}

/** What window `number` has hidden in the middle of the frames that it shares with the one behind it. */
export class Returning {
  /** The shared frame, of the clip. */
  readonly frame: number;
  private readonly begin: number;
  private readonly unit: number;
  private hidden: Promise<readonly Hidden[]> | undefined;

  constructor(
    private readonly models: Models,
    private readonly number: number,
    step: Step,
  ) {
    const both = shared(models.windows, step > 0 ? number - 1 : number);
    this.frame = both[Math.floor(both.length / 2)] ?? 0;
    this.begin = models.windows[number]?.begin ?? 0;
    this.unit = Math.max(models.facts.height, models.facts.width) / 256;
  }

  /** Where points that are hidden at `places` of the shared frame come back, (t, x, y) of the clip; undefined: they do not. */
  async find(places: readonly (Place & { readonly onObject: boolean })[]): Promise<({ t: number; x: number; y: number } | undefined)[]> {
    this.hidden ??= this.search().catch((error: unknown) => {
      this.hidden = undefined; // to be tried again
      throw error;
    });
    const hidden = await this.hidden;
    const { width, height, occlusionThreshold } = this.models.facts;
    const guesses = places.map((place) => {
      const near = this.nearest(place, hidden);
      if (near === undefined) return undefined;
      const [x, y] = [near.x + place.x - near.there.x, near.y + place.y - near.there.y];
      return { t: near.t, x: clipped(x, width), y: clipped(y, height) };
    });
    const asked = guesses.filter((guess) => guess !== undefined);
    if (asked.length === 0) return guesses;
    const queries = Float32Array.from(asked.flatMap(({ t, x, y }) => [t, x, y]));
    const back = await this.models.track(this.number, queries, [this.frame - this.begin]);
    let row = 0;
    return guesses.map((guess, index) => {
      const place = places[index];
      if (guess === undefined || place === undefined) return undefined;
      const at = row++;
      const miss = Math.hypot((back.tracks[2 * at] ?? NaN) - place.x, (back.tracks[2 * at + 1] ?? NaN) - place.y);
      const right = miss <= MISS * this.unit && (back.occlusion[at] ?? 0) > occlusionThreshold;
      return right ? { ...guess, t: guess.t + this.begin } : undefined;
    });
  }

  private nearest(place: Place & { readonly onObject: boolean }, hidden: readonly Hidden[]): Hidden | undefined {
    let [least, found]: [number, Hidden | undefined] = [Infinity, undefined];
    for (const each of hidden) {
      const distance = Math.hypot(each.there.x - place.x, each.there.y - place.y);
      if (each.onObject === place.onObject && distance < least) [least, found] = [distance, each];
    }
    return least <= REACH * this.unit ? found : undefined;
  }

  private async search(): Promise<readonly Hidden[]> {
    const { width, height, occlusionThreshold } = this.models.facts;
    const here = this.frame - this.begin;
    const length = (this.models.windows[this.number]?.end ?? 0) - this.begin;
    const spacing = Math.max(1, SPACING * this.unit);
    const picked = frames(0, length).filter((frame) => frame !== here && frame % STRIDE === here % STRIDE);
    const [rows, columns] = [centred(height, spacing), centred(width, spacing)];
    const queries = Float32Array.from(picked.flatMap((t) => rows.flatMap((y) => columns.flatMap((x) => [t, x, y]))));
    const { tracks, occlusion } = await this.models.track(this.number, queries, [here]);
    const kept = frames(0, occlusion.length).filter((row) => {
      const [x = NaN, y = NaN] = tracks.subarray(2 * row, 2 * row + 2);
      const inside = x >= -0.5 && x <= width - 0.5 && y >= -0.5 && y <= height - 0.5;
      return inside && (occlusion[row] ?? 0) > occlusionThreshold;
    });
    const own = Float32Array.from(kept.flatMap((row) => [...queries.subarray(3 * row, 3 * row + 3)]));
    const owners = await this.models.onObject(this.number, own);
    return kept.map((row, index) => {
      const [t = 0, x = 0, y = 0] = queries.subarray(3 * row, 3 * row + 3);
      return { t, x, y, there: { x: tracks[2 * row] ?? 0, y: tracks[2 * row + 1] ?? 0 }, onObject: owners[index] ?? false };
    });
  }
}

/** Those of all windows, each made when it is first wanted. */
export class Returnings {
  private readonly made = new Map<string, Returning>();

  constructor(private readonly models: Models) {}

  /** For points that enter window `number` in the direction `step`. */
  of(number: number, step: Step): Returning {
    const key = `${number}:${step}`;
    const returning = this.made.get(key) ?? new Returning(this.models, number, step);
    this.made.set(key, returning);
    return returning;
  }
}

const clipped = (value: number, size: number): number => Math.min(Math.max(value, -0.5), size - 0.5);

/** Every `spacing` pixels, equally far from opposite borders. */
function centred(size: number, spacing: number): number[] {
  const count = Math.floor((size - 1) / spacing) + 1;
  return Array.from({ length: count }, (_, index) => (size - 1 - (count - 1) * spacing) / 2 + spacing * index);
}
