/** Asks where the pixels of frames were in the frames that were drawn on: coarse first, the frame shown before the others. */

import type { Size } from "./geometry";
import { rays } from "./layers";
import type { ModelFacts } from "./model/facts";
import type { Appearance, Tracked } from "./model/protocol";
import { type CarryMap, type Grid, SAME, type Shares, carryMap, shares } from "./warp";

/** Nodes along the longer side; frames not shown are asked for ahead up to `AHEAD_LEVEL`. */
const SIDES = [24, 64, 160] as const;
const AHEAD_LEVEL = 1;
/** Frames from the one shown on whose coarsest grid comes before a finer one of that. */
const PLAYED = 8;
const FINEST = SIDES.length - 1;
/** What the maps of all frames may take. */
const ROOM_BYTES = 96 * 2 ** 20;
const BYTES_PER_NODE = 12;
/** Nodes in one request, so that a click gets its turn. */
const NODES_PER_REQUEST = 512;

/** Asks of the model: where points of one frame are in others, and what is seen along rays. */
export interface Asked {
  carry(queries: Float32Array, targets: readonly number[]): Promise<Tracked>;
  render(queries: Float32Array): Promise<Appearance>;
}

/** What is needed of every frame. */
export interface Wanted {
  /** Frames that were drawn on. */
  readonly anchors: readonly number[];
  /** Whether it matters what is an object's. */
  readonly owners: boolean;
  /** Of the anchors those of which that must be known whatever frame is shown: masks were drawn on them. */
  readonly taught: readonly number[];
}

/** Nothing but whose the pixels are. */
const SHARES: Wanted = { anchors: [], owners: true, taught: [] };

interface Answer<T> {
  readonly level: number;
  readonly value: T;
}

/** Of one frame: maps by the frame drawn on, and shares. */
interface OfFrame {
  readonly maps: Map<number, Answer<CarryMap>>;
  shares: Answer<Shares> | undefined;
}

export function gridOf({ width, height }: Size, level: number): Grid {
  const scale = Math.min(1, (SIDES[level] ?? 1) / Math.max(width, height));
  return { columns: Math.max(1, Math.round(width * scale)), rows: Math.max(1, Math.round(height * scale)) };
}

export class Carrier {
  private readonly frames = new Map<number, OfFrame>();
  private wanted: Wanted = { anchors: [], owners: false, taught: [] };
  private shown = 0;
  private running = false;
  private closed = false;

  /** `onAnswer` hears of every frame of which more is known. */
  constructor(
    private readonly facts: ModelFacts,
    private readonly model: Asked,
    private readonly onAnswer: (frame: number) => void,
    private readonly onError: (error: unknown) => void,
  ) {}

  /** Says what is needed from now on, and which frame first. */
  want(shown: number, wanted: Wanted): void {
    this.shown = shown;
    if (!same(wanted, this.wanted)) this.wanted = wanted;
    if (!this.running && !this.closed && wanted.anchors.length > 0) void this.run();
  }

  /** The finest map so far of the pixels of `frame` to the frame `anchor`. */
  map(frame: number, anchor: number): CarryMap | undefined {
    return frame === anchor ? SAME : this.frames.get(frame)?.maps.get(anchor)?.value;
  }

  /** Whether there is a map, or there never will be: the model has failed. */
  isSettled(frame: number, anchor: number): boolean {
    return this.closed || this.map(frame, anchor) !== undefined;
  }

  shares(frame: number): Shares | undefined {
    return this.frames.get(frame)?.shares?.value;
  }

  /** Waits until all that is `wanted` of `frame` is known as finely as it ever is. */
  async wait(frame: number, wanted: Wanted): Promise<void> {
    for (const t of wanted.taught) await this.ask(t, AHEAD_LEVEL, SHARES, () => true);
    await this.ask(frame, FINEST, wanted, () => true);
  }

  close(): void {
    this.closed = true;
  }

  private async run(): Promise<void> {
    this.running = true;
    try {
      for (let work = this.next(); work !== undefined && !this.closed; work = this.next()) {
        const { frame, level, what } = work;
        const { shown, wanted } = this;
        await this.ask(frame, level, what, () => this.wanted === wanted && (level === 0 || this.shown === shown));
      }
    } catch (error) {
      if (!this.closed) this.onError(error);
      this.closed = true;
    } finally {
      this.running = false;
    }
  }

  /**
   * The frame shown, and coarsely the few after it, which playing waits for; then what masks were drawn on, that frame to
   * the finest level, and all after it, as many as are kept, up to `AHEAD_LEVEL`.
   */
  private next(): { frame: number; level: number; what: Wanted } | undefined {
    const { facts: { numFrames }, wanted: what } = this;
    for (let ahead = 0; ahead < Math.min(numFrames, PLAYED); ahead++) {
      const frame = (this.shown + ahead) % numFrames;
      if (this.lacks(frame, 0, what)) return { frame, level: 0, what };
    }
    for (const frame of this.wanted.taught) if (this.lacks(frame, AHEAD_LEVEL, SHARES)) return { frame, level: AHEAD_LEVEL, what: SHARES };
    for (const level of SIDES.keys()) if (this.lacks(this.shown, level, what)) return { frame: this.shown, level, what };
    const room = Math.min(numFrames, this.room());
    for (let level = 0; level <= AHEAD_LEVEL; level++) {
      for (let ahead = 1; ahead < room; ahead++) {
        const frame = (this.shown + ahead) % numFrames;
        if (this.lacks(frame, level, what)) return { frame, level, what };
      }
    }
    return undefined;
  }

  /** Frames whose maps are kept, were they all of the level that is asked for ahead. */
  private room(): number {
    const { columns, rows } = gridOf(this.facts, AHEAD_LEVEL);
    return Math.max(2, Math.floor(ROOM_BYTES / (BYTES_PER_NODE * columns * rows * (this.wanted.anchors.length + 1))) - 1);
  }

  private lacks(frame: number, level: number, wanted: Wanted): boolean {
    const { anchors, noShares } = this.missing(frame, level, wanted);
    return anchors.length > 0 || noShares;
  }

  private missing(frame: number, level: number, { anchors, owners }: Wanted): { anchors: number[]; noShares: boolean } {
    const had = this.frames.get(frame);
    return {
      anchors: anchors.filter((anchor) => anchor !== frame && (had?.maps.get(anchor)?.level ?? -1) < level),
      noShares: owners && (had?.shares?.level ?? -1) < level,
    };
  }

  /** Asks for what is missing of a frame; gives it up as soon as `goOn` says no. */
  private async ask(frame: number, level: number, wanted: Wanted, goOn: () => boolean): Promise<void> {
    const grid = gridOf(this.facts, level);
    const { anchors, noShares } = this.missing(frame, level, wanted);
    const count = grid.columns * grid.rows;
    const queries = rays(frame, { width: grid.columns, height: grid.rows }, this.facts, 0, count);
    const parts = anchors.map(() => ({ tracks: new Float32Array(2 * count), occlusion: new Float32Array(count) }));
    const still = new Float32Array(count);
    for (let first = 0; first < count && (anchors.length > 0 || noShares); first += NODES_PER_REQUEST) {
      const part = queries.slice(3 * first, 3 * (first + NODES_PER_REQUEST));
      if (anchors.length > 0) {
        const { tracks, occlusion } = await this.model.carry(part, anchors);
        occlusion.forEach((score, index) => {
          const [node, to] = [first + Math.floor(index / anchors.length), parts[index % anchors.length]];
          to?.tracks.set(tracks.subarray(2 * index, 2 * index + 2), 2 * node);
          to?.occlusion.fill(score, node, node + 1);
        });
      }
      if (noShares) still.set((await this.model.render(part)).static_confidence, first);
      if (this.closed || (first + NODES_PER_REQUEST < count && !goOn())) return;
    }
    const own = this.frames.get(frame) ?? { maps: new Map(), shares: undefined };
    this.frames.delete(frame); // to the end of the order in which they are dropped
    this.frames.set(frame, own);
    anchors.forEach((anchor, index) => {
      const { tracks = new Float32Array(), occlusion = new Float32Array() } = parts[index] ?? {};
      own.maps.set(anchor, { level, value: carryMap(grid, queries, tracks, occlusion, this.facts.occlusionThreshold) });
    });
    if (noShares) own.shares = { level, value: shares(grid, still) };
    this.dropOld();
    if (anchors.length > 0 || noShares) this.onAnswer(wanted === SHARES ? this.shown : frame);
  }

  private dropOld(): void {
    const nodes = ({ maps, shares: kept }: OfFrame): number =>
      [...maps.values(), ...(kept ? [kept] : [])].reduce((sum, { value }) => sum + value.columns * value.rows, 0);
    let total = [...this.frames.values()].reduce((sum, each) => sum + nodes(each), 0);
    for (const [frame, each] of this.frames) {
      if (total * BYTES_PER_NODE <= ROOM_BYTES || this.frames.size <= 2) break;
      if (frame === this.shown) continue;
      total -= nodes(each);
      if (this.wanted.taught.includes(frame)) {
        each.maps.clear();
        total += nodes(each);
      } else this.frames.delete(frame);
    }
  }
}

const same = (a: Wanted, b: Wanted): boolean =>
  a.owners === b.owners && a.anchors.join() === b.anchors.join() && a.taught.join() === b.taught.join();
