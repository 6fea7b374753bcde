/** How sure the model is: errors as colours, and the moments at which it is least sure of the points. */

import type { Followed } from "./tracks";

/** ColorBrewer's RdYlBu, told apart by the colour-blind too: blue is sure. */
const COLOURS = [[44, 123, 182], [171, 217, 233], [255, 255, 191], [253, 174, 97], [215, 25, 28]] as const;
/** The ends of the scale, in units; between them it is even in logarithms, and beyond them level. */
const LEAST = 0.5;
const MOST = 16;
/** Errors that the legend names, in units. */
const TICKS = [0.5, 1, 2, 4, 8, 16];
/** Jumps lead to so many moments at most. */
const MOST_MOMENTS = 24;
/** Of two moments of one point that lie nearer, in frames, or in this share of the clip, the surer one is left out. */
const APART = 3;
const APART_SHARE = 1 / 16;

/** Red, green and blue, 0 to 255, of an error; both in pixels of the clip, `unit` being the length of a unit. */
export function errorRgb(error: number, unit: number): readonly [number, number, number] {
  const at = Math.min(1, share(error / unit)) * (COLOURS.length - 1);
  const first = Math.min(COLOURS.length - 2, Math.floor(at));
  const [low, high] = [COLOURS[first] ?? COLOURS[0], COLOURS[first + 1] ?? COLOURS[0]];
  const mixed = (channel: 0 | 1 | 2): number => Math.round(low[channel] + (at - first) * (high[channel] - low[channel]));
  return [mixed(0), mixed(1), mixed(2)];
}

export const errorColour = (error: number, unit: number): string => `rgb(${errorRgb(error, unit).join(" ")})`;

/** What a legend shows: colours from its left to its right end, and pixels at shares of the way. */
export function legend(unit: number): { colours: string[]; ticks: { share: number; pixels: string }[] } {
  return {
    colours: COLOURS.map((rgb) => `rgb(${rgb.join(" ")})`),
    ticks: TICKS.map((units) => ({ share: share(units), pixels: inPixels(units * unit) })),
  };
}

/** Two digits, as many as an expected error is worth. */
export const inPixels = (error: number): string => (error >= 10 ? error.toFixed(0) : String(Number(error.toPrecision(2))));

const share = (units: number): number => Math.max(0, Math.log(units / LEAST) / Math.log(MOST / LEAST));

/** A point that is in sight in a frame, though the model is less sure of it than before and after. */
export interface Moment {
  readonly frame: number;
  readonly id: number;
  /** Pixels of the clip. */
  readonly error: number;
}

/** The moments at which the model is least sure of where `points` are in sight, by frames and, in each, as in the list. */
export function leastSure(points: readonly Followed[]): Moment[] {
  const peaks = points.flatMap(peaksOf).sort((a, b) => b.error - a.error);
  const order = new Map(points.map(({ id }, index) => [id, index]));
  return peaks.slice(0, MOST_MOMENTS).sort((a, b) => a.frame - b.frame || (order.get(a.id) ?? 0) - (order.get(b.id) ?? 0));
}

function peaksOf({ id, track: { error, occluded } }: Followed): Moment[] {
  const apart = Math.max(APART, Math.round(APART_SHARE * error.length));
  const at = (frame: number): number => (occluded[frame] === false ? (error[frame] ?? 0) : 0);
  const highest = [...error.keys()].filter((frame) => at(frame) > 0 && at(frame) >= at(frame - 1) && at(frame) >= at(frame + 1));
  const peaks: Moment[] = [];
  for (const frame of highest.sort((a, b) => at(b) - at(a))) {
    if (peaks.every((peak) => Math.abs(peak.frame - frame) >= apart)) peaks.push({ frame, id, error: at(frame) });
  }
  return peaks;
}

/** The moment after or before another, round and round: `selected` tells moments of one frame apart. */
export function neighbour(moments: readonly Moment[], frame: number, selected: number | undefined, step: 1 | -1): Moment | undefined {
  const here = moments.findIndex((each) => each.frame === frame && each.id === selected);
  if (here !== -1) return moments.at((here + step) % moments.length);
  const next = moments.find((each) => each.frame > frame) ?? moments[0];
  const former = moments.findLast((each) => each.frame < frame) ?? moments.at(-1);
  return step > 0 ? next : former;
}
