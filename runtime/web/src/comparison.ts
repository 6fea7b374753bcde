/** A refitted model beside the one that is open: asked for the same points, and shown with the old one until a verdict. */

import type { Document } from "./document";
import type { Scene } from "./draw";
import { queriesOf } from "./following";
import { type Files, Model } from "./model/client";
import { InputError } from "./model/facts";
import { Answers, type Followed, splitTracks } from "./tracks";

/** What is shown while a refitted model waits for a verdict. */
export const SIDES = ["old", "both", "new"] as const;
export type Side = (typeof SIDES)[number];

export interface Candidate {
  readonly path: string;
  readonly model: Model;
  readonly answers: Answers;
}

export class Comparison {
  candidate: Candidate | undefined;
  side: Side = "both";

  constructor(
    private readonly document: Document,
    private readonly onChange: () => void,
  ) {}

  /** Opens a refitted model of the clip of `beside` and asks it for all points. */
  async open(path: string, files: Files, beside: () => Model | undefined): Promise<void> {
    if (path === this.candidate?.path) return;
    const [model, old] = [await Model.open(path, files), beside()];
    if (old === undefined || !sameClip(model, old)) {
      model.close();
      throw new InputError(`${path} is not a model of the clip that is open; start 'decomo-view' again.`);
    }
    this.drop();
    this.candidate = { path, model, answers: new Answers() };
    this.onChange();
    await this.complete();
  }

  /** Asks the refitted model for what it has not answered yet, of points that undo and redo can bring too. */
  async complete(): Promise<void> {
    const { candidate } = this;
    while (candidate !== undefined) {
      const missing = this.document.everyPoint().filter((point) => candidate.answers.get(point) === undefined);
      if (missing.length === 0) return;
      const answer = await candidate.model.track(queriesOf(missing)).catch((error: unknown) => {
        if (candidate === this.candidate) throw error;
      });
      if (answer === undefined || candidate !== this.candidate) return;
      candidate.answers.set(missing, splitTracks(answer, missing, candidate.model.facts));
      this.onChange();
    }
  }

  /** Gives the refitted model away, all points answered; undefined where there is none. */
  async take(): Promise<Candidate | undefined> {
    await this.complete();
    const { candidate } = this;
    this.candidate = undefined;
    return candidate;
  }

  drop(): void {
    this.candidate?.model.close();
    this.candidate = undefined;
    this.onChange();
  }

  /** The points of the document with the tracks that the refitted model gives them. */
  followed(): readonly Followed[] {
    return this.candidate?.answers.follow(this.document.content) ?? [];
  }

  /** While a refitted model waits: what the models answer, the track that is compared with as a ghost. */
  shown(old: readonly Followed[]): Pick<Scene, "points" | "ghosts"> {
    if (this.candidate === undefined) return { points: old, ghosts: [] };
    const plain = (all: readonly Followed[]): readonly Followed[] => all.map((each) => ({ ...each, track: each.answer }));
    if (this.side === "old") return { points: plain(old), ghosts: [] };
    return { points: plain(this.followed()), ghosts: this.side === "both" ? plain(old) : [] };
  }
}

const sameClip = ({ facts: a }: Model, { facts: b }: Model): boolean =>
  a.numFrames === b.numFrames && a.width === b.width && a.height === b.height;
