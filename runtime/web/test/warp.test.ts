import { beforeAll, describe, expect, it } from "vitest";
import { looksOf } from "../src/looks";
import { SAME, type CarryMap, type Cel, boundsOf, carryMap, shares, warp } from "../src/warp";

/** What a browser has, and Node has not. */
beforeAll(() => {
  class Pixels {
    readonly data: Uint8ClampedArray;
    constructor(
      readonly width: number,
      readonly height: number,
    ) {
      this.data = new Uint8ClampedArray(4 * width * height);
    }
  }
  Object.assign(globalThis, { ImageData: Pixels });
});

const IMAGE = { width: 60, height: 40 };
const RED = [200, 10, 20, 255];

/** Red in a box of the image. */
function cel(left: number, top: number, right: number, bottom: number, scale = 1): Cel {
  const pixels = new ImageData(IMAGE.width * scale, IMAGE.height * scale);
  for (let y = top * scale; y < bottom * scale; y++) {
    for (let x = left * scale; x < right * scale; x++) pixels.data.set(RED, 4 * (y * pixels.width + x));
  }
  return { pixels, scale, bounds: boundsOf(pixels) };
}

/** All nodes move as `motion` says of their place, and have the score that it says. */
function map(columns: number, rows: number, motion: (x: number, y: number) => readonly [number, number, number]): CarryMap {
  const nodes = Array.from({ length: columns * rows }, (_, node) => {
    const [x, y] = [(((node % columns) + 0.5) * IMAGE.width) / columns - 0.5, ((Math.floor(node / columns) + 0.5) * IMAGE.height) / rows - 0.5];
    return { x, y, motion: motion(x, y) };
  });
  const queries = Float32Array.from(nodes.flatMap(({ x, y }) => [0, x, y]));
  const tracks = Float32Array.from(nodes.flatMap(({ x, y, motion: [dx, dy] }) => [x + dx, y + dy]));
  return carryMap({ columns, rows }, queries, tracks, Float32Array.from(nodes, ({ motion: [, , score] }) => score), 0.5);
}

/** RGBA of a pixel of the image. */
function at(warped: ReturnType<typeof warp>, x: number, y: number, scale = 1): number[] {
  if (warped === undefined) return [0, 0, 0, 0];
  const [column, row] = [x * scale - warped.left, y * scale - warped.top];
  if (column < 0 || row < 0 || column >= warped.pixels.width || row >= warped.pixels.height) return [0, 0, 0, 0];
  const first = 4 * (row * warped.pixels.width + column);
  return [...warped.pixels.data.subarray(first, first + 4)];
}

describe("moving what is drawn", () => {
  it("leaves it in its own frame", () => {
    const warped = warp([{ cel: cel(10, 5, 20, 15), map: SAME }], IMAGE);
    for (let y = 0; y < IMAGE.height; y++) {
      for (let x = 0; x < IMAGE.width; x++) expect(at(warped, x, y)[3]).toBe(x >= 10 && x < 20 && y >= 5 && y < 15 ? 255 : 0);
    }
  });

  it.each([1, 3])("takes each pixel from where it was, %d pixels for each of the clip's", (scale) => {
    const drawn = cel(10, 5, 20, 15, scale);
    for (const grid of [[6, 4], [30, 20], [60, 40]] as const) {
      const warped = warp([{ cel: drawn, map: map(grid[0], grid[1], () => [-7, 3, 0]) }], IMAGE);
      expect(at(warped, 17, 2, scale)).toEqual(RED);
      expect(at(warped, 26, 11, scale)).toEqual(RED);
      for (const [x, y] of [[15, 6], [28, 6], [20, 13]] as const) expect(at(warped, x, y, scale)[3]).toBe(0);
    }
  });

  it("finds what is smaller than a cell", () => {
    const warped = warp([{ cel: cel(31, 21, 32, 22), map: map(3, 2, () => [0, 0, 0]) }], IMAGE);
    expect(at(warped, 31, 21)).toEqual(RED);
  });

  it("hides where the pixel was hidden", () => {
    const warped = warp([{ cel: cel(0, 0, 60, 40), map: map(60, 40, (x) => [0, 0, x < 30 ? 0 : 1]) }], IMAGE);
    expect([at(warped, 20, 20)[3], at(warped, 40, 20)[3]]).toEqual([255, 0]);
  });

  it("does not smear across the outline of what moves", () => {
    const warped = warp([{ cel: cel(6, 0, 9, 40), map: map(12, 8, (x) => [x < 30 ? 0 : -30, 0, 0]) }], IMAGE);
    for (const [x, alpha] of [[7, 255], [15, 0], [29, 0], [31, 0], [37, 255], [43, 0]] as const) expect(at(warped, x, 20)[3]).toBe(alpha);
  });

  it("takes the first source that has the pixel in sight, also where nothing is drawn in it", () => {
    const near = { cel: cel(0, 0, 10, 40), map: map(60, 40, (x) => [0, 0, x < 30 ? 0 : 1]) };
    const far = { cel: cel(0, 0, 60, 40), map: SAME };
    const warped = warp([near, far], IMAGE);
    expect([at(warped, 5, 20)[3], at(warped, 20, 20)[3], at(warped, 40, 20)[3]]).toEqual([255, 0, 255]);
  });

  it("cuts what is of the objects, or of the scene", () => {
    const still = Float32Array.from({ length: 60 * 40 }, (_, node) => (node % 60 < 20 ? 0 : node % 60 < 40 ? 0.5 : 1));
    const owned = (moving: boolean): number[] => {
      const warped = warp([{ cel: cel(0, 0, 60, 40), map: SAME }], IMAGE, { shares: shares({ columns: 60, rows: 40 }, still), moving });
      return [10, 30, 50].map((x) => at(warped, x, 20)[3] ?? 0);
    };
    expect(owned(true)).toEqual([255, 128, 0]);
    expect(owned(false)).toEqual([0, 128, 255]);
  });

  it("goes by a mask's looks where no source has it in sight", () => {
    const grid = { columns: 30, rows: 20 };
    /** What moves, 15 pixels wide. */
    const from = (left: number): Float32Array => Float32Array.from({ length: 600 }, (_, node) => Number((node % 30) * 2 < left || (node % 30) * 2 >= left + 15));
    const source = { cel: cel(15, 0, 30, 40), map: map(30, 20, (x) => [x >= 39 && x < 54 ? -24 : 0, 0, x < 45 ? 0 : 1]) };
    const looks = looksOf([{ cel: source.cel, shares: shares(grid, from(15)) }], shares(grid, from(39)), IMAGE);
    const alphas = (warped: ReturnType<typeof warp>): number[] => [42, 50, 58].map((x) => at(warped, x, 20)[3] ?? 0);
    expect(alphas(warp([source], IMAGE))).toEqual([255, 0, 0]);
    const [seen, hidden, beside] = alphas(warp([source], IMAGE, undefined, looks));
    expect([seen, beside]).toEqual([255, 0]);
    expect(hidden).toBeGreaterThan(220);
  });

  it("stays within the frame", () => {
    const warped = warp([{ cel: cel(0, 0, 60, 40), map: SAME }], IMAGE);
    expect([warped?.pixels.width, warped?.pixels.height]).toEqual([60, 40]);
    const odd = { width: 59, height: 37 };
    expect(warp([{ cel: cel(0, 0, 60, 40), map: SAME }], odd)?.pixels.width).toBe(59);
  });

  it("has nothing to show where nothing is drawn, or all is elsewhere", () => {
    expect(warp([{ cel: cel(0, 0, 0, 0), map: SAME }], IMAGE)).toBeUndefined();
    expect(warp([{ cel: cel(0, 0, 5, 5), map: map(6, 4, () => [500, 0, 0]) }], IMAGE)).toBeUndefined();
  });
});
