import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { removeSpecks } from "../src/specks";

const CASES: { what: string; given: string[]; kept: string[] }[] = JSON.parse(
  readFileSync(new URL("../../../tests/recorded/specks.json", import.meta.url), "utf8"),
);

const INKS: Readonly<Record<string, number>> = { "#": 255, "+": 90, ".": 0 };

/** Rows of letters as a picture: `#` is the mask, `+` its soft rim. */
function pictured(rows: readonly string[]): ImageData {
  const [width, height] = [rows[0]?.length ?? 0, rows.length];
  const data = new Uint8ClampedArray(4 * width * height);
  [...rows.join("")].forEach((letter, pixel) => (data[4 * pixel + 3] = INKS[letter] ?? 0));
  return { data, width, height } as ImageData;
}

const alphas = ({ data }: ImageData): number[] => [...data].filter((_, at) => at % 4 === 3);

describe("specks", () => {
  it.each(CASES)("$what", ({ given, kept }) => {
    const picture = pictured(given);
    removeSpecks(picture);
    expect(alphas(picture)).toEqual(alphas(pictured(kept)));
  });

  it("go with their rims, which join nothing", () => {
    const large = "#".repeat(250);
    const picture = pictured([`${large}+++++`, `${large}+++#+`, `${large}+++++`]);
    removeSpecks(picture);
    expect(alphas(picture)).toEqual(alphas(pictured([1, 2, 3].map(() => `${large}+....`))));
  });
});
