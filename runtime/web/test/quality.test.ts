import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { readQuality, summary, warning, worst } from "../src/model/quality";

/** `tests/decomotion/test_quality.py` holds Python to the same. */
const TABLE: { quality: Record<string, any>; summary: string; warning: string | null }[] = JSON.parse(
  readFileSync(new URL("../../../tests/recorded/quality.json", import.meta.url), "utf8"),
);
const SAID = TABLE[0]!.quality;

describe("how good a fit is", () => {
  it.each(TABLE.map((row) => [row.warning, row] as const))("is said as Python says it: %s", (_, row) => {
    const quality = readQuality(row.quality);
    expect(summary(quality)).toBe(row.summary);
    expect(warning(quality) ?? null).toBe(row.warning);
  });

  it("is that of the worst of several", () => {
    const [better, worse] = [0.5, 0.7].map((median) => readQuality({ ...SAID, all: { ...SAID.all, median } }));
    expect(worst([undefined, better, worse, undefined, better])).toBe(worse);
    expect(worst([worse])).toBe(worse);
    expect(worst([undefined])).toBeUndefined();
  });

  const changed = (key: string, part: object): object => ({ ...SAID, [key]: { ...SAID[key], ...part } });
  it.each([
    ...[undefined, null, 7, [], {}, "text"],
    ...["steps", "thinned", "all", "static", "dynamic", "gaps"].map((key) => ({ ...SAID, [key]: undefined })),
    ...[{ links: 0 }, { median: -0.1 }, { own_error: null }, { within_2: "0.85" }, { p90: Infinity }].map((part) => changed("static", part)),
    ...[{ median: 3 }, { median_pixels: 9.7 }, { within_1: 0.86 }, { within_2: 0.94 }, { within_4: 1.01 }].map((part) => changed("all", part)),
    ...[{ shortest: 0 }, { longest: 2 }, { figures: {} }].map((part) => ({ ...SAID, gaps: [{ ...SAID.gaps[0], ...part }, SAID.gaps[1]] })),
    ...[{ steps: 0 }, { steps: 1.5 }, { thinned: 3 }, { gaps: {} }].map((part) => ({ ...SAID, ...part })),
  ])("is refused where it is damaged or impossible: %j", (content) => {
    expect(() => readQuality(content)).toThrow(RangeError);
  });
});
