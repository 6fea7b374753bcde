/** The layers that the model renders, coarse first, on rasters that cover the image. */

import type { Size } from "./geometry";
import { FARTHEST, HOLE, LAYERS as RENDERED } from "./model/contract";
import type { ModelFacts } from "./model/facts";
import type { Appearance } from "./model/protocol";

export type Rendered = (typeof RENDERED)[number];
/** What can be shown of a frame: its own picture, and what the model renders. */
export const LAYERS = ["clip", ...RENDERED] as const;
export type Layer = (typeof LAYERS)[number];

/** Longer sides of the rasters, in pixels; frames not shown are rendered ahead up to `AHEAD_LEVEL`. */
const SIDES = [48, 128, 384] as const;
const AHEAD_LEVEL = 1;
/** What the rasters of all frames may take, were they all of the finest. */
const ROOM_BYTES = 64 * 2 ** 20;
/** Rasters that were given up on the way and are kept to go on with. */
const MOST_BEGUN = 12;
const RAYS = { first: 512, least: 128, most: 16384 };
const SECONDS_PER_REQUEST = 0.05;

/** One frame's layers on one raster, RGBA: the static scene is transparent where it was never seen, as `dynamic` where
 * nothing moves. */
export interface Raster extends Size {
  readonly level: number;
  readonly pixels: Readonly<Record<Rendered, ImageData>>;
}

/** The raster of `level`: no larger than the image. */
export function rasterSize({ width, height }: Size, level: number): Size {
  const scale = Math.min(1, (SIDES[level] ?? 1) / Math.max(width, height));
  return { width: Math.max(1, Math.round(width * scale)), height: Math.max(1, Math.round(height * scale)) };
}

/** Rays (t, x, y) through the raster's pixel centres `first` up to but without `last`, row by row. */
export function rays(t: number, raster: Size, image: Size, first: number, last: number): Float32Array {
  const queries = new Float32Array((last - first) * 3);
  for (let pixel = first; pixel < last; pixel++) {
    const [row, column] = [Math.floor(pixel / raster.width), pixel % raster.width];
    const x = ((column + 0.5) * image.width) / raster.width - 0.5;
    const y = ((row + 0.5) * image.height) / raster.height - 0.5;
    queries.set([t, x, y], (pixel - first) * 3);
  }
  return queries;
}

/** Frames whose rasters are kept. */
export function roomFor(image: Size): number {
  const { width, height } = rasterSize(image, SIDES.length - 1);
  return Math.max(2, Math.floor(ROOM_BYTES / (4 * RENDERED.length * width * height)));
}

/** What to render next: the frame shown to the finest level, then those after it, as many as are kept, up to `AHEAD_LEVEL`. */
export function nextWork(
  shown: number,
  numFrames: number,
  room: number,
  levelOf: (frame: number) => number,
): { frame: number; level: number } | undefined {
  const levels = SIDES.map((_, level) => level);
  for (const level of levels) if (levelOf(shown) < level) return { frame: shown, level };
  for (const level of levels.filter((level) => level <= AHEAD_LEVEL)) {
    for (let ahead = 1; ahead < Math.min(numFrames, room); ahead++) {
      const frame = (shown + ahead) % numFrames;
      if (levelOf(frame) < level) return { frame, level };
    }
  }
  return undefined;
}

/** Renders whatever frame is shown, and others ahead as there is room, in requests so short that a click gets its turn. */
export class LayerRenderer {
  private readonly finished = new Map<number, Raster>();
  /** Rasters given up on the way, to go on with, by frame and level, and how many of their pixels are done. */
  private readonly begun = new Map<string, { raster: Raster; done: number }>();
  private running = false;
  private closed = false;
  private shown = 0;
  private raysPerRequest = RAYS.first;

  constructor(
    private readonly facts: ModelFacts,
    private readonly render: (queries: Float32Array) => Promise<Appearance>,
    private readonly onRaster: (frame: number) => void,
    private readonly onError: (error: unknown) => void,
    private readonly room = roomFor(facts),
  ) {}

  /** The finest raster of `frame` so far. */
  peek(frame: number): Raster | undefined {
    return this.finished.get(frame);
  }

  /** The same; asks for a finer one. */
  get(frame: number): Raster | undefined {
    this.shown = frame;
    if (!this.running && !this.closed) void this.run();
    return this.peek(frame);
  }

  /** The raster of `frame` at the level that frames are rendered ahead to, also where there is a finer one. */
  async wait(frame: number): Promise<Raster> {
    const had = this.finished.get(frame);
    const { width, height } = rasterSize(this.facts, AHEAD_LEVEL);
    return had?.width === width && had.height === height ? had : this.make(frame, AHEAD_LEVEL, () => true);
  }

  close(): void {
    this.closed = true;
  }

  private async run(): Promise<void> {
    this.running = true;
    try {
      for (;;) {
        const work = nextWork(this.shown, this.facts.numFrames, this.room, (frame) => this.finished.get(frame)?.level ?? -1);
        if (work === undefined || this.closed) break;
        const shown = this.shown;
        await this.make(work.frame, work.level, () => work.level === 0 || this.shown === shown);
      }
    } catch (error) {
      if (!this.closed) this.onError(error);
      this.closed = true;
    } finally {
      this.running = false;
    }
  }

  /** Renders one frame, from where it was left; leaves it, and returns what there is, as soon as `wanted` says no. */
  private async make(frame: number, level: number, wanted: () => boolean): Promise<Raster> {
    const key = `${frame}@${level}`;
    const part = this.begun.get(key) ?? { raster: blankRaster(this.facts, level), done: 0 };
    this.begun.delete(key); // to the end of the order in which they are dropped
    this.begun.set(key, part);
    if (this.begun.size > MOST_BEGUN) this.begun.delete([...this.begun.keys()][0] ?? key);
    const { raster } = part;
    const count = raster.width * raster.height;
    while (part.done < count) {
      const [first, last] = [part.done, Math.min(count, part.done + this.raysPerRequest)];
      const start = performance.now();
      paint(raster, first, await this.render(rays(frame, raster, this.facts, first, last)));
      this.adapt((performance.now() - start) / 1000);
      part.done = Math.max(part.done, last);
      if (part.done < count && (!wanted() || this.closed)) return raster;
    }
    this.begun.delete(key);
    if (level > (this.finished.get(frame)?.level ?? -1)) {
      this.finished.set(frame, raster);
      if (this.finished.size > this.room) this.dropLast();
      this.onRaster(frame);
    }
    return raster;
  }

  /** Drops the raster of the frame that comes last from the one shown, round and round. */
  private dropLast(): void {
    const ahead = (frame: number): number => (frame - this.shown + this.facts.numFrames) % this.facts.numFrames;
    this.finished.delete([...this.finished.keys()].reduce((a, b) => (ahead(a) > ahead(b) ? a : b)));
  }

  private adapt(seconds: number): void {
    const factor = Math.min(2, Math.max(0.5, SECONDS_PER_REQUEST / seconds));
    this.raysPerRequest = Math.round(Math.min(RAYS.most, Math.max(RAYS.least, this.raysPerRequest * factor)));
  }
}

function blankRaster(image: Size, level: number): Raster {
  const size = rasterSize(image, level);
  const blank = (): ImageData => new ImageData(size.width, size.height);
  return { ...size, level, pixels: { fused: blank(), static: blank(), dynamic: blank(), mask: blank(), depth: blank() } };
}

function paint(raster: Raster, first: number, seen: Appearance): void {
  seen.depth.forEach((depth, ray) => {
    const at = (first + ray) * 4;
    const moving = 255 * (1 - (seen.static_confidence[ray] ?? 0));
    const colours = [
      [raster.pixels.fused, seen.rgb, 255],
      [raster.pixels.static, seen.rgb_static, (255 / HOLE) * (seen.static_opacity[ray] ?? 1)],
      [raster.pixels.dynamic, seen.rgb_dynamic, moving],
    ] as const;
    for (const [image, values, alpha] of colours) {
      for (let channel = 0; channel < 3; channel++) image.data[at + channel] = 255 * (values[3 * ray + channel] ?? 0);
      image.data[at + 3] = alpha;
    }
    const near = 255 * (1 - depth / FARTHEST);
    raster.pixels.mask.data.set([moving, moving, moving, 255], at);
    raster.pixels.depth.data.set([near, near, near, 255], at);
  });
}
