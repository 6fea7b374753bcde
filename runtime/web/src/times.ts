/** When frames are shown, and for how long: clips may have a variable rate. */

import type { ModelFacts } from "./model/facts";

export type Times = Pick<ModelFacts, "times" | "fps">;

/** Containers round times. */
const MILLISECOND = 1e-3;

/** Seconds for which a frame is shown; the last one for as long as one of the mean rate. */
export function duration({ times, fps }: Times, frame: number): number {
  const [time, next] = [times[frame], times[frame + 1]];
  return time === undefined || next === undefined ? 1 / fps : next - time;
}

/** Whether one frame follows the other at the mean rate. */
export const isEven = ({ times, fps }: Times): boolean => times.every((time, frame) => Math.abs(time - frame / fps) <= MILLISECOND);
