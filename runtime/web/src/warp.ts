/**
 * Moves what is drawn over one frame to another, by where the model says that the other's pixels were.
 *
 * As `decomo_runtime/edits.py`, which asks for every pixel and smooths the answers; here they are those of a coarse grid,
 * and of what lies between its nodes: in straight lines, but across the outlines of what moves differently, where what is
 * seen by each of the nodes about a pixel is mixed.
 */

import type { Size } from "./geometry";
import { type Looks, chance } from "./looks";

/** Of the score, about the threshold, over which a pixel fades from in sight to hidden: as `dense_maps.py`. */
const RAMP = 0.3;
/** Shares of a pixel's ray: from the one on it is an object's in part, from the other on wholly; as `edits.py`. */
const OBJECT_SHARE = { part: 0.25, whole: 0.75 };
/** Difference of motion between neighbouring nodes, of their distance, from which on an outline is taken to lie between them. */
const TORN = 0.35;
/** Steepness of a mask's rim over the chance of a pixel to be the mask's, so that all that is likely is solid. */
const FIRM = 2.5;

/** Values at the nodes of a grid over the frame, row by row, each in the middle of its cell. */
export interface Grid {
  readonly columns: number;
  readonly rows: number;
}

/** Where the pixels of a frame were in the frame that was drawn on. */
export interface CarryMap extends Grid {
  /** [rows, columns, 2], displacement (x, y) to there in pixels. */
  readonly flow: Float32Array;
  /** [rows, columns], from 0, hidden there, to 1, in sight. */
  readonly visible: Float32Array;
}

/** How much of each pixel an object has, from 0 to 1. */
export interface Shares extends Grid {
  readonly share: Float32Array;
  /** Likewise, of its ray as the model says it. */
  readonly moving: Float32Array;
}

/** A canvas's pixels, RGBA, `scale` for each of the frame's, and where any is not transparent. */
export interface Cel {
  readonly pixels: ImageData;
  readonly scale: number;
  readonly bounds: Bounds | undefined;
}

/** In pixels of a canvas; `right` and `bottom` are not in it. */
export interface Bounds {
  readonly left: number;
  readonly top: number;
  readonly right: number;
  readonly bottom: number;
}

export const SAME: CarryMap = { columns: 1, rows: 1, flow: new Float32Array(2), visible: Float32Array.of(1) };

/** The map of a model's answers at the nodes: `queries` [N, 3], `tracks` [N, 2] and `occlusion` [N]. */
export function carryMap(grid: Grid, queries: Float32Array, tracks: Float32Array, occlusion: Float32Array, threshold: number): CarryMap {
  const flow = tracks.map((value, index) => value - (queries[3 * (index >> 1) + 1 + (index & 1)] ?? 0));
  const visible = occlusion.map((score) => unit((threshold + RAMP / 2 - score) / RAMP));
  return { ...grid, flow, visible };
}

export function shares(grid: Grid, staticConfidence: Float32Array): Shares {
  const { part, whole } = OBJECT_SHARE;
  const moving = staticConfidence.map((still) => 1 - still);
  return { ...grid, moving, share: moving.map((each) => unit((each - part) / (whole - part))) };
}

/** Where a picture is not transparent; undefined where it is everywhere. */
export function boundsOf({ data, width, height }: ImageData): Bounds | undefined {
  let [left, top, right, bottom] = [width, height, 0, 0];
  for (let y = 0, at = 3; y < height; y++) {
    for (let x = 0; x < width; x++, at += 4) {
      if (data[at] === 0) continue;
      if (x < left) left = x;
      if (x >= right) right = x + 1;
      if (y < top) top = y;
      bottom = y + 1;
    }
  }
  return right === 0 ? undefined : { left, top, right, bottom };
}

/** What is drawn, as it is in a frame, and where on the frame, in pixels of the cels. */
export interface Warped {
  readonly pixels: ImageData;
  readonly left: number;
  readonly top: number;
}

/** A drawing and how the frame that is asked for maps to the one drawn on. */
export interface Source {
  readonly cel: Cel;
  readonly map: CarryMap;
}

/**
 * The drawing in a frame of the size `image`, from one source, or from several that draw one thing, the most trusted
 * first: each pixel is of the first that has it in sight. `owned` is by how much a drawing of the objects, or of the scene,
 * is there. `looks` are those of a mask: what no source has in sight goes by them.
 */
export function warp(sources: readonly Source[], image: Size, owned?: { shares: Shares; moving: boolean }, looks?: Looks): Warped | undefined {
  const scale = sources[0]?.cel.scale ?? 1;
  const blocks = new Blocks(sources, image, scale, looks);
  const region = blocks.bounds();
  if (region === undefined) return undefined;
  const { left, top } = region;
  const [width, height] = [region.right - left, region.bottom - top];
  const pixels = new ImageData(width, height);
  const readers = sources.map(({ cel, map }) => new Reader(cel, map, image));
  const share = owned && new Nodes(owned.shares, image);
  const odds = looks && new Nodes(looks, image);
  const sum = new Float32Array(4);
  for (let row = 0, at = 0; row < height; row++) {
    const y = (top + row + 0.5) / scale - 0.5;
    for (let column = 0; column < width; column++, at += 4) {
      if (!blocks.has(left + column, top + row)) continue;
      const x = (left + column + 0.5) / scale - 0.5;
      sum.fill(0);
      let remaining = 1;
      for (const reader of readers) {
        remaining *= 1 - reader.add(x, y, remaining, sum);
        if (remaining < 0.004) break;
      }
      if (odds && looks) {
        odds.go(x, y);
        const likely = chance((sum[3] ?? 0) + remaining / 2, odds.mean(looks.odds));
        pixels.data[at + 3] = 255 * unit(0.5 + FIRM * (likely - 0.5)) + 0.5;
        continue;
      }
      const alpha = sum[3] ?? 0;
      if (alpha < 0.5 / 255) continue;
      let part = 1;
      if (share && owned) {
        share.go(x, y);
        part = owned.moving ? share.mean(owned.shares.share) : 1 - share.mean(owned.shares.share);
      }
      pixels.data[at] = (sum[0] ?? 0) / alpha;
      pixels.data[at + 1] = (sum[1] ?? 0) / alpha;
      pixels.data[at + 2] = (sum[2] ?? 0) / alpha;
      pixels.data[at + 3] = 255 * alpha * part + 0.5;
    }
  }
  return { pixels, left, top };
}

const unit = (value: number): number => Math.min(1, Math.max(0, value));

/** Side of a block, in pixels of the cels. */
const BLOCK = 8;

/** Those parts of the frame where a pixel may be of what is drawn, in blocks of pixels of the cels. */
class Blocks {
  private readonly columns: number;
  private readonly rows: number;
  private readonly wanted: Uint8Array;

  constructor(
    sources: readonly Source[],
    private readonly image: Size,
    private readonly scale: number,
    looks?: Looks,
  ) {
    const { width, height } = image;
    this.columns = Math.ceil((width * scale) / BLOCK);
    this.rows = Math.ceil((height * scale) / BLOCK);
    this.wanted = new Uint8Array(this.columns * this.rows);
    for (const { cel, map } of sources) {
      if (cel.bounds === undefined) continue;
      const [across, down] = [width / map.columns, height / map.rows];
      this.addNodes(map, (x, y, node) => {
        const [toX, toY] = [x + (map.flow[2 * node] ?? 0), y + (map.flow[2 * node + 1] ?? 0)];
        return isNear(cel, toX - 2 * across, toY - 2 * down, toX + 2 * across, toY + 2 * down);
      });
    }
    if (looks) this.addNodes(looks, (_x, _y, node) => (looks.odds[node] ?? 0) > 0);
  }

  has(x: number, y: number): boolean {
    return this.wanted[Math.floor(y / BLOCK) * this.columns + Math.floor(x / BLOCK)] === 1;
  }

  /** The box that holds all of them. */
  bounds(): Bounds | undefined {
    let [left, top, right, bottom] = [this.columns, this.rows, 0, 0];
    this.wanted.forEach((wanted, block) => {
      if (wanted === 0) return;
      const [column, row] = [block % this.columns, Math.floor(block / this.columns)];
      [left, top] = [Math.min(left, column), Math.min(top, row)];
      [right, bottom] = [Math.max(right, column + 1), Math.max(bottom, row + 1)];
    });
    const [width, height] = [this.image.width * this.scale, this.image.height * this.scale];
    return right === 0 ? undefined : { left: left * BLOCK, top: top * BLOCK, right: Math.min(width, right * BLOCK), bottom: Math.min(height, bottom * BLOCK) };
  }

  /** Adds what lies about those nodes of a grid of which `isWanted` is true. */
  private addNodes({ columns, rows }: Grid, isWanted: (x: number, y: number, node: number) => boolean): void {
    const { scale } = this;
    const [across, down] = [this.image.width / columns, this.image.height / rows];
    for (let row = 0, node = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++, node++) {
        const [x, y] = [(column + 0.5) * across, (row + 0.5) * down];
        if (!isWanted(x, y, node)) continue;
        this.add((x - 1.5 * across) * scale, (y - 1.5 * down) * scale, (x + 1.5 * across) * scale, (y + 1.5 * down) * scale);
      }
    }
  }

  private add(left: number, top: number, right: number, bottom: number): void {
    const last = [Math.min(this.columns - 1, Math.floor(right / BLOCK)), Math.min(this.rows - 1, Math.floor(bottom / BLOCK))] as const;
    for (let row = Math.max(0, Math.floor(top / BLOCK)); row <= last[1]; row++) {
      const begin = row * this.columns + Math.max(0, Math.floor(left / BLOCK));
      this.wanted.fill(1, begin, row * this.columns + last[0] + 1);
    }
  }
}

/** Side of the squares in which it is noted whether a cel has anything, in its pixels. */
const SQUARE = 16;
const squares = new WeakMap<Cel, { readonly filled: Uint8Array; readonly columns: number; readonly rows: number }>();

/** Whether a cel may have something in a box of the clip's pixels, edges from 0 on. */
function isNear(cel: Cel, left: number, top: number, right: number, bottom: number): boolean {
  const { columns, rows, filled } = squaresOf(cel);
  const at = (edge: number, most: number): number => Math.min(most, Math.max(-1, Math.floor((edge * cel.scale) / SQUARE)));
  const [first, last] = [Math.max(0, at(left, columns)), Math.min(columns - 1, at(right, columns))];
  for (let row = Math.max(0, at(top, rows)); row <= Math.min(rows - 1, at(bottom, rows)); row++) {
    for (let column = first; column <= last; column++) if (filled[row * columns + column] === 1) return true;
  }
  return false;
}

function squaresOf(cel: Cel): { readonly filled: Uint8Array; readonly columns: number; readonly rows: number } {
  const had = squares.get(cel);
  if (had !== undefined) return had;
  const { data, width, height } = cel.pixels;
  const [columns, rows] = [Math.ceil(width / SQUARE), Math.ceil(height / SQUARE)];
  const filled = new Uint8Array(columns * rows);
  for (let y = 0, at = 3; y < height; y++) {
    for (let x = 0; x < width; x++, at += 4) if (data[at] !== 0) filled[Math.floor(y / SQUARE) * columns + Math.floor(x / SQUARE)] = 1;
  }
  const made = { filled, columns, rows };
  squares.set(cel, made);
  return made;
}

/** The four nodes about a place, and how near each is. */
class Nodes {
  /** Of the nodes. */
  protected a = 0;
  protected b = 0;
  protected c = 0;
  protected d = 0;
  protected across = 0;
  protected down = 0;
  private readonly perX: number;
  private readonly perY: number;

  constructor(
    private readonly grid: Grid,
    image: Size,
  ) {
    this.perX = grid.columns / image.width;
    this.perY = grid.rows / image.height;
  }

  go(x: number, y: number): void {
    const { columns, rows } = this.grid;
    const [atX, atY] = [
      Math.min(columns - 1, Math.max(0, (x + 0.5) * this.perX - 0.5)),
      Math.min(rows - 1, Math.max(0, (y + 0.5) * this.perY - 0.5)),
    ];
    const [left, top] = [Math.floor(atX), Math.floor(atY)];
    const [right, bottom] = [Math.min(columns - 1, left + 1), Math.min(rows - 1, top + 1)];
    this.across = atX - left;
    this.down = atY - top;
    this.a = top * columns + left;
    this.b = top * columns + right;
    this.c = bottom * columns + left;
    this.d = bottom * columns + right;
  }

  /** Of values [rows, columns, `step`], the `offset`th. */
  mean(values: Float32Array, step = 1, offset = 0): number {
    const { across, down } = this;
    const above = (values[step * this.a + offset] ?? 0) * (1 - across) + (values[step * this.b + offset] ?? 0) * across;
    const below = (values[step * this.c + offset] ?? 0) * (1 - across) + (values[step * this.d + offset] ?? 0) * across;
    return above * (1 - down) + below * down;
  }
}

/** Reads a cel through a map. */
class Reader extends Nodes {
  private readonly torn: Uint8Array;

  constructor(
    private readonly cel: Cel,
    private readonly map: CarryMap,
    image: Size,
  ) {
    super(map, image);
    this.torn = tornCells(map, image);
  }

  /** Adds `weight` times the colour at a place, premultiplied, to `sum`; returns how far the place is in sight. */
  add(x: number, y: number, weight: number, sum: Float32Array): number {
    this.go(x, y);
    const { flow, visible } = this.map;
    const { a, b, c, d, across, down } = this;
    if (this.torn[a] === 0) {
      const seen = this.mean(visible);
      if (seen > 0) this.read(x + this.mean(flow, 2), y + this.mean(flow, 2, 1), weight * seen, sum);
      return seen;
    }
    const along = (node: number, share: number): number => {
      const seen = share * (visible[node] ?? 0);
      if (seen > 0) this.read(x + (flow[2 * node] ?? 0), y + (flow[2 * node + 1] ?? 0), weight * seen, sum);
      return seen;
    };
    const above = along(a, (1 - across) * (1 - down)) + along(b, across * (1 - down));
    return above + along(c, (1 - across) * down) + along(d, across * down);
  }

  /** Adds `weight` times the colour of the cel at a place of its frame. */
  private read(x: number, y: number, weight: number, sum: Float32Array): void {
    const { pixels, scale, bounds } = this.cel;
    const [atX, atY] = [(x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5];
    if (bounds === undefined || !(atX > bounds.left - 1 && atX < bounds.right && atY > bounds.top - 1 && atY < bounds.bottom)) return;
    const { data, width, height } = pixels;
    const [left, top] = [Math.floor(atX), Math.floor(atY)];
    const [across, down] = [atX - left, atY - top];
    for (let corner = 0; corner < 4; corner++) {
      const [column, row] = [left + (corner & 1), top + (corner >> 1)];
      if (column < 0 || row < 0 || column >= width || row >= height) continue;
      const at = 4 * (row * width + column);
      const share = (corner & 1 ? across : 1 - across) * (corner >> 1 ? down : 1 - down);
      const alpha = (weight * share * (data[at + 3] ?? 0)) / 255;
      sum[0] = (sum[0] ?? 0) + alpha * (data[at] ?? 0);
      sum[1] = (sum[1] ?? 0) + alpha * (data[at + 1] ?? 0);
      sum[2] = (sum[2] ?? 0) + alpha * (data[at + 2] ?? 0);
      sum[3] = (sum[3] ?? 0) + alpha;
    }
  }
}

const torn = new WeakMap<CarryMap, Uint8Array>();

/** By their upper left nodes, 1 where the corners of a cell move so differently that an outline lies between them. */
function tornCells(map: CarryMap, image: Size): Uint8Array {
  const had = torn.get(map);
  if (had !== undefined) return had;
  const { columns, rows, flow } = map;
  const most = TORN * Math.max(image.width / columns, image.height / rows);
  const cells = new Uint8Array(columns * rows);
  for (let row = 0; row < rows - 1; row++) {
    for (let column = 0; column < columns - 1; column++) {
      const node = row * columns + column;
      for (const axis of [0, 1]) {
        const corners = [node, node + 1, node + columns, node + columns + 1].map((each) => flow[2 * each + axis] ?? 0);
        if (Math.max(...corners) - Math.min(...corners) > most) cells[node] = 1;
      }
    }
  }
  torn.set(map, cells);
  return cells;
}
