import { describe, expect, it } from "vitest";
import { filled } from "../src/fill";
import { fitHomography, moved } from "../src/homography";
import { sceneMap } from "../src/scene_map";
import { type CarryMap, carryMap, shares } from "../src/warp";

const IMAGE = { width: 428, height: 240 };
/** The scene zooms and pans under a camera that turns: by shares of the width. */
const CAMERA = [1.04, -0.06, 0.03, 0.05, 1.05, -0.02, 0.04, -0.03, 1] as const;

function scenePlace(x: number, y: number): [number, number] {
  const [toX, toY] = moved(CAMERA, (x - 200) / 428, (y - 110) / 428);
  return [200 + 428 * toX, 110 + 428 * toY];
}

const onObject = (x: number, y: number): boolean => Math.hypot(x - 230, y - 120) < 45;

function answers(columns: number, rows: number): { map: CarryMap; still: Float32Array; nodes: readonly (readonly [number, number])[] } {
  const nodes = Array.from({ length: columns * rows }, (_, node) => [((node % columns) + 0.5) * (428 / columns) - 0.5, (Math.floor(node / columns) + 0.5) * (240 / rows) - 0.5] as const);
  const queries = Float32Array.from(nodes.flatMap(([x, y]) => [0, x, y]));
  const tracks = Float32Array.from(nodes.flatMap(([x, y]) => (onObject(x, y) ? [x + 60, y - 20] : scenePlace(x, y))));
  const hidden = Float32Array.from(nodes, ([x, y]) => Number(Math.hypot(x - 300, y - 110) < 45)); // the object was there
  return { nodes, map: carryMap({ columns, rows }, queries, tracks, hidden, 0.5), still: Float32Array.from(nodes, ([x, y]) => Number(!onObject(x, y))) };
}

describe("the scene's map", () => {
  it.each([[24, 13], [64, 36], [160, 90]])("goes on behind objects, on %d x %d nodes", (columns, rows) => {
    const { map, still, nodes } = answers(columns, rows);
    const scene = sceneMap(map, shares({ columns, rows }, still), IMAGE);
    expect(Math.min(...scene.visible)).toBe(1);
    nodes.forEach(([x, y], node) => {
      const [toX, toY] = scenePlace(x, y);
      const apart = Math.hypot(x + (scene.flow[2 * node] ?? 0) - toX, y + (scene.flow[2 * node + 1] ?? 0) - toY);
      expect(apart, `at ${x}, ${y}`).toBeLessThan(0.3);
    });
  });

  it("is of the nodes' own grid where shares are known more finely", () => {
    const { map, nodes } = answers(24, 13);
    const fine = answers(160, 90);
    const scene = sceneMap(map, shares({ columns: 160, rows: 90 }, fine.still), IMAGE);
    const node = nodes.findIndex(([x, y]) => Math.hypot(x - 230, y - 120) < 12);
    const [x, y] = nodes[node] ?? [0, 0];
    const [toX] = scenePlace(x, y);
    expect(x + (scene.flow[2 * node] ?? 0)).toBeCloseTo(toX, 0);
  });

  it("is what the model answers where there is no scene to tell", () => {
    const { map, still } = answers(24, 13);
    expect(sceneMap(map, shares({ columns: 24, rows: 13 }, still.map(() => 0)), IMAGE)).toBe(map);
  });
});

describe("a homography", () => {
  it("is found among pairs of which a third are wrong", () => {
    const places = Array.from({ length: 300 }, (_, index) => [((index * 7) % 100) / 100 - 0.5, ((index * 13) % 60) / 100 - 0.3] as const);
    const from = Float32Array.from(places.flat());
    const to = Float32Array.from(places.flatMap(([x, y], index) => (index % 3 === 0 ? [x + 0.2, y - 0.1] : moved(CAMERA, x, y))));
    const found = fitHomography(from, to, 0.005);
    CAMERA.forEach((value, index) => expect(found?.[index]).toBeCloseTo(value, 2));
  });

  it("is not told by places on a line", () => {
    const places = Float32Array.from({ length: 40 }, (_, index) => (index >> 1) / 20);
    expect(fitHomography(places, places, 0.005)).toBeUndefined();
  });
});

describe("values filled in", () => {
  it.each([[7, 5], [16, 9], [1, 4]])("go on smoothly, on %d x %d", (columns, rows) => {
    const values = Float32Array.from({ length: columns * rows }, (_, at) => (at % columns < columns / 2 ? 3 : 99));
    const weight = values.map((value) => Number(value === 3));
    expect([...filled(values, weight, columns, rows, 1)]).toEqual([...values].map(() => expect.closeTo(3, 4)));
  });

  it("lie between those on either side", () => {
    const values = Float32Array.of(0, 0, 9, 9, 9, 9, 8, 8);
    const whole = filled(values, Float32Array.of(1, 1, 0, 0, 0, 0, 1, 1), 8, 1, 1);
    for (let at = 1; at < 8; at++) expect(whole[at]).toBeGreaterThanOrEqual(whole[at - 1] ?? 0);
    expect([whole[0], whole[7]]).toEqual([0, 8]);
  });
});
