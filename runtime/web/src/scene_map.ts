/**
 * Where the static scene's pixels were in the frame that was drawn on, also behind objects: there it goes on as the scene
 * around moves.
 *
 * As `decomo_runtime/scene_maps.py` and `scene_motion.py`, whose rule and numbers these are: a homography, what it leaves
 * over as a smooth remainder, and the model's own answers where they agree. Those follow points of key frames; here they
 * are the nodes of the frame's own grid, which are answered anyway.
 */

import { filled, sampled } from "./fill";
import type { Size } from "./geometry";
import { type Homography, fitHomography, moved } from "./homography";
import type { CarryMap, Shares } from "./warp";

/** The model's answers count this far from objects, and within so much of how the scene around moves, in units. */
const [CLEARANCE, AGREED] = [4, 1.5];
const SURE = 0.99;
/** Fewer nodes do not tell the motion. */
const LEAST_NODES = 12;
/** Nodes that the homography is fitted to, at most. */
const MOST_FITTED = 600;
/** Noise of an answer about the homography; beyond the second it is wrong; in units. */
const [NOISE, OUTLIER] = [1.5, 6];
/** Cells along the longer side of the raster on which the remainder is interpolated. */
const CELLS = 32;
/** A unit is a pixel of a frame with this longer side. */
const UNITS = 256;

/** How the scene moves between two frames. */
interface Motion {
  /** Between places in shares of the longer side, from the frame's middle. */
  readonly homography: Homography;
  /** [rows, columns, 2] of cells, in pixels. */
  readonly remainder: Float32Array;
  readonly columns: number;
  readonly rows: number;
}

const known = new WeakMap<CarryMap, { readonly shares: Shares; readonly map: CarryMap }>();

/** The map of the scene at all nodes of `map`, which is the model's answer; that itself where the motion is not known. */
export function sceneMap(map: CarryMap, shares: Shares, image: Size): CarryMap {
  const had = known.get(map);
  if (had?.shares === shares) return had.map;
  const made = continued(map, shares, image);
  known.set(map, { shares, map: made });
  return made;
}

function continued(map: CarryMap, shares: Shares, image: Size): CarryMap {
  const { columns, rows, flow, visible } = map;
  const longer = Math.max(image.width, image.height);
  const nodes = new Grid(map, image);
  const clear = clearOf(shares, image);
  const still = visible.map((seen, node) => Number(seen > 0.5 && shareAt(shares, nodes.x(node), nodes.y(node), image) === 0));
  const motion = fitMotion(nodes, flow, still, image);
  if (motion === undefined) return map;
  const base = flow.slice();
  const beyond = flow.slice();
  const trusted = new Float32Array(columns * rows);
  for (let node = 0; node < columns * rows; node++) {
    const [x, y] = [nodes.x(node), nodes.y(node)];
    const [toX, toY] = carried(motion, x, y, image);
    base.set([toX - x, toY - y], 2 * node);
    const apart = [(flow[2 * node] ?? 0) - (toX - x), (flow[2 * node + 1] ?? 0) - (toY - y)] as const;
    beyond.set(apart, 2 * node);
    const agrees = Math.hypot(...apart) < (AGREED * longer) / UNITS;
    trusted[node] = Number(agrees && (visible[node] ?? 0) > SURE && clear(x, y));
  }
  const rest = filled(beyond.map((value, index) => (trusted[index >> 1] === 1 ? value : 0)), trusted, columns, rows, 2);
  return { columns, rows, flow: base.map((value, index) => value + (rest[index] ?? 0)), visible: visible.map(() => 1) };
}

/** Fitted to the nodes that are `still`, [rows, columns] 1 or 0. */
function fitMotion(nodes: Grid, flow: Float32Array, still: Float32Array, image: Size): Motion | undefined {
  const longer = Math.max(image.width, image.height);
  const chosen = [...still.keys()].filter((node) => still[node] === 1);
  if (chosen.length < LEAST_NODES) return undefined;
  const places = chosen.map((node) => ({ x: nodes.x(node), y: nodes.y(node), dx: flow[2 * node] ?? 0, dy: flow[2 * node + 1] ?? 0 }));
  const step = Math.max(1, places.length / MOST_FITTED);
  const some = Array.from({ length: Math.floor(places.length / step) }, (_, index) => Math.floor(index * step)).flatMap((at) => places[at] ?? []);
  const from = Float32Array.from(some.flatMap(({ x, y }) => shared(x, y, image)));
  const to = Float32Array.from(some.flatMap(({ x, y, dx, dy }) => shared(x + dx, y + dy, image)));
  const homography = fitHomography(from, to, NOISE / UNITS);
  if (homography === undefined) return undefined;
  const cell = longer / CELLS;
  const [columns, rows] = [Math.ceil(image.width / cell), Math.ceil(image.height / cell)];
  const sums = new Float32Array(2 * columns * rows);
  const counts = new Float32Array(columns * rows);
  let kept = 0;
  places.forEach(({ x, y, dx, dy }) => {
    const [toX, toY] = byHomography(homography, x, y, image);
    const [overX, overY] = [x + dx - toX, y + dy - toY];
    if (Math.hypot(overX, overY) >= (OUTLIER * longer) / UNITS) return;
    kept++;
    const at = Math.floor((y + 0.5) / cell) * columns + Math.floor((x + 0.5) / cell);
    sums[2 * at] = (sums[2 * at] ?? 0) + overX;
    sums[2 * at + 1] = (sums[2 * at + 1] ?? 0) + overY;
    counts[at] = (counts[at] ?? 0) + 1;
  });
  if (kept < LEAST_NODES) return undefined;
  const means = sums.map((sum, index) => sum / Math.max(1, counts[index >> 1] ?? 0));
  const whole = filled(means, counts.map((count) => Math.min(1, count)), columns, rows, 2);
  return { homography, remainder: softened(softened(whole, columns, rows), columns, rows), columns, rows };
}

/** Where a place lies if it moves with the scene. */
function carried({ homography, remainder, columns, rows }: Motion, x: number, y: number, image: Size): [number, number] {
  const cell = Math.max(image.width, image.height) / CELLS;
  const [toX, toY] = byHomography(homography, x, y, image);
  const [atX, atY] = [(x + 0.5) / cell - 0.5, (y + 0.5) / cell - 0.5];
  return [toX + sampled(remainder, columns, rows, atX, atY, 2, 0), toY + sampled(remainder, columns, rows, atX, atY, 2, 1)];
}

function byHomography(homography: Homography, x: number, y: number, image: Size): [number, number] {
  const [toX, toY] = moved(homography, ...shared(x, y, image));
  const longer = Math.max(image.width, image.height);
  return [toX * longer + image.width / 2, toY * longer + image.height / 2];
}

/** A place in shares of the longer side, from the middle of the image. */
function shared(x: number, y: number, { width, height }: Size): [number, number] {
  const longer = Math.max(width, height);
  return [(x - width / 2) / longer, (y - height / 2) / longer];
}

/** Places of the nodes of a grid over an image. */
class Grid {
  constructor(
    private readonly grid: { readonly columns: number; readonly rows: number },
    private readonly image: Size,
  ) {}

  x(node: number): number {
    return (((node % this.grid.columns) + 0.5) * this.image.width) / this.grid.columns - 0.5;
  }

  y(node: number): number {
    return ((Math.floor(node / this.grid.columns) + 0.5) * this.image.height) / this.grid.rows - 0.5;
  }
}

/** Whether a place is away from objects: a function of (x, y). */
function clearOf({ columns, rows, share }: Shares, image: Size): (x: number, y: number) => boolean {
  const [across, down] = [image.width / columns, image.height / rows];
  const least = (CLEARANCE * Math.max(image.width, image.height)) / UNITS + Math.max(across, down) / 2;
  const [reachX, reachY] = [Math.floor(least / across), Math.floor(least / down)];
  const near = new Uint8Array(columns * rows);
  share.forEach((part, node) => {
    if (part === 0) return;
    const [column, row] = [node % columns, Math.floor(node / columns)];
    for (let y = Math.max(0, row - reachY); y <= Math.min(rows - 1, row + reachY); y++) {
      for (let x = Math.max(0, column - reachX); x <= Math.min(columns - 1, column + reachX); x++) {
        if (Math.hypot((x - column) * across, (y - row) * down) <= least) near[y * columns + x] = 1;
      }
    }
  });
  return (x, y) => near[Math.floor((y + 0.5) / down) * columns + Math.floor((x + 0.5) / across)] === 0;
}

const shareAt = ({ share, columns, rows }: Shares, x: number, y: number, { width, height }: Size): number =>
  sampled(share, columns, rows, ((x + 0.5) * columns) / width - 0.5, ((y + 0.5) * rows) / height - 0.5, 1, 0);

/** Blurred over neighbouring cells, 1 : 2 : 1 either way. */
function softened(values: Float32Array, columns: number, rows: number): Float32Array {
  return values.map((_, index) => {
    const [cell, part] = [index >> 1, index & 1];
    const [x, y] = [cell % columns, Math.floor(cell / columns)];
    let sum = 0;
    for (const [dx, dy, weight] of BLUR) {
      const [column, row] = [Math.min(columns - 1, Math.max(0, x + dx)), Math.min(rows - 1, Math.max(0, y + dy))];
      sum += weight * (values[2 * (row * columns + column) + part] ?? 0);
    }
    return sum;
  });
}

const BLUR = [-1, 0, 1].flatMap((dy) => [-1, 0, 1].map((dx) => [dx, dy, ((2 - Math.abs(dx)) * (2 - Math.abs(dy))) / 16] as const));
