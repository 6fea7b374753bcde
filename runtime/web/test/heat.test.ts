import { describe, expect, it } from "vitest";
import { type Glance, HeatMaps, gridSize, nearBy } from "../src/heat";
import { errorInUnits } from "../src/model/errors";
import type { ModelFacts } from "../src/model/facts";

const FACTS = { numFrames: 40, width: 512, height: 128 } as ModelFacts;
const CELLS = [12 * 3, 24 * 6, 48 * 12];

/** Heat maps of a model whose occlusion is `score`; answers come at `step`. */
function maps(score: (x: number, frame: number) => number, reachable: (frame: number) => boolean = () => true) {
  const waiting: (() => void)[] = [];
  const asked: number[] = [];
  const heard: number[] = [];
  const glance = (queries: Float32Array, wanted: readonly number[]): Promise<Glance> => {
    const frames = wanted.filter(reachable);
    const count = queries.length / 3;
    asked.push(queries[0] ?? -1);
    const occlusion = Float32Array.from({ length: count * frames.length }, (_, at) =>
      score(queries[3 * Math.floor(at / frames.length) + 1] ?? 0, frames[at % frames.length] ?? 0),
    );
    return new Promise((done) => waiting.push(() => done({ frames, occlusion, tracks: new Float32Array(2 * occlusion.length) })));
  };
  const made = new HeatMaps(FACTS, glance, (frame) => heard.push(frame), (error) => expect.fail(String(error)));
  const step = async (): Promise<void> => {
    for (const answer of waiting.splice(0)) answer();
    await new Promise((done) => setTimeout(done));
  };
  const all = async (): Promise<void> => {
    for (let quiet = 0; quiet < 2; quiet = waiting.length === 0 ? quiet + 1 : 0) await step();
  };
  return { made, step, all, asked, heard };
}

describe("maps of where the model is unsure", () => {
  it("get finer, of the frame that is shown alone", async () => {
    const { made, all, asked, heard } = maps(() => 0.1);
    expect(made.get(20)).toBeUndefined();
    await all();
    expect(heard).toEqual([20, 20, 20]);
    expect(new Set(asked)).toEqual(new Set([20]));
    expect(made.get(20)).toMatchObject({ ...gridSize(FACTS, 2), level: 2 });
    expect(CELLS.map((_, level) => gridSize(FACTS, level)).map(({ width, height }) => width * height)).toEqual(CELLS);
  });

  it("hold the median over the frames near by, in pixels of the clip, left and right where they are", async () => {
    const { made, all } = maps((x, frame) => (x < 256 ? 0 : frame > 20 ? 0.5 : 0.3));
    made.get(20);
    await all();
    const { width, errors } = made.get(20)!;
    expect(nearBy(20, 40)).toEqual([18, 22, 16, 24, 12, 28, 4, 36]);
    const [sure, unsure] = [[0, 0, 0, 0, 0, 0, 0, 0], [0.3, 0.5, 0.3, 0.5, 0.3, 0.5, 0.3, 0.5]].map((scores) => {
      const told = scores.map((score, index) => 2 * errorInUnits(score, [2, 2, 4, 4, 8, 8, 16, 16][index] ?? 0, undefined)).sort((a, b) => a - b);
      return ((told[3] ?? 0) + (told[4] ?? 0)) / 2;
    });
    expect(errors[0]).toBeCloseTo(sure!, 4);
    expect(errors[width - 1]).toBeCloseTo(unsure!, 4);
  });

  it("ask for frames of the clip alone, and are blank where the model reaches none of them", async () => {
    expect(nearBy(3, 10)).toEqual([1, 5, 7]);
    const { made, all } = maps(() => 1, () => false);
    made.get(0);
    await all();
    expect(Math.max(...made.get(0)!.errors)).toBe(0);
  });

  it("are given up as soon as another frame is shown, or none is wanted, and kept where they are whole", async () => {
    const { made, step, all, asked } = maps(() => 0.1);
    made.get(20);
    await step();
    made.get(21);
    await step();
    await step();
    expect(asked.slice(-1)).toEqual([21]);
    await all();
    const count = asked.length;
    made.cancel();
    made.get(21);
    await all();
    expect(asked).toHaveLength(count);
    made.get(22);
    made.cancel();
    await all();
    expect(asked).toHaveLength(count + 1);
    expect(made.get(21)?.level).toBe(2);
  });
});
