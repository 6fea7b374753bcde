/** Points and their tracks, and the history of the list. */

/** Where one point is in every frame of the clip. */
export interface Track {
  /** [T, 2], (x, y) in pixels of the clip, pixel centres at integers; NaN in frames that are not answered yet. */
  readonly xy: Float32Array;
  /** [T], score in [0, 1]. */
  readonly occlusion: Float32Array;
  /** [T], true where the score is above the model's threshold. */
  readonly occluded: readonly boolean[];
}

/** A query: the point seen at (x, y) of frame t. */
export interface Query {
  readonly t: number;
  readonly x: number;
  readonly y: number;
}

export interface Point extends Query {
  readonly id: number;
  readonly name: string;
  /** `#rrggbb` */
  readonly colour: string;
  readonly track: Track;
}

/** What an imported file may say about a point beside its query. */
export interface Draft extends Query {
  readonly name?: string;
  readonly colour?: string;
}

/** The list of points; each change is one step that can be undone. */
export class PointList {
  private readonly past: (readonly Point[])[] = [];
  private readonly future: (readonly Point[])[] = [];
  private current: readonly Point[] = [];
  private lastId = 0;

  constructor(private readonly onChange: () => void = () => {}) {}

  get all(): readonly Point[] {
    return this.current;
  }

  get canUndo(): boolean {
    return this.past.length > 0;
  }

  get canRedo(): boolean {
    return this.future.length > 0;
  }

  /** Adds points with their tracks as one step and returns them. */
  add(drafts: readonly Draft[], tracks: readonly Track[]): readonly Point[] {
    const added = drafts.map((draft, index) => {
      const id = ++this.lastId;
      const track = tracks[index];
      if (track === undefined) throw new RangeError("a track for each point");
      return { id, name: draft.name ?? `Point ${id}`, colour: draft.colour ?? colourOf(id), ...queryOf(draft), track };
    });
    this.commit([...this.current, ...added]);
    return added;
  }

  /** Gives each of `points` another track, as if it had always been so. */
  retrack(points: readonly Point[], tracks: readonly Track[]): void {
    const found = new Map(points.map(({ id }, index) => [id, tracks[index]]));
    this.rewrite((all) =>
      all.map((point) => {
        const track = found.get(point.id);
        return track ? { ...point, track } : point;
      }),
    );
  }

  /** Removes points as if they had never been added. */
  forget(points: readonly Point[]): void {
    const gone = new Set(points.map(({ id }) => id));
    this.rewrite((all) => all.filter(({ id }) => !gone.has(id)));
  }

  change(id: number, part: Partial<Pick<Point, "name" | "colour">>): void {
    this.commit(this.current.map((point) => (point.id === id ? { ...point, ...part } : point)));
  }

  remove(id: number): void {
    this.commit(this.current.filter((point) => point.id !== id));
  }

  clear(): void {
    this.commit([]);
  }

  undo(): void {
    this.step(this.past, this.future);
  }

  redo(): void {
    this.step(this.future, this.past);
  }

  /** Forgets all, history included: another model was opened. */
  reset(): void {
    this.past.length = this.future.length = 0;
    this.current = [];
    this.lastId = 0;
    this.onChange();
  }

  /** Changes the list, past and future ones too. */
  private rewrite(change: (all: readonly Point[]) => readonly Point[]): void {
    for (const lists of [this.past, this.future]) lists.forEach((points, step) => (lists[step] = change(points)));
    this.current = change(this.current);
    this.onChange();
  }

  private commit(next: readonly Point[]): void {
    this.past.push(this.current);
    this.future.length = 0;
    this.current = next;
    this.onChange();
  }

  private step(from: (readonly Point[])[], to: (readonly Point[])[]): void {
    const next = from.pop();
    if (next === undefined) return;
    to.push(this.current);
    this.current = next;
    this.onChange();
  }
}

const queryOf = ({ t, x, y }: Query): Query => ({ t, x, y });

/** Cuts the answer for N queries, `tracks` [N, T, 2] and `occlusion` [N, T], into one track a query. */
export function splitTracks(tracks: Float32Array, occlusion: Float32Array, numFrames: number, threshold: number): Track[] {
  return Array.from({ length: occlusion.length / numFrames }, (_, row) => {
    const scores = occlusion.slice(row * numFrames, (row + 1) * numFrames);
    return {
      xy: tracks.slice(row * numFrames * 2, (row + 1) * numFrames * 2),
      occlusion: scores,
      occluded: Array.from(scores, (score) => score > threshold),
    };
  });
}

/** Runs of frames with one state: `begin` up to but without `end`. */
export function spans(occluded: readonly boolean[]): { begin: number; end: number; occluded: boolean }[] {
  const runs: { begin: number; end: number; occluded: boolean }[] = [];
  occluded.forEach((hidden, frame) => {
    const last = runs.at(-1);
    if (last?.occluded === hidden) last.end = frame + 1;
    else runs.push({ begin: frame, end: frame + 1, occluded: hidden });
  });
  return runs;
}

const GOLDEN_ANGLE = 137.508;
const FIRST_HUE = 205;

/** `#rrggbb`; neighbours in the list lie far apart on the wheel. */
export function colourOf(id: number): string {
  const hue = (FIRST_HUE + id * GOLDEN_ANGLE) % 360;
  const channel = (offset: number): string => {
    const k = (offset + hue / 30) % 12;
    const value = 0.6 - 0.36 * Math.max(-1, Math.min(k - 3, 9 - k, 1)); // hsl(hue 90% 60%)
    return Math.round(255 * value).toString(16).padStart(2, "0");
  };
  return `#${channel(0)}${channel(8)}${channel(4)}`;
}
