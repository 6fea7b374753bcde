/** Points: asked of the open model, and put into the document, moved or corrected there. */

import { type Document, type Draft, type Point, changed, corrected } from "./document";
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

  constructor(
    private readonly document: Document,
    private readonly events: FollowingEvents,
  ) {}

  get isUnfinished(): boolean {
    return this.unfinished > 0;
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
   * has answered, and with more of their tracks as the others do. Returns what is to be said of it, and how long it took;
   * undefined where another model was opened meanwhile.
   */
  async add(drafts: readonly Draft[]): Promise<{ found: string; milliseconds: number } | undefined> {
    const { model } = this;
    if (model === undefined || drafts.length === 0) return undefined;
    const { numFrames, occlusionThreshold } = model.facts;
    const start = performance.now();
    const what = drafts.length === 1 ? "the point" : `${drafts.length} points`;
    const onProgress = (share: number): void => {
      if (share < 1 && model === this.model) this.events.onProgress(`Following ${what} … ${Math.round(100 * share)} %`);
    };
    let begun = false;
    let added: readonly Point[] = [];
    const onPart = (part: Tracked): void => {
      if (model !== this.model) return;
      this.answers.set(drafts, splitTracks(part, drafts, model.facts));
      if (begun) return this.events.onAnswers();
      begun = true;
      this.unfinished++;
      added = this.document.add(drafts);
      const [first] = added;
      if (first !== undefined) this.events.onAdded(first.id);
    };
    let answer: Tracked;
    try {
      answer = await model.track(queriesOf(drafts), onProgress, onPart);
    } catch (error) {
      if (model !== this.model) return undefined;
      this.document.forget(added);
      throw error;
    } finally {
      if (begun) this.unfinished--;
      this.events.onAnswers();
    }
    const [first] = added;
    if (first === undefined || model !== this.model) return undefined;
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

  /** Says that a point is at `place` in frame t; in the frame in which it was placed, it is placed there instead. */
  async correct(point: Point, place: Place, t: number): Promise<void> {
    if (t === point.t) await this.move(point, place);
    else this.document.change((content) => corrected(content, { point: point.id, t, place }));
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

  /** Places a point elsewhere in its own frame, and follows it from there. */
  private async move({ id, t }: Point, place: Place): Promise<void> {
    const { model } = this;
    if (model === undefined) return;
    const query = { t, ...place };
    if (this.answers.get(query) === undefined) {
      const answer = await model.track(queriesOf([query]));
      if (model !== this.model) return;
      this.answers.set([query], splitTracks(answer, [query], model.facts));
    }
    this.document.change((content) => changed(content, id, place));
  }
}

export const queriesOf = (queries: readonly Draft[]): Float32Array => Float32Array.from(queries.flatMap(({ t, x, y }) => [t, x, y]));
