import { describe, expect, it } from "vitest";
import { InputError } from "../src/model/facts";
import { follow } from "../src/model/journey";
import type { Tracked } from "../src/model/protocol";
import { Returning, Returnings } from "../src/model/returning";
import { type Window, frames, home, readWindows } from "../src/model/windows";

/** Windows with these first frames, and frames after the last. */
const windowsOf = (...bounds: [number, number][]): Window[] =>
  bounds.map(([begin, end], number) => ({ name: `window-00${number}`, begin, end }));

/** `decomotion.windows.split(50, [], 20)`, and of 23 frames by 8. */
const LONG = windowsOf([0, 20], [15, 35], [30, 50]);
const SHORT = windowsOf([0, 7], [5, 12], [10, 18], [16, 23]);

type Hidden = (origin: number, frame: number) => number;

/**
 * Models of windows in which points move by (2, 1) a frame and are as hidden as `hidden(x of frame 0, frame)`; `error`
 * is added to x wherever a point is not at its query. Asked for a place where a point is hidden, they follow what covers
 * it, which stands still. `asked` is the number of each that was asked, in order; `owned` says which are an object's.
 */
function standing(windows: readonly Window[], hidden: Hidden = () => 0, error = 0, owned: (number: number) => boolean = () => false) {
  const asked: number[] = [];
  const track = async (number: number, queries: Float32Array, at: readonly number[]): Promise<Tracked> => {
    const { begin, end } = windows[number]!;
    asked.push(number);
    expect(at.every((frame) => frame >= 0 && frame < end - begin)).toBe(true);
    expect(at).toEqual([...new Set(at)].sort((a, b) => a - b));
    const [tracks, occlusion]: [number[], number[]] = [[], []];
    for (let row = 0; row < queries.length; row += 3) {
      const [t = 0, x = 0, y = 0] = queries.subarray(row, row + 3);
      expect(t >= 0 && t < end - begin).toBe(true);
      const covered = hidden(x - 2 * (t + begin), t + begin) > 0.5;
      for (const frame of at) {
        const gone = covered ? 0 : frame - t;
        tracks.push(x + 2 * gone + (gone === 0 ? 0 : error), y + gone);
        occlusion.push(gone === 0 ? 0 : hidden(x - 2 * (t + begin), frame + begin));
      }
    }
    return { tracks: Float32Array.from(tracks), occlusion: Float32Array.from(occlusion) };
  };
  const onObject = async (number: number, queries: Float32Array) => Array(queries.length / 3).fill(owned(number)) as boolean[];
  const models = { windows, facts: { height: 60, width: 90, occlusionThreshold: 0.5 }, track, onObject };
  const go = async (...queries: [number, number, number][]): Promise<{ x: number[][]; occlusion: number[][] }> => {
    const answer = await follow(models, new Returnings(models), Float32Array.from(queries.flat()));
    const length = windows.at(-1)!.end;
    const rows = queries.map((_, row) => row);
    return {
      x: rows.map((row) => frames(0, length).map((frame) => answer.tracks[2 * (row * length + frame)]!)),
      occlusion: rows.map((row) => [...answer.occlusion.subarray(row * length, (row + 1) * length)]),
    };
  };
  return { track: go, asked };
}

describe("a point in a clip of several windows", () => {
  it.each([[SHORT], [LONG], [windowsOf([0, 9])]])("goes through all of them, both ways, where it is in sight", async (windows) => {
    const length = windows.at(-1)!.end;
    const queries = frames(0, length).map((t): [number, number, number] => [t, 3.5 + t, 2.25]);
    const { x, occlusion } = await standing(windows).track(...queries);
    queries.forEach(([t, begun], row) => expect(x[row]).toEqual(frames(0, length).map((frame) => begun + 2 * (frame - t))));
    expect(occlusion.flat().every((score) => score === 0)).toBe(true);
  });

  it("depends on no other", async () => {
    const hidden: Hidden = (origin, frame) => 0.6 * Math.abs(Math.sin(origin + 3 * frame));
    const queries = [0, 49, 17, 30, 31, 8].map((t): [number, number, number] => [t, 3.5 + t, 2.25]);
    const whole = await standing(LONG, hidden, 0.5).track(...queries);
    for (const [row, query] of queries.entries()) {
      const alone = await standing(LONG, hidden, 0.5).track(query);
      expect(alone.x[0]).toEqual(whole.x[row]);
      expect(alone.occlusion[0]).toEqual(whole.occlusion[row]);
    }
  });

  it("crosses where it is surest to be seen", async () => {
    const windows = windowsOf([0, 20], [14, 34]);
    const { x, occlusion } = await standing(windows, (_, frame) => (frame === 18 ? 0.1 : 0.4), 1).track([2, 5, 5]);
    const steps = x[0]!.slice(1).map((place, frame) => place - x[0]![frame]!);
    // out of the query, and out of frame 18
    expect(frames(0, 33).filter((frame) => Math.abs(steps[frame]! - 2) > 0.5)).toEqual([1, 2, 18]);
    expect(x[0]![33]).toBe(5 + 2 * 31 + 2);
    expect(occlusion[0]![18]).toBeCloseTo(0.1);
  });

  it("crosses in the middle where it is nearly as sure", async () => {
    const windows = windowsOf([0, 20], [14, 34]);
    for (const [least, at] of [[0.399, 16], [0.39, 14]] as const) {
      const { x } = await standing(windows, (_, frame) => (frame === 14 ? least : 0.4), 1).track([2, 5, 5]);
      expect(frames(3, 33).filter((frame) => x[0]![frame + 1]! - x[0]![frame]! > 2.5)).toEqual([at]);
    }
  });

  it("crosses at its query among the shared frames, and never behind it", async () => {
    const windows = windowsOf([0, 23], [17, 40]);
    for (const t of frames(17, 23)) {
      const { x } = await standing(windows, () => 0.45, 1).track([t, 50, 5]);
      const away = frames(0, 40).map((frame) => Math.abs(x[0]![frame]! - (50 + 2 * (frame - t))));
      expect(Math.max(...away)).toBe(1);
    }
    const hidden: Hidden = (origin, frame) => (frame === (origin < 1.5 ? 15 : 14) ? 0 : 0.4);
    const { x } = await standing(windowsOf([0, 20], [5, 21], [8, 40]), hidden, 1).track([2, 5, 5]);
    expect(x[0]![39]).toBe(5 + 2 * 37 + 2); // through the second at 15, where it entered it, not at 14
  });

  /** All whose x in frame 0 is from 20 to 40 are hidden in these frames. */
  const behind = (first: number, last: number): Hidden => (origin, frame) =>
    origin >= 20 && origin <= 40 && frame >= first && frame <= last ? 0.9 : 0;
  const two = windowsOf([0, 20], [14, 44]);

  it.each([[2, 34.25, 22.5], [40, 90, 41], [40, 105, 41]] as [number, number, number][])("comes back where it was hidden in all shared frames: %d, %d, %d", async (t, begun, y) => {
    const { x, occlusion } = await standing(two, behind(10, 26)).track([t, begun, y]);
    frames(0, 44).forEach((frame) => {
      expect(x[0]![frame]).toBeCloseTo(begun + 2 * (frame - t), 3);
      expect(occlusion[0]![frame]).toBeCloseTo(behind(10, 26)(begun - 2 * t, frame), 6);
    });
  });

  it("stays hidden where it does not come back, and is not taken for what covers it", async () => {
    const { x, occlusion } = await standing(windowsOf([0, 20], [14, 44], [40, 60]), behind(10, 60)).track([2, 34.25, 22.5]);
    frames(0, 60).forEach((frame) => expect(x[0]![frame]).toBeCloseTo(34.25 + 2 * (Math.min(frame, 17) - 2), 3));
    expect(occlusion[0]!.slice(18)).toEqual(Array(42).fill(1));
  });

  it("comes back with what it belongs to alone, the scene or an object", async () => {
    const after = async (owned: (number: number) => boolean) => (await standing(two, behind(10, 26), 0, owned).track([2, 34, 22])).occlusion[0]!.slice(30);
    expect(new Set(await after(() => true))).toEqual(new Set([0]));
    expect(new Set(await after((number) => number > 0))).toEqual(new Set([1]));
  });

  it("comes back only near what is hidden there, and where it is traced back to its place, hidden", async () => {
    /** What stands still left of x = 20 is hidden; what is asked for it ends `drift` from its place, as hidden as `score`. */
    const found = async (x: number, drift: number, score: number): Promise<boolean> => {
      const track = async (_: number, queries: Float32Array): Promise<Tracked> => {
        const places = frames(0, queries.length / 3).map((row) => [queries[3 * row + 1]!, queries[3 * row + 2]!] as const);
        if (places.length > 1) return { tracks: Float32Array.from(places.flat()), occlusion: Float32Array.from(places, ([left]) => (left < 20 ? 0.9 : 0)) };
        return { tracks: Float32Array.from(places.flatMap(([left, top]) => [left + drift, top])), occlusion: Float32Array.of(score) };
      };
      const onObject = async (_: number, queries: Float32Array) => Array(queries.length / 3).fill(false) as boolean[];
      const models = { windows: two, facts: { height: 60, width: 90, occlusionThreshold: 0.5 }, track, onObject };
      const [query] = await new Returning(models, 1, 1).find([{ x, y: 30, onObject: false }]);
      return query !== undefined;
    };
    expect(await found(20.4, 0.6, 0.9)).toBe(true);
    expect(await found(23, 0, 0.9)).toBe(false); // 6 pixels of 256 are 2.1 of these
    expect(await found(20.4, 0.8, 0.9)).toBe(false); // 2 are 0.7
    expect(await found(20.4, 0, 0.5)).toBe(false);
  });

  it("is not followed across a cut: it stays, hidden", async () => {
    const { track, asked } = standing(windowsOf([0, 13], [13, 30]));
    const { x, occlusion } = await track([5, 5, 5], [20, 40, 5]);
    expect(occlusion[0]).toEqual(frames(0, 30).map((frame) => (frame < 13 ? 0 : 1)));
    expect(occlusion[1]).toEqual(frames(0, 30).map((frame) => (frame < 13 ? 1 : 0)));
    expect(new Set(x[0]!.slice(12))).toEqual(new Set([5 + 2 * 7]));
    expect(new Set(x[1]!.slice(0, 14))).toEqual(new Set([40 - 2 * 7]));
    expect(asked).toEqual([0, 1]);
  });

  it("asks only the windows on its way, its own first", async () => {
    const shots = windowsOf([0, 20], [15, 31], [31, 42], [37, 50]);
    const { track, asked } = standing(shots);
    await track([28, 9, 9]);
    expect(asked).toEqual([1, 0]);
  });

  it("is told of as its windows answer, its own first", async () => {
    const windows = windowsOf([0, 20], [15, 31], [31, 42], [37, 50]);
    const known: number[][] = [];
    const ask = async (_: number, queries: Float32Array, at: readonly number[]): Promise<Tracked> => {
      const rays = (queries.length / 3) * at.length;
      return { tracks: new Float32Array(2 * rays), occlusion: new Float32Array(rays) };
    };
    const models = { windows, facts: { height: 60, width: 90, occlusionThreshold: 0.5 }, track: ask, onObject: async () => [] };
    await follow(models, new Returnings(models), Float32Array.of(45, 1, 1), ({ tracks, occlusion }) => {
      const answered = frames(0, 50).filter((frame) => !Number.isNaN(tracks[2 * frame]));
      expect(frames(0, 50).filter((frame) => occlusion[frame] === 0).every((frame) => answered.includes(frame))).toBe(true);
      known.push([answered[0]!, answered.at(-1)!]);
    });
    expect(known).toEqual([[37, 49], [31, 49], [0, 49]]); // before the cut it is nowhere else
  });

  it("is at home where its frame is farther from either end", () => {
    const windows = windowsOf([0, 20], [14, 34], [34, 50]);
    expect([0, 16, 17, 33, 34, 49].map((frame) => home(windows, frame))).toEqual([0, 0, 1, 1, 2, 2]);
    expect([15, 16, 17].map((frame) => home(windowsOf([0, 20], [13, 34]), frame))).toEqual([0, 0, 1]); // 16 is in the middle
  });
});

const FIGURES = { links: 60, median: 0.5, p90: 1, median_pixels: 1, p90_pixels: 2, within_1: 0.5, within_2: 0.6, within_4: 0.7, own_error: 0.1 };
const quality = (median: number) => ({ steps: 900, thinned: null, all: { ...FIGURES, median, p90: 9 }, static: null, dynamic: null, gaps: [] });
const SAID = {
  ...{ format_version: 1, clip: "walk", num_frames: 30, height: 60, width: 90, fps: 15, pixel_aspect: 1, seconds: null },
  windows: windowsOf([0, 18], [12, 30]),
  ...{ digest: "0", options: {} },
};

describe("windows.json", () => {
  const read = (changes: object) => readWindows(JSON.stringify({ ...SAID, ...changes }), "walk/windows.json");

  it("says what the whole clip is", () => {
    const { windows, facts } = read({});
    expect(windows).toEqual(SAID.windows);
    const steady = frames(0, 30).map((frame) => frame / 15);
    expect(facts).toEqual({ clipName: "walk", numFrames: 30, height: 60, width: 90, fps: 15, times: steady, quality: undefined });
    const seconds = frames(0, 30).map((frame) => frame ** 2 / 20);
    expect(read({ seconds }).facts.times).toEqual(seconds);
  });

  it("tells how good the worst window is", () => {
    expect(read({ quality: [quality(0.5), quality(2)] }).facts.quality?.all.median).toBe(2);
    expect(read({ quality: [quality(2), null] }).facts.quality?.all.median).toBe(2);
    expect(read({ quality: [null, null] }).facts.quality).toBeUndefined();
  });

  const [first, second] = SAID.windows;
  const shifted = frames(1, 31);
  it.each([
    [{ format_version: 2 }, "has format version 2 but this page reads up to 1"],
    ...[{ format_version: "1" }, { clip: 3 }, { num_frames: 30.5 }, { width: null }, { fps: "15" }, { seconds: 4 }, { windows: {} }].map(
      (changes) => [changes, "does not tell where the clip's windows are, or is damaged"] as const,
    ),
    ...[{ windows: [first, { ...second, begin: "12" }] }, { windows: [null] }, { quality: 7 }, { quality: [{}, null] }, { seconds: ["0"] }].map(
      (changes) => [changes, "does not tell where the clip's windows are, or is damaged"] as const,
    ),
    ...[{ num_frames: 31 }, { height: 0 }, { pixel_aspect: -1 }, { windows: [] }, { windows: [second, first] }, { windows: [first] }].map(
      (changes) => [changes, "contradicts itself"] as const,
    ),
    ...[{ begin: 19 }, { begin: 0 }, { end: 18 }, { end: 29 }, { name: "window-000" }, { name: "../window-001" }, { name: "window-1 " }].map(
      (changes) => [{ windows: [first, { ...second, ...changes }] }, "contradicts itself"] as const,
    ),
    ...[{ quality: [null] }, { seconds: shifted }, { seconds: shifted.slice(0, 4) }, { seconds: frames(0, 30).map(() => 0) }].map(
      (changes) => [changes, "contradicts itself"] as const,
    ),
  ] as const)("is refused in a sentence where it is damaged: %j", (changes, sentence) => {
    expect(() => read(changes)).toThrow(InputError);
    expect(() => read(changes)).toThrow(`walk/windows.json ${sentence}`);
  });

  it.each(["", "null", "7", "[]", "{}", JSON.stringify(SAID).slice(0, -9)])("is refused where it is none: %s", (text) => {
    expect(() => readWindows(text, "windows.json")).toThrow("is damaged; copy the folder again");
  });
});
