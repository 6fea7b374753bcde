/** Where the model is unsure of a frame: expected errors on a grid over it, coarse first, made in the background. */

import type { Size } from "./geometry";
import { rays } from "./layers";
import { errorInUnits, unit } from "./model/errors";
import type { ModelFacts } from "./model/facts";
import type { Tracked } from "./model/protocol";
import { errorRgb } from "./sureness";

/** Cells along the longer side of the grids. */
const SIDES = [12, 24, 48] as const;
/** Frames from the one shown, before and after it, to which its places are followed. */
const GAPS = [2, 4, 8, 16] as const;
/** In one request, so that a click never waits for long. */
const RAYS_PER_REQUEST = 512;
const MOST_KEPT = 600;

export interface HeatMap extends Size {
  readonly level: number;
  /** [height * width], the median over the frames near by, in pixels of the clip. */
  readonly errors: Float32Array;
}

/** What the frames near by are, and where places are in them. */
export interface Glance extends Tracked {
  readonly frames: readonly number[];
}

export class HeatMaps {
  /** By frame, the last used last. */
  private readonly made = new Map<number, HeatMap>();
  private wanted: number | undefined;
  private running = false;

  /** `glance` follows places [N, 3] of one frame to others, as many of those asked for as the model has at hand. */
  constructor(
    private readonly facts: ModelFacts,
    private readonly glance: (queries: Float32Array, frames: readonly number[]) => Promise<Glance>,
    private readonly onMap: (frame: number) => void,
    private readonly onError: (error: unknown) => void,
  ) {}

  /** The finest map of `frame` so far; goes on with a finer one, and with that of no other frame. */
  get(frame: number): HeatMap | undefined {
    this.wanted = frame;
    if (!this.running) void this.run();
    const map = this.made.get(frame);
    if (map !== undefined) this.keep(frame, map);
    return map;
  }

  /** No map is wanted any more; those that are made stay. */
  cancel(): void {
    this.wanted = undefined;
  }

  private async run(): Promise<void> {
    this.running = true;
    try {
      for (;;) {
        const frame = this.wanted;
        const level = frame === undefined ? SIDES.length : (this.made.get(frame)?.level ?? -1) + 1;
        if (frame === undefined || level === SIDES.length) break;
        const map = await this.make(frame, level);
        if (map === undefined) continue;
        this.keep(frame, map);
        this.onMap(frame);
      }
    } catch (error) {
      if (this.wanted !== undefined) this.onError(error);
      this.wanted = undefined;
    } finally {
      this.running = false;
    }
  }

  /** Undefined where another frame is wanted meanwhile, or none. */
  private async make(frame: number, level: number): Promise<HeatMap | undefined> {
    const { width, height } = gridSize(this.facts, level);
    const errors = new Float32Array(width * height);
    const near = nearBy(frame, this.facts.numFrames);
    const step = Math.floor(RAYS_PER_REQUEST / (1 + near.length));
    for (let first = 0; first < errors.length; first += step) {
      const queries = rays(frame, { width, height }, this.facts, first, Math.min(errors.length, first + step));
      errors.set(this.unsure(frame, await this.glance(queries, near)), first);
      if (this.wanted !== frame) return undefined;
    }
    return { width, height, level, errors };
  }

  private unsure(frame: number, { frames, occlusion }: Glance): number[] {
    if (frames.length === 0) return [];
    const known = this.facts.quality?.all.median;
    return Array.from({ length: occlusion.length / frames.length }, (_, row) => {
      const errors = frames.map((other, index) => errorInUnits(occlusion[row * frames.length + index] ?? 1, Math.abs(other - frame), known));
      return median(errors) * unit(this.facts);
    });
  }

  private keep(frame: number, map: HeatMap): void {
    this.made.delete(frame);
    this.made.set(frame, map);
    for (const oldest of this.made.keys()) {
      if (this.made.size <= MOST_KEPT) break;
      this.made.delete(oldest);
    }
  }
}

/** The frames of a clip to which those of `frame` are followed. */
export const nearBy = (frame: number, numFrames: number): number[] =>
  GAPS.flatMap((gap) => [frame - gap, frame + gap]).filter((other) => other >= 0 && other < numFrames);

/** A grid over the image, of square cells as nearly as whole numbers allow. */
export function gridSize({ width, height }: Size, level: number): Size {
  const scale = Math.min(1, (SIDES[level] ?? 1) / Math.max(width, height));
  return { width: Math.max(1, Math.round(width * scale)), height: Math.max(1, Math.round(height * scale)) };
}

/** Each cell in the colour of its error. */
export function paintHeat({ width, height, errors }: HeatMap, unit: number): OffscreenCanvas {
  const canvas = new OffscreenCanvas(width, height);
  const pixels = new ImageData(width, height);
  errors.forEach((error, cell) => pixels.data.set([...errorRgb(error, unit), 255], 4 * cell));
  canvas.getContext("2d")?.putImageData(pixels, 0, 0);
  return canvas;
}

function median(values: readonly number[]): number {
  const sorted = [...values].sort((a, b) => a - b);
  const half = sorted.length / 2;
  return ((sorted[Math.ceil(half) - 1] ?? 0) + (sorted[Math.floor(half)] ?? 0)) / 2;
}
