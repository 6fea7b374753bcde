/** Points: asked of the open model, and put into the document, moved or corrected there. */

import { type Document, type Draft, type Point, changed, corrected } from "./document";
import type { Drawing } from "./drawings";
import { type Place, clampPlace, gridCells, gridInside, roundPlace } from "./geometry";
import type { Model } from "./model/client";
import { InputError } from "./model/facts";
import type { Tracked } from "./model/protocol";
import { Answers, type Followed, splitTracks } from "./tracks";

const MOST_POINTS_AT_ONCE = 400;
/** Of a grid's box, most of which a lasso may leave out. */
const MOST_CELLS = 100 * MOST_POINTS_AT_ONCE;

export interface FollowingEvents {
  /** More is known of points, or fewer are on the way. */
  onAnswers(): void;
  /** The first of some new points is on the list. */
  onAdded(id: number): void;
  /** What goes on. */
  onProgress(text: string): void;
}

export class Following {
  model: Model | undefined;
  private answers = new Answers();
  /** Askings whose points are on the list while more of their tracks is to come. */
  private unfinished = 0;
  /** What goes on, to be waited for. */
  private readonly askings = new Set<Promise<unknown>>();
  private lastMove = 0;
  /** By the ids of points, the last move that was made. */
  private readonly moves = new Map<number, number>();

  constructor(
    private readonly document: Document,
    private readonly events: FollowingEvents,
  ) {}

  get isUnfinished(): boolean {
    return this.unfinished > 0;
  }

  /** Whether a model is being asked for points. */
  get isAsking(): boolean {
    return this.askings.size > 0;
  }

  /** Waits until all that was asked for is there. */
  async settled(): Promise<void> {
    while (this.isAsking) await Promise.allSettled(this.askings);
  }

  /** Asks another model from now on, whose `answers` may be known in part. */
  use(model: Model, answers: Answers): void {
    Object.assign(this, { model, answers });
  }

  /** The points of the document with the tracks that the model gives them. */
  followed(): readonly Followed[] {
    return this.answers.follow(this.document.content);
  }

  /**
   * Asks the model for the tracks of `drafts` and puts the points on the list, as one step: as soon as the first window
   * has answered, and with more of their tracks as the others do; with the first of them the `layers` of their file. Returns
   * what is to be said of it, and how long it took; undefined where it was taken back, or another model opened, meanwhile.
   */
  add(drafts: readonly Draft[], layers?: () => readonly Drawing[]): Promise<{ found: string; milliseconds: number } | undefined> {
    return this.noted(this.addNow(drafts, layers));
  }

  private noted<T>(asking: Promise<T>): Promise<T> {
    const done = (): boolean => this.askings.delete(asking);
    this.askings.add(asking);
    asking.then(done, done);
    return asking;
  }

  private async addNow(drafts: readonly Draft[], layers: () => readonly Drawing[] = () => []): Promise<{ found: string; milliseconds: number } | undefined> {
    const { model } = this;
    if (model === undefined || drafts.length === 0) return undefined;
    const { numFrames, occlusionThreshold } = model.facts;
    const start = performance.now();
    const what = drafts.length === 1 ? "the point" : `${drafts.length} points`;
    const coming = this.document.expect();
    let begun = false;
    const onProgress = (share: number): void => {
      if (share < 1 && model === this.model && (begun || this.document.isExpected(coming))) this.events.onProgress(`Following ${what} … ${Math.round(100 * share)} %`);
    };
    // A refitted model was taken meanwhile: what the document waits for is asked of that one.
    const again = (): ReturnType<Following["add"]> | undefined => (this.document.isExpected(coming) ? this.addNow(drafts, layers) : undefined);
    let added: readonly Point[] = [];
    let drawn: readonly Drawing[] = [];
    const onPart = (part: Tracked): void => {
      if (model !== this.model || (!begun && !this.document.arrive(coming))) return;
      this.answers.set(drafts, splitTracks(part, drafts, model.facts));
      if (begun) return this.events.onAnswers();
      begun = true;
      this.unfinished++;
      drawn = layers();
      added = this.document.add(drafts, drawn);
      const [first] = added;
      if (first !== undefined) this.events.onAdded(first.id);
    };
    let answer: Tracked;
    try {
      answer = await model.track(queriesOf(drafts), onProgress, onPart);
      if (model !== this.model) return again();
    } catch (error) {
      if (model !== this.model) return again();
      this.document.forget(added, drawn);
      throw error;
    } finally {
      this.document.giveUp(coming);
      if (begun) this.unfinished--;
      this.events.onAnswers();
    }
    const [first] = added;
    if (first === undefined) {
      this.events.onProgress(""); // nothing goes on any more
      return undefined;
    }
    const seen = answer.occlusion.filter((score) => score <= occlusionThreshold).length;
    const found =
      added.length === 1
        ? `${first.name} at (${first.x}, ${first.y}) of frame ${first.t}: in sight in ${seen} of ${numFrames} frames`
        : `${added.length} points in ${numFrames} frames`;
    return { found, milliseconds: performance.now() - start };
  }

  /** A grid of points in `polygon` of frame t, `spacing` pixels apart; `InputError` where these are too many, or none. */
  grid(polygon: readonly Place[], t: number, spacing: number): Draft[] {
    if (this.model === undefined) return [];
    const { facts } = this.model;
    if (gridCells(polygon, spacing, facts) > MOST_CELLS) {
      throw new InputError(`That area holds far more than ${MOST_POINTS_AT_ONCE} points; raise the spacing.`);
    }
    const places = gridInside(polygon, spacing, facts);
    if (places.length === 0) throw new InputError("No point fits in so small an area; draw a larger one or lessen the spacing.");
    if (places.length > MOST_POINTS_AT_ONCE) {
      throw new InputError(`That area holds ${places.length} points, more than ${MOST_POINTS_AT_ONCE}; raise the spacing.`);
    }
    return places.map((place) => ({ t, ...place }));
  }

  /**
   * Says that a point is at `place` in frame t; in the frame in which it was placed, it is placed there instead. False where
   * that was taken back meanwhile.
   */
  async correct(point: Point, place: Place, t: number): Promise<boolean> {
    if (t === point.t) return this.noted(this.move(point, place));
    this.document.change((content) => corrected(content, { point: point.id, t, place }));
    return true;
  }

  /** Says that a point is hidden in frame t, or in sight where it is shown; `InputError` in the frame in which it was placed. */
  mark(point: Followed, t: number, hidden: boolean): void {
    if (this.model === undefined) return;
    if (point.t === t) throw new InputError(`${point.name} was placed in frame ${t}: it is in sight there. Mark it in another frame.`);
    const [x = Number.NaN, y = Number.NaN] = point.track.xy.subarray(2 * t, 2 * t + 2);
    if (Number.isNaN(x)) throw new InputError(`${point.name} is still being followed to frame ${t}; mark it in a moment.`);
    const shown = roundPlace(clampPlace({ x, y }, this.model.facts));
    this.document.change((content) => corrected(content, { point: point.id, t, place: hidden ? null : shown }));
  }

  /** Places a point elsewhere in its own frame, and follows it from there; of two moves the later one holds. */
  private async move({ id, t }: Point, place: Place): Promise<boolean> {
    const { model } = this;
    if (model === undefined) return false;
    const number = ++this.lastMove;
    const query = { t, ...place };
    const coming = this.document.expect();
    try {
      if (this.answers.get(query) === undefined) {
        const answer = await model.track(queriesOf([query]));
        if (model !== this.model) return false;
        this.answers.set([query], splitTracks(answer, [query], model.facts));
      }
      const isThere = this.document.points.some((point) => point.id === id);
      if (!isThere || number < (this.moves.get(id) ?? 0) || !this.document.arrive(coming)) return false;
      this.moves.set(id, number);
      this.document.change((content) => changed(content, id, place));
      return true;
    } finally {
      this.document.giveUp(coming);
    }
  }
}

export const queriesOf = (queries: readonly Draft[]): Float32Array => Float32Array.from(queries.flatMap(({ t, x, y }) => [t, x, y]));
