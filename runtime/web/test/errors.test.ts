import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { type Calibration, errorInUnits, expectedErrors } from "../src/model/errors";

/** `tests/runtime/test_expected_error.py` holds Python to the same. */
const TABLE: { rule: Calibration; cases: { score: number; gap: number; median: number | null; error: number }[] } = JSON.parse(
  readFileSync(new URL("../../../tests/recorded/expected_error.json", import.meta.url), "utf8"),
);

describe("the expected error", () => {
  it.each(TABLE.cases)("is Python's: score $score, gap $gap, median $median", ({ score, gap, median, error }) => {
    expect(errorInUnits(score, gap, median ?? undefined, TABLE.rule)).toBeCloseTo(error, 5);
  });

  it("is told in pixels of the clip by the file that Python reads", () => {
    const table = JSON.parse(readFileSync(new URL("../../decomo_runtime/expected_error.json", import.meta.url), "utf8"));
    const [first, at] = [table.errors[0], table.scores.indexOf(0.5)];
    const told = expectedErrors(new Float32Array([0, 0.9, 0.0001, 0.5]), 1, { width: 384, height: 1024 });
    [4 * first, 0, 4 * first, 4 * table.errors[at] * 2 ** table.gap_power].forEach((error, frame) => expect(told[frame]).toBeCloseTo(error, 4));
  });
});
