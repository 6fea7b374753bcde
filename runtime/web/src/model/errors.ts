/** How far an answer may be from the truth: the rule of `decomo_runtime/expected_error.py`, which states and explains it. */

import type { Size } from "../geometry";
import type { ModelFacts } from "./facts";
import table from "../../../decomo_runtime/expected_error.json";

/** The numbers of the rule; names are those of the file. */
export interface Calibration {
  readonly scores: readonly number[];
  /** The curve's values there, in units. */
  readonly errors: readonly number[];
  readonly gap_power: number;
  readonly quality_power: number;
  readonly typical_median: number;
}

/** Scores below it tell nothing more. */
const LOWEST_SCORE = 1e-3;
/** At most, for the quality of a fit, either way. */
const FARTHEST_FACTOR = 4;
/** Units on the longer side of a frame. */
const LONGER_SIDE = 256;

/** Of an answer so many frames from its query, in units; `median` is that of the fit's held-out links, where it is known. */
export function errorInUnits(score: number, gap: number, median: number | undefined, calibration: Calibration = table): number {
  if (gap === 0) return 0;
  return curve(Math.max(score, LOWEST_SCORE), calibration) * gap ** calibration.gap_power * qualityFactor(median, calibration);
}

/** [M], pixels of the clip, of one point's answers in the frames 0 to M - 1, from their scores; 0 in frame t, the query's. */
export function expectedErrors(occlusion: Float32Array, t: number, facts: Pick<ModelFacts, "height" | "width" | "quality">): Float32Array {
  const median = facts.quality?.all.median;
  return occlusion.map((score, frame) => errorInUnits(score, Math.abs(frame - t), median) * unit(facts));
}

/** Length of a unit in pixels of the clip. */
export const unit = ({ width, height }: Size): number => Math.max(width, height) / LONGER_SIDE;

/** Between its values the curve is straight in logarithms of both; beyond them it goes on level. */
function curve(score: number, { scores, errors }: Calibration): number {
  const next = scores.findIndex((each) => each > score);
  const [before, after] = next === -1 ? [scores.length - 1, scores.length - 1] : [Math.max(0, next - 1), next];
  const [low = 1, high = 1] = [scores[before], scores[after]];
  const share = low === high ? 0 : Math.max(0, Math.log(score / low) / Math.log(high / low));
  return Math.exp((1 - share) * Math.log(errors[before] ?? 1) + share * Math.log(errors[after] ?? 1));
}

function qualityFactor(median: number | undefined, { typical_median, quality_power }: Calibration): number {
  if (median === undefined) return 1;
  const factor = (Math.max(median, 1e-9) / typical_median) ** quality_power;
  return Math.min(FARTHEST_FACTOR, Math.max(1 / FARTHEST_FACTOR, factor));
}
