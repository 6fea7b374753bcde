/** What the user did, and nothing else: one content with one history. What follows from it, tracks above all, is derived. */

import { type Drawing, freeLabel, withoutDrawing } from "./drawings";
import type { Place } from "./geometry";

/** A query: the point seen at (x, y) of frame t. */
export interface Query extends Place {
  readonly t: number;
}

export interface Point extends Query {
  readonly id: number;
  readonly name: string;
  /** `#rrggbb` */
  readonly colour: string;
}

/** Where the user says that a point is in frame t; null: it is hidden there. */
export interface Given {
  readonly t: number;
  readonly place: Place | null;
}

/** One given of the point with the id `point`; of a point there is one in a frame. */
export interface Correction extends Given {
  readonly point: number;
}

/** What an imported file may say about a point beside its query. */
export interface Draft extends Query {
  readonly name?: string;
  readonly colour?: string;
  readonly given?: readonly Given[];
}

export interface Content {
  readonly points: readonly Point[];
  /** By points, in the order of the list, and frames. */
  readonly corrections: readonly Correction[];
  /** The last lies on top. */
  readonly drawings: readonly Drawing[];
}

/** Something that the user asked for and that is not in the content yet: a model answers, or a file is read. */
export type Coming = symbol;

/** What is work of the hand. */
const PARTS = ["corrections", "drawings"] as const;

const EMPTY: Content = { points: [], corrections: [], drawings: [] };

/** The content, and the way back: each change is one step that can be undone. */
export class Document {
  private readonly past: Content[] = [];
  private readonly future: Content[] = [];
  /** What was asked for last is last. */
  private readonly coming = new Set<Coming>();
  private current = EMPTY;
  /** What would be there again from a file. */
  private kept: Pick<Content, "corrections" | "drawings"> = EMPTY;
  private lastId = 0;
  private lastDrawing = 0;

  constructor(private readonly onChange: () => void = () => {}) {}

  get content(): Content {
    return this.current;
  }

  get points(): readonly Point[] {
    return this.current.points;
  }

  get corrections(): readonly Correction[] {
    return this.current.corrections;
  }

  get drawings(): readonly Drawing[] {
    return this.current.drawings;
  }

  get canUndo(): boolean {
    return this.past.length > 0 || this.coming.size > 0;
  }

  get canRedo(): boolean {
    return this.future.length > 0;
  }

  /** Whether work of the hand, which corrections and drawings are, would be lost with the page. */
  get isUnsaved(): boolean {
    return PARTS.some((part) => this.isUnsavedIn(part));
  }

  private isUnsavedIn(part: (typeof PARTS)[number]): boolean {
    return this.current[part].length > 0 && this.current[part] !== this.kept[part];
  }

  /** A part of it is in a file now. */
  keep(...parts: readonly (typeof PARTS)[number][]): void {
    for (const part of parts) this.kept = { ...this.kept, [part]: this.current[part] };
  }

  /** The points of now, and those that undo and redo can bring. */
  everyPoint(): readonly Point[] {
    return [...this.past, this.current, ...this.future].flatMap(({ points }) => points);
  }

  /** A new layer, which is not there before a change puts it there. */
  newDrawing(kind: Drawing["kind"], on: Drawing["on"], given: Partial<Omit<Drawing, "id" | "kind" | "on">> = {}): Drawing {
    const id = ++this.lastDrawing;
    const label = kind === "mask" ? freeLabel(this.drawings.map((each) => each.label)) : 0;
    return { id, name: `${kind === "mask" ? "Mask" : "Layer"} ${id}`, kind, on, shown: true, colour: colourOf(id), label, marks: [], ...given };
  }

  /** Changes the content as one step; none where nothing changes. */
  change(step: (content: Content) => Content): void {
    const next = step(this.current);
    if (next === this.current) return;
    this.past.push(this.current);
    this.future.length = 0;
    this.current = next;
    this.onChange();
  }

  /** Something is on its way into the content. Until it arrives it is what `undo` takes back: it came after all that is there. */
  expect(): Coming {
    const coming = Symbol();
    this.coming.add(coming);
    this.onChange();
    return coming;
  }

  /** Whether it is still wanted: false once it was taken back, or another model was opened. */
  isExpected(coming: Coming): boolean {
    return this.coming.has(coming);
  }

  /** It is there, and may be put into the content at once; false where it is not wanted any more. */
  arrive(coming: Coming): boolean {
    return this.coming.delete(coming);
  }

  /** It will not come, if it has not. */
  giveUp(coming: Coming): void {
    if (this.arrive(coming)) this.onChange();
  }

  /**
   * Adds points, what is given of them, and layers on top as one step; returns the points that are new. A nameless draft
   * with givens is the point of the list that has its query, where there is one. Givens and layers are from a file: they
   * are as unsaved as what was there before.
   */
  add(drafts: readonly Draft[], layers: readonly Drawing[] = []): readonly Point[] {
    const added: Point[] = [];
    const corrections: Correction[] = [];
    for (const draft of drafts) {
      const joined = draft.name === undefined && draft.given !== undefined ? this.points.find((point) => sameQuery(point, draft)) : undefined;
      const point = joined ?? this.named(draft);
      if (joined === undefined) added.push(point);
      corrections.push(...(draft.given ?? []).map((given) => ({ ...given, point: point.id })));
    }
    const saved = PARTS.filter((part) => !this.isUnsavedIn(part));
    this.change((content) => {
      const drawings = layers.length > 0 ? [...content.drawings, ...layers] : content.drawings;
      return corrections.reduce(corrected, { ...content, drawings, points: [...content.points, ...added] });
    });
    this.keep(...saved);
    return added;
  }

  /** Takes back what is on its way, the last first, or else the last step. */
  undo(): void {
    const last = [...this.coming].at(-1);
    if (last === undefined) this.step(this.past, this.future);
    else this.giveUp(last);
  }

  redo(): void {
    this.step(this.future, this.past);
  }

  /** Removes points, what is given of them, and layers as if they had never been added. */
  forget(points: readonly Point[], layers: readonly Drawing[] = []): void {
    const withoutPoints = (content: Content): Content => points.reduce((left, { id }) => withoutPoint(left, id), content);
    const without = (content: Content): Content => layers.reduce((left, { id }) => withoutDrawing(left, id), withoutPoints(content));
    for (const contents of [this.past, this.future]) contents.forEach((content, step) => (contents[step] = without(content)));
    this.current = without(this.current);
    this.onChange();
  }

  /** Forgets all, history included: another model was opened. */
  reset(): void {
    this.past.length = this.future.length = 0;
    this.coming.clear();
    this.current = EMPTY;
    this.lastId = this.lastDrawing = 0;
    this.onChange();
  }

  private named({ t, x, y, name, colour }: Draft): Point {
    const id = ++this.lastId;
    return { id, name: name ?? `Point ${id}`, colour: colour ?? colourOf(id), t, x, y };
  }

  private step(from: Content[], to: Content[]): void {
    const next = from.pop();
    if (next === undefined) return;
    to.push(this.current);
    this.current = next;
    this.onChange();
  }
}

export const changed = (content: Content, id: number, part: Partial<Omit<Point, "id">>): Content => ({
  ...content,
  points: content.points.map((point) => (point.id === id ? { ...point, ...part } : point)),
});

export const withoutPoint = ({ points, corrections, ...others }: Content, id: number): Content => ({
  ...others,
  points: points.filter((point) => point.id !== id),
  corrections: corrections.filter(({ point }) => point !== id),
});

/** With `correction` in place of what was said of that point and frame. */
export function corrected(content: Content, correction: Correction): Content {
  const others = withoutCorrection(content, correction).corrections;
  const place = new Map(content.points.map(({ id }, index) => [id, index]));
  const order = (a: Correction, b: Correction): number => (place.get(a.point) ?? 0) - (place.get(b.point) ?? 0) || a.t - b.t;
  return { ...content, corrections: [...others, correction].sort(order) };
}

export function withoutCorrection(content: Content, { point, t }: Pick<Correction, "point" | "t">): Content {
  const corrections = content.corrections.filter((each) => each.point !== point || each.t !== t);
  return corrections.length === content.corrections.length ? content : { ...content, corrections };
}

export const withoutPoints = (content: Content): Content => ({ ...content, points: [], corrections: [] });

export const withoutCorrections = (content: Content): Content => ({ ...content, corrections: [] });

const sameQuery = (a: Query, b: Query): boolean => a.t === b.t && a.x === b.x && a.y === b.y;

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
