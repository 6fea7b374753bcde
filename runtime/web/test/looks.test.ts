import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { chance, ownerChances } from "../src/looks";

const CASES: { what: string; moving: number[]; inside: number[]; asked: number[]; chances: number[] }[] = JSON.parse(
  readFileSync(new URL("../../../tests/recorded/owner_looks.json", import.meta.url), "utf8"),
);

describe("looks", () => {
  it.each(CASES)("$what", ({ moving, inside, asked, chances }) => {
    const found = ownerChances(moving.map((share, index) => ({ moving: share, inside: inside[index] ?? 0 })));
    asked.forEach((share, index) => expect(found[Math.min(15, Math.floor(16 * share))]).toBeCloseTo(chances[index] ?? -1, 4));
  });

  it("decide where nothing is known, and do not outweigh what is in sight", () => {
    const most = 0.7 * Math.log(19);
    expect(chance(0.5, 0)).toBe(0.5);
    expect(chance(0.5, most)).toBeGreaterThan(0.85);
    expect(chance(1, -most)).toBeGreaterThan(0.5);
    expect(chance(0, most)).toBeLessThan(0.5);
  });
});
