/**
 * What the frames in which a mask was drawn teach of its looks, which decide where none of them has a pixel in sight: how
 * much of the pixel an object has. Held to the same table as `Looks.by_owner` of `decomo_runtime/propagation/evidence.py`,
 * and weighed as `regions.py` there; colours, of which that asks too, are left out.
 */

import type { Size } from "./geometry";
import type { Cel, Grid, Shares } from "./warp";

const BINS = 16;
/** Nodes that every bin has to begin with. */
const FEW = 2;
/** Weight of what the looks say. */
const OWNER = 0.7;
/** Chance that the drawn frames, or the looks, may give. */
const SUREST = 0.95;
const KERNEL = [0.25, 0.5, 0.25] as const;

/** What the looks say of the nodes of a frame: logarithms of odds, above 0 for the mask. */
export interface Looks extends Grid {
  readonly odds: Float32Array;
}

/** A frame with a part of the mask, as it was drawn. */
export interface Taught {
  readonly cel: Cel;
  readonly shares: Shares;
}

/** The chance to be the mask's by bins of `moving`, the share of a ray that an object has: of samples, `inside` of each is the mask's. */
export function ownerChances(samples: Iterable<{ readonly moving: number; readonly inside: number }>): Float64Array {
  const [mask, rest] = [new Float64Array(BINS), new Float64Array(BINS)];
  for (const { moving, inside } of samples) {
    const bin = binOf(moving);
    mask[bin] = (mask[bin] ?? 0) + inside;
    rest[bin] = (rest[bin] ?? 0) + 1 - inside;
  }
  const [mine, others] = [smoothed(mask), smoothed(rest)];
  return mine.map((count, bin) => (count + FEW) / (count + (others[bin] ?? 0) + 2 * FEW));
}

/** The looks of a frame, whose shares these are. */
export function looksOf(taught: readonly Taught[], { columns, rows, moving }: Shares, image: Size): Looks {
  const chances = ownerChances(taught.flatMap((each) => samples(each, image)));
  return { columns, rows, odds: moving.map((share) => OWNER * logOdds(chances[binOf(share)] ?? 0.5)) };
}

/** The chance of a pixel to be the mask's: by `vote`, what the drawn frames say, and the logarithm of the odds of the looks. */
export const chance = (vote: number, odds: number): number => 1 / (1 + Math.exp(-logOdds(vote) - odds));

const binOf = (moving: number): number => Math.min(BINS - 1, Math.max(0, Math.floor(moving * BINS)));

const smoothed = (counts: Float64Array): Float64Array =>
  counts.map((_, bin) => KERNEL.reduce((sum, weight, shift) => sum + weight * (counts[Math.min(BINS - 1, Math.max(0, bin + shift - 1))] ?? 0), 0));

function logOdds(chance: number): number {
  const held = Math.min(SUREST, Math.max(1 - SUREST, chance));
  return Math.log(held / (1 - held));
}

/** At each node how much an object has, and whether it is in the mask. */
function samples({ cel: { pixels, scale }, shares: { columns, rows, moving } }: Taught, image: Size): { moving: number; inside: number }[] {
  return Array.from(moving, (share, node) => {
    const x = Math.floor((((node % columns) + 0.5) * image.width * scale) / columns);
    const y = Math.floor(((Math.floor(node / columns) + 0.5) * image.height * scale) / rows);
    return { moving: share, inside: (pixels.data[4 * (y * pixels.width + x) + 3] ?? 0) / 255 };
  });
}
