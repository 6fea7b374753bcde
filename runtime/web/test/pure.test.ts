import { afterEach, describe, expect, it, vi } from "vitest";
import { box, clampPlace, gridCells, gridInside } from "../src/geometry";
import { LayerRenderer, nextWork, rasterSize, rays, roomFor } from "../src/layers";
import { errorInUnits } from "../src/model/errors";
import type { ModelFacts } from "../src/model/facts";
import type { Appearance } from "../src/model/protocol";
import { spans, splitTracks } from "../src/tracks";
import { Player } from "../src/ui/player";

describe("tracks", () => {
  it("are cut out of the answer row by row", () => {
    const tracked = { tracks: Float32Array.of(1, 2, 3, 4, 5, 6, 7, 8), occlusion: Float32Array.of(0.1, 0.5, 0.6, 1) };
    const facts = { numFrames: 2, occlusionThreshold: 0.5, width: 512, height: 99 } as ModelFacts;
    const [first, second] = splitTracks(tracked, [{ t: 0, x: 1, y: 2 }, { t: 1, x: 7, y: 8 }], facts);
    expect(first).toMatchObject({ xy: Float32Array.of(1, 2, 3, 4), occlusion: Float32Array.of(0.1, 0.5), occluded: [false, false] });
    expect([first?.error[0], second?.error[1]]).toEqual([0, 0]);
    expect(first?.error[1]).toBeCloseTo(2 * errorInUnits(0.5, 1, undefined), 4);
    expect(second?.occluded).toEqual([true, true]);
  });

  it("have spans that cover every frame once", () => {
    expect(spans([false, false, true, false])).toEqual([
      { begin: 0, end: 2, occluded: false },
      { begin: 2, end: 3, occluded: true },
      { begin: 3, end: 4, occluded: false },
    ]);
    expect(spans([])).toEqual([]);
  });
});

describe("areas", () => {
  const image = { width: 20, height: 10 };

  it("hold a centred grid", () => {
    const places = gridInside(box({ x: 0, y: 0 }, { x: 11, y: 6 }), 5, image);
    expect(places.map(({ x, y }) => [x, y])).toEqual([0.5, 5.5].flatMap((y) => [0.5, 5.5, 10.5].map((x) => [x, y])));
    expect(gridInside(box({ x: 3, y: 3 }, { x: 4, y: 5 }), 16, image)).toEqual([{ x: 3.5, y: 4 }]);
  });

  it("hold a centred grid where the spacing divides their sides", () => {
    const places = gridInside(box({ x: 0, y: 0 }, { x: 10, y: 5 }), 5, image);
    expect(places).toEqual([{ x: 2.5, y: 2.5 }, { x: 7.5, y: 2.5 }]);
    expect(gridInside(box({ x: -9, y: -9 }, { x: 99, y: 99 }), 5, image)).toHaveLength(4 * 2);
  });

  it("are counted before they are filled", () => {
    expect(gridCells(box({ x: 0, y: 0 }, { x: 11, y: 6 }), 5, image)).toBe(3 * 2);
    expect(gridCells([{ x: -9, y: -9 }, { x: 99, y: -9 }, { x: -9, y: 99 }], 1, image)).toBe(20 * 10);
  });

  it("keep to the image and to the lasso", () => {
    const places = gridInside([{ x: -9, y: -9 }, { x: 99, y: -9 }, { x: -9, y: 99 }], 2, image);
    expect(places.length).toBeGreaterThan(10);
    expect(places.every((place) => JSON.stringify(clampPlace(place, image)) === JSON.stringify(place))).toBe(true);
    expect(places.some(({ x, y }) => x > 15 && y > 8)).toBe(false);
  });
});

describe("layers", () => {
  it("cover the image, whatever the raster", () => {
    const image = { width: 320, height: 160 };
    expect(rasterSize(image, 0)).toEqual({ width: 48, height: 24 });
    expect(rasterSize(image, 2)).toEqual(image);
    const raster = { width: 2, height: 1 };
    expect([...rays(3, raster, image, 0, 2)]).toEqual([3, 79.5, 79.5, 3, 239.5, 79.5]);
    expect([...rays(0, image, image, 321, 322)]).toEqual([0, 1, 1]);
  });

  it("are made for the frame shown first, then ahead", () => {
    const levels = [-1, -1, -1];
    const order: string[] = [];
    for (;;) {
      const work = nextWork(1, 3, 9, (frame) => levels[frame] ?? 9);
      if (work === undefined) break;
      order.push(`${work.frame}@${work.level}`);
      levels[work.frame] = work.level;
    }
    expect(order).toEqual(["1@0", "1@1", "1@2", "2@0", "0@0", "2@1", "0@1"]);
  });
});

describe("the renderer of layers", () => {
  const facts = { clipName: "c", numFrames: 2, height: 512, width: 512, fps: 12, times: Array.from({ length: 2 }, (_, i) => i / 12), preset: "cpu", occlusionThreshold: 0.5, objectShare: 0.5 };
  afterEach(() => {
    vi.unstubAllGlobals();
    vi.restoreAllMocks();
  });

  /** A renderer whose requests wait for `step` and then seem to have taken so long that they stay short. */
  function renderer(numFrames = 2, room?: number, side = 512) {
    class Pixels {
      readonly data: Uint8ClampedArray;
      constructor(readonly width: number, readonly height: number) {
        this.data = new Uint8ClampedArray(4 * width * height);
      }
    }
    vi.stubGlobal("ImageData", Pixels);
    let now = 0;
    vi.spyOn(performance, "now").mockImplementation(() => (now += 50));
    const waiting: (() => void)[] = [];
    const render = (queries: Float32Array): Promise<Appearance> => {
      const rays = queries.length / 3;
      const [three, one] = [new Float32Array(3 * rays), new Float32Array(rays)];
      const seen = { rgb: three, rgb_static: three, rgb_dynamic: three, static_confidence: one, depth: one, static_opacity: one };
      return new Promise((resolve) => waiting.push(() => resolve(seen)));
    };
    const made = new LayerRenderer({ ...facts, numFrames, width: side, height: side }, render, () => {}, (error) => expect.fail(String(error)), room);
    const step = async (): Promise<void> => {
      for (const answer of waiting.splice(0)) answer();
      await new Promise((done) => setTimeout(done));
    };
    return { made, step, asked: () => waiting.length };
  }

  it("makes and keeps the frames next to come, as many as there is room for", async () => {
    const { made, step, asked } = renderer(3600, 3, 40);
    const kept = (): number[] => Array.from({ length: 3600 }, (_, frame) => frame).filter((frame) => made.get(frame) !== undefined);
    for (const [shown, expected] of [[20, [20, 21, 22]], [3599, [0, 1, 3599]]] as const) {
      made.get(shown);
      for (let quiet = 0; quiet < 3; quiet = asked() === 0 ? quiet + 1 : 0) await step();
      expect(kept()).toEqual(expected);
    }
  });

  it("keeps few of the rasters that it gave up, however many frames are passed by", async () => {
    const { made, step } = renderer(3600);
    for (let frame = 0; frame < 30; frame++) {
      for (const _ of Array(48 ** 2 / 128 + 8)) {
        made.get(frame);
        await step();
      }
    }
    expect(Reflect.get(made, "begun").size).toBe(12);
  });

  it("has room for no more than 64 MiB", () => {
    for (const [width, height] of [[512, 512], [384, 216], [4096, 2160], [30, 20]] as const) {
      const finest = rasterSize({ width, height }, 2);
      const bytes = 5 * 4 * finest.width * finest.height;
      expect(roomFor({ width, height })).toBe(Math.floor(2 ** 26 / bytes));
    }
  });

  it("goes on with a raster where it was left when another frame was shown", async () => {
    const { made, step } = renderer();
    for (let turn = 0; made.get(turn % 2)?.level !== 1; turn++) {
      if (turn > 2 * (48 ** 2 + 128 ** 2) / 512 + 4) expect.fail("no frame gets sharper while frames change");
      await step();
    }
  });

  it("gives a video one sharpness, and keeps what is finer", async () => {
    const { made, step } = renderer();
    while (made.get(0)?.level !== 2) await step();
    let widths: number[] = [];
    void Promise.all([made.wait(0), made.wait(1)]).then((rasters) => (widths = rasters.map(({ width }) => width)));
    while (widths.length === 0) await step();
    expect(widths).toEqual([128, 128]);
    expect(made.get(0)?.level).toBe(2);
  });
});

describe("the player", () => {
  afterEach(() => {
    vi.unstubAllGlobals();
    vi.restoreAllMocks();
  });

  it("has one clock, however often it is switched within a frame of the screen", () => {
    const requests = new Map<number, FrameRequestCallback>();
    let last = 0;
    vi.stubGlobal("requestAnimationFrame", (callback: FrameRequestCallback) => requests.set(++last, callback) && last);
    vi.stubGlobal("cancelAnimationFrame", (request: number) => requests.delete(request));
    const player = new Player(() => {}, () => true);
    player.load({ times: [0, 0.1, 0.2, 0.3, 0.4], fps: 10 });
    for (let press = 0; press < 3; press++) player.toggle();
    expect(player.playing).toBe(true);
    expect(requests.size).toBe(1);
  });

  it("shows each frame for its own time, the last for a mean one", () => {
    let [now, request]: [number, FrameRequestCallback] = [0, () => {}];
    vi.stubGlobal("requestAnimationFrame", (callback: FrameRequestCallback) => ((request = callback), 1));
    vi.stubGlobal("cancelAnimationFrame", () => undefined);
    vi.spyOn(performance, "now").mockImplementation(() => now);
    const player = new Player(() => {}, () => true);
    player.load({ times: [0, 0.04, 0.14, 0.2], fps: 15 });
    player.toggle();
    const shown: number[] = [];
    for (; now <= 600; now += 10) {
      request(now);
      shown.push(player.frame);
    }
    expect([0, 1, 2, 3].map((frame) => shown.indexOf(frame, 1) * 10)).toEqual([10, 40, 140, 200]);
    expect(shown.indexOf(0, 21) * 10).toBe(270); // 1 / 15 after the last
  });
});
