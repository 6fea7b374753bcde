import { describe, expect, it } from "vitest";
import { Document, corrected } from "../src/document";
import { Following } from "../src/following";
import type { Model } from "../src/model/client";
import type { Tracked } from "../src/model/protocol";
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

/** A model of three frames that answers when it is told to, and what was asked of it. */
function patient() {
  const asked: { answer: () => void; queries: Float32Array }[] = [];
  const track = (queries: Float32Array, _?: unknown, onPart?: (part: Tracked) => void): Promise<Tracked> =>
    new Promise((resolve) => {
      const count = queries.length / 3;
      const all = { tracks: new Float32Array(6 * count).fill(queries[1] ?? 0), occlusion: new Float32Array(3 * count) };
      const answer = (): void => {
        onPart?.(all);
        resolve(all);
      };
      asked.push({ queries, answer });
    });
  return { model: { facts: { numFrames: 3, width: 90, height: 70, occlusionThreshold: 0.5 }, track } as unknown as Model, asked };
}

function followingOf(model: Model) {
  const document = new Document();
  const said: string[] = [];
  const following = new Following(document, { onAnswers: () => undefined, onAdded: () => undefined, onProgress: (text) => said.push(text) });
  following.use(model, new Answers());
  return { document, following, said };
}

const settled = (): Promise<void> => new Promise((done) => setTimeout(done, 5));
const places = (document: Document) => document.points.map(({ x }) => x);

describe("a model that takes its time", () => {
  it("does not give back a point that was taken back, and what was there before stays", async () => {
    const { model, asked } = patient();
    const { document, following, said } = followingOf(model);
    document.add([{ t: 0, x: 1, y: 2 }]);
    document.change((content) => corrected(content, { point: 1, t: 2, place: null }));
    const asking = following.add([{ t: 0, x: 5, y: 6 }]);
    document.undo();
    expect([places(document), document.corrections.length]).toEqual([[1], 1]);
    asked[0]?.answer();
    expect(await asking).toBeUndefined();
    expect([places(document), document.corrections.length, said.at(-1)]).toEqual([[1], 1, ""]);
  });

  it("is waited for before anything is saved", async () => {
    const { model, asked } = patient();
    const { document, following } = followingOf(model);
    const adding = following.add([{ t: 0, x: 5, y: 6 }]);
    expect(following.isAsking).toBe(true);
    const saved = following.settled().then(() => places(document));
    asked[0]?.answer();
    await adding;
    expect([await saved, following.isAsking]).toEqual([[5], false]);
  });

  it("loses no point when a refitted one is taken meanwhile", async () => {
    const [old, refitted] = [patient(), patient()];
    const { document, following } = followingOf(old.model);
    const adding = following.add([{ t: 0, x: 5, y: 6 }]);
    following.use(refitted.model, new Answers());
    old.asked[0]?.answer();
    await settled();
    refitted.asked[0]?.answer();
    expect(await adding).toMatchObject({ found: "Point 1 at (5, 6) of frame 0: in sight in 3 of 3 frames" });
    expect([places(document), following.followed().length]).toEqual([[5], 1]);
  });

  it("gives the layers of a file with the first of its points, and not once these were taken back", async () => {
    const { model, asked } = patient();
    const { document, following } = followingOf(model);
    for (const count of [1, 0]) {
      const asking = following.add([{ t: 0, x: 5, y: 6 }], () => [document.newDrawing("paint", "seen")]);
      if (count === 0) document.undo();
      asked.at(-1)?.answer();
      await asking;
      expect([document.points.length, document.drawings.length]).toEqual([count, count]);
      document.undo();
      expect([document.points.length, document.drawings.length, document.canUndo]).toEqual([0, 0, false]);
    }
  });

  it("moves a point to where it was moved last, whichever is answered first", async () => {
    const { model, asked } = patient();
    const { document, following } = followingOf(model);
    const [point] = document.add([{ t: 0, x: 5, y: 6 }]);
    if (point === undefined) throw new Error("the point is there");
    const moves = [following.correct(point, { x: 7, y: 8 }, 0), following.correct(point, { x: 9, y: 8 }, 0)];
    for (const each of [...asked].reverse()) {
      each.answer();
      await settled();
    }
    expect([await Promise.all(moves), places(document)]).toEqual([[false, true], [9]]);
    const third = following.correct(point, { x: 3, y: 3 }, 0);
    document.undo();
    asked.at(-1)?.answer();
    expect([await third, places(document), document.canRedo]).toEqual([false, [9], false]);
  });
});
