import { describe, expect, it } from "vitest";
import { errorRgb, inPixels, leastSure, legend, neighbour } from "../src/sureness";
import type { Followed } from "../src/tracks";

const followed = (id: number, error: readonly number[], hidden: readonly number[] = []): Followed =>
  ({ id, track: { error: Float32Array.from(error), occluded: error.map((_, frame) => hidden.includes(frame)) } }) as unknown as Followed;
const short = (points: readonly Followed[]) => leastSure(points).map(({ frame, id, error }) => [frame, id, error]);

describe("colours of errors", () => {
  it("run from blue to red in logarithms of units, whatever the size of the clip", () => {
    for (const unit of [1, 7.5]) {
      expect(errorRgb(0, unit)).toEqual([44, 123, 182]);
      expect(errorRgb(0.5 * unit, unit)).toEqual([44, 123, 182]);
      expect(errorRgb(Math.sqrt(0.5 * 16) * unit, unit)).toEqual([255, 255, 191]);
      expect(errorRgb(999 * unit, unit)).toEqual([215, 25, 28]);
    }
    expect(errorRgb(0.5 * 32 ** 0.125, 1)).toEqual([108, 170, 208]); // in the middle of the first two
  });

  it("have a legend in pixels of the clip", () => {
    const { colours, ticks } = legend(7.5);
    expect([colours[0], colours.at(-1)]).toEqual(["rgb(44 123 182)", "rgb(215 25 28)"]);
    expect(ticks.map(({ pixels }) => pixels)).toEqual(["3.8", "7.5", "15", "30", "60", "120"]);
    ticks.forEach(({ share }, index) => expect(share).toBeCloseTo(index / 5, 6));
    expect([0, 0.123, 9.96, 12.6].map(inPixels)).toEqual(["0", "0.12", "10", "13"]);
  });
});

describe("moments", () => {
  it("are where a point in sight is less surely placed than before and after, none given or hidden", () => {
    expect(short([followed(7, [0, 1, 4, 2, 1, 3, 9, 9, 1, 5], [6, 7])])).toEqual([[2, 7, 4], [5, 7, 3], [9, 7, 5]]);
    expect(short([followed(7, [1, 2, 3, 4, 5, 6, 7, 8])])).toEqual([[7, 7, 8]]); // a slope is none
    expect(short([followed(7, [0, 0, 0]), followed(8, [2, 1, 1], [0, 1, 2])])).toEqual([]);
  });

  it("lie apart, of each point by a sixteenth of the clip", () => {
    const error = Array.from({ length: 160 }, (_, frame) => (frame % 4 === 0 ? 5 + frame / 160 : 1));
    const frames = leastSure([followed(1, error)]).map(({ frame }) => frame);
    expect(frames).toEqual([...frames].sort((a, b) => a - b));
    expect(frames.slice(1).every((frame, index) => frame - (frames[index] ?? 0) >= 10)).toBe(true);
    expect(frames).toContain(156);
  });

  it("are the worst of all points, by frames and in the order of the list", () => {
    const many = Array.from({ length: 40 }, (_, index) => followed(index, [0, 1 + index, 0, 0, 0, 100 + index, 0]));
    expect(short(many)).toEqual(Array.from({ length: 24 }, (_, index) => [5, 16 + index, 116 + index]));
    expect(short([followed(9, [0, 2, 1]), followed(3, [0, 2, 1])]).map(([, id]) => id)).toEqual([9, 3]);
  });

  it("follow each other round and round, those of one frame too", () => {
    const moments = [[2, 1], [5, 1], [5, 4], [8, 2]].map(([frame = 0, id = 0]) => ({ frame, id, error: 1 }));
    const to = (frame: number, selected: number | undefined, step: 1 | -1) => moments.indexOf(neighbour(moments, frame, selected, step)!);
    expect([to(0, 1, 1), to(2, 1, 1), to(5, 1, 1), to(5, 4, 1), to(8, 2, 1), to(9, 2, 1)]).toEqual([0, 1, 2, 3, 0, 0]);
    expect([to(9, 1, -1), to(8, 2, -1), to(5, 4, -1), to(5, 1, -1), to(2, 1, -1), to(1, 1, -1)]).toEqual([3, 2, 1, 0, 3, 3]);
    expect([to(5, 9, 1), to(5, 9, -1)]).toEqual([3, 0]);
    expect(neighbour([], 3, 1, 1)).toBeUndefined();
  });
});
