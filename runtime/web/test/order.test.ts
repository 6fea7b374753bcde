import { readFileSync } from "node:fs";
import { describe, expect, test } from "vitest";
import { InputError } from "../src/model/facts";
import { frameOrder } from "../src/order";

/** What `decomotion` reads of the same folders. */
const TABLE = JSON.parse(readFileSync(new URL("../../../tests/recorded/frame_order.json", import.meta.url), "utf8")) as {
  files: string[];
  order?: string[];
  refused?: boolean;
}[];

describe("frames in the order in which the model's were read", () => {
  test.each(TABLE.filter(({ order }) => order))("$files", ({ files, order }) => {
    for (const given of [files, [...files].reverse()]) expect(frameOrder(given)).toEqual(order);
  });

  test.each(TABLE.filter(({ refused }) => refused))("refused: $files", ({ files }) => {
    expect(() => frameOrder(files)).toThrow(InputError);
  });

  test("the table has both", () => {
    expect(TABLE.filter(({ order }) => order).length).toBeGreaterThan(20);
    expect(TABLE.filter(({ refused }) => refused).length).toBeGreaterThan(5);
  });
});

test("two files of one name, as of two folders", () => {
  expect(() => frameOrder(["0.png", "1.png", "0.png"])).toThrow("Two files are called 0.png; give the frames of one folder.");
});
