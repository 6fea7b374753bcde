import { describe, expect, it } from "vitest";
import { duration, isEven } from "../src/times";

describe("times of frames", () => {
  it("tell for how long each is shown", () => {
    const times = { times: [0, 0.5, 0.75], fps: 4 };
    expect([0, 1, 2].map((frame) => duration(times, frame))).toEqual([0.5, 0.25, 0.25]);
  });

  it("are even at one rate, but for what containers round", () => {
    expect(isEven({ times: [0, 0.033, 0.067, 0.1], fps: 30 })).toBe(true);
    expect(isEven({ times: [0, 0.03, 0.067, 0.1], fps: 30 })).toBe(false);
  });
});
