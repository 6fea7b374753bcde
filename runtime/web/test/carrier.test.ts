import { describe, expect, it } from "vitest";
import { Carrier } from "../src/carrier";
import type { ModelFacts } from "../src/model/facts";

const FACTS = { numFrames: 12, width: 64, height: 40 } as ModelFacts;

describe("where drawings are carried", () => {
  it("is not waited for once the model has failed", async () => {
    const errors: unknown[] = [];
    const failed = new Error("no more");
    const model = { carry: () => Promise.reject(failed), render: () => Promise.reject(failed) };
    const carrier = new Carrier(FACTS, model, () => expect.fail("nothing is known"), (error) => errors.push(error));
    expect(carrier.isSettled(3, 0)).toBe(false);
    expect(carrier.isSettled(0, 0)).toBe(true); // the frame that was drawn on
    carrier.want(3, { anchors: [0], owners: false, taught: [] });
    await new Promise((done) => setTimeout(done));
    expect(errors).toEqual([failed]);
    expect(carrier.isSettled(3, 0)).toBe(true);
    expect(carrier.map(3, 0)).toBeUndefined();
  });
});
