import { describe, expect, it } from "vitest";
import { Carrier } from "../src/carrier";
import type { ModelFacts } from "../src/model/facts";
import type { Appearance } from "../src/model/protocol";

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

  it("knows whose the pixels of masked frames are, whatever frame is shown", async () => {
    const answered: number[] = [];
    const model = {
      carry: (queries: Float32Array) => Promise.resolve({ tracks: new Float32Array((2 * queries.length) / 3), occlusion: new Float32Array(queries.length / 3) }),
      render: (queries: Float32Array) => Promise.resolve({ static_confidence: new Float32Array(queries.length / 3).fill(0.25) } as Appearance),
    };
    const carrier = new Carrier(FACTS, model, (frame) => answered.push(frame), (error) => expect.fail(String(error)));
    const wanted = { anchors: [1], owners: true, taught: [1] };
    carrier.want(9, wanted);
    await carrier.wait(9, wanted);
    for (const frame of [1, 9]) expect(carrier.shares(frame)?.moving[0]).toBe(0.75);
    expect(answered).toContain(9);
    carrier.close();
  });
});
