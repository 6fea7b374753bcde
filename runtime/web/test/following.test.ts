import { expect, it } from "vitest";
import { Document } from "../src/document";
import { Following } from "../src/following";
import type { Model } from "../src/model/client";
import { Answers, type Track } from "../src/tracks";

it("marks no point in a frame to which it is not followed yet", () => {
  const document = new Document();
  const following = new Following(document, { onAnswers: () => undefined, onAdded: () => undefined, onProgress: () => undefined });
  const answers = new Answers();
  const track: Track = { xy: Float32Array.of(1, 2, 3, 4, Number.NaN, Number.NaN), occlusion: Float32Array.of(0, 0, 1), occluded: [false, false, true], error: Float32Array.of(0, 1, 2) };
  answers.set([{ t: 0, x: 1, y: 2 }], [track]);
  following.use({ facts: { width: 9, height: 7 } } as Model, answers);
  document.add([{ t: 0, x: 1, y: 2 }]);
  const [point] = following.followed();
  if (point === undefined) throw new Error("the point is answered");
  expect(() => following.mark(point, 2, false)).toThrow("Point 1 is still being followed to frame 2; mark it in a moment.");
  following.mark(point, 1, false);
  expect(document.corrections).toEqual([{ point: 1, t: 1, place: { x: 3, y: 4 } }]);
});
