/** The panel that refits: a button, progress, and a verdict on the new model. */

import type { App } from "../app";
import { correctionsCsv } from "../files/write";
import type { Files } from "../model/client";
import { type RefitState, Refits } from "../refit";
import { misses } from "../tracks";
import { element } from "./dom";
import type { View } from "./view";

export class RefitPanel {
  private state: RefitState | undefined;
  /** While the new model is being opened nothing is asked of it. */
  private opening = false;
  /** While `decomo-view` has not answered to a click. */
  private asking = false;
  /** States are shown one after the other. */
  private turn: Promise<void> = Promise.resolve();
  private readonly button = element("refit-begin", HTMLButtonElement);

  constructor(
    private readonly app: App,
    view: View,
    refits: Refits,
    private readonly files: Files,
  ) {
    element("refit", HTMLDivElement).hidden = false;
    const inTurn = (state: RefitState): Promise<void> => {
      const shown = this.turn.then(() => this.show(state));
      this.turn = shown.catch(() => undefined);
      return shown;
    };
    const onClick = (id: string, action: () => Promise<RefitState>): void =>
      element(id, HTMLButtonElement).addEventListener("click", () => {
        if (this.asking) return; // a second click, of a double one
        this.asking = true;
        view.attempt(action().finally(() => (this.asking = false)).then(inTurn));
      });
    onClick("refit-begin", () => refits.begin(correctionsCsv(app.document.content)));
    onClick("refit-cancel", () => refits.cancel());
    onClick("refit-take", () => refits.decide("take", this.state?.number ?? 0));
    onClick("refit-reject", () => refits.decide("reject", this.state?.number ?? 0));
    app.onContent = () => this.showContent();
    const onLost = (error: Error): void => {
      this.state = undefined;
      this.showContent();
      element("refit-running", HTMLDivElement).hidden = true;
      element("refit-said", HTMLParagraphElement).textContent = error.message;
    };
    void refits.watch((state) => view.attempt(inTurn(state)), onLost);
  }

  private async show(state: RefitState): Promise<void> {
    if (state.number < (this.state?.number ?? 0)) return; // an answer that was overtaken
    this.state = state;
    const running = state.state === "running";
    element("refit-running", HTMLDivElement).hidden = !running;
    const progress = element("refit-progress", HTMLProgressElement);
    if (state.share === null) progress.removeAttribute("value");
    else progress.value = state.share;
    const said = element("refit-said", HTMLParagraphElement);
    said.textContent = hasModel(state) ? "Opening the new model …" : sentence(state);
    this.opening = true;
    this.showContent();
    try {
      if (this.isServed) await this.follow(state); // else another model was opened: nothing to compare with
    } finally {
      this.opening = false;
      said.textContent = sentence(state);
      this.showContent();
    }
  }

  /** Brings the models that are open up to the state. */
  private async follow(refit: RefitState): Promise<void> {
    const { state, model } = refit;
    if (model !== null && hasModel(refit)) await this.app.openCandidate(model, this.files);
    if (state === "taken") await this.app.takeCandidate();
    else if (state !== "finished" && this.app.comparison.candidate !== undefined) this.app.comparison.drop();
  }

  /** Whether the model that is open is one of `decomo-view`'s own. */
  private get isServed(): boolean {
    return this.app.files === this.files;
  }

  /** What a refit does, or why there can be none now. */
  private why(corrections: number): string {
    if (!this.isServed) return "Another model is open: only the one that decomo-view was started with is refitted.";
    if (corrections === 0) return "Correct a track first: a refit teaches the model what you say, in a minute or two, and its neighbours move along.";
    return "Teaches the model what you say, in a minute or two; neighbours move along. Then you compare, and take the new model or not.";
  }

  /** What follows from the document and the candidate. */
  private showContent(): void {
    const { app, state } = this;
    const busy = state === undefined || state.state === "running" || state.state === "finished";
    this.button.disabled = busy || !this.isServed || app.document.corrections.length === 0;
    const why = element("refit-why", HTMLParagraphElement);
    why.hidden = busy;
    why.textContent = this.why(app.document.corrections.length);
    element("refit-verdict", HTMLDivElement).hidden = state?.state !== "finished" || this.opening || !this.isServed;
    element(`side-${app.comparison.side}`, HTMLInputElement).checked = true;
    element("refit-figures", HTMLParagraphElement).textContent = app.comparison.candidate ? figures(app) : "";
  }
}

/** Whether its model is one to be opened, if it is not: another tab may have taken it. */
const hasModel = ({ state }: RefitState): boolean => state === "finished" || state === "taken";

function sentence({ state, said, run, file }: RefitState): string {
  if (state === "running" || state === "failed") return said;
  if (state === "cancelled") return "Cancelled; nothing was left behind.";
  if (state === "finished") return "In colour the new model's tracks, thin and white the old one's. Play, look, then take the new model or reject it.";
  if (state === "taken") return `Taken: the run is ${run}, its model ${file}.`;
  if (state === "rejected") return `Rejected; the run is still there: ${run}.`;
  return "";
}

/** How far both models miss the given places, and how far the other points have moved, each by its mean. */
function figures(app: App): string {
  const [old, refitted] = [app.followed, app.comparison.followed()];
  const parts = [];
  const [before, after] = [old, refitted].map((side) => median(side.flatMap(({ answer, given }) => misses(answer, given))));
  if (before !== undefined && after !== undefined) parts.push(`Given places are missed by ${px(after)}, before by ${px(before)}.`);
  const left = new Map(old.filter(({ given }) => given.length === 0).map((each) => [each.id, each.answer]));
  const moves = refitted.flatMap(({ id, answer }) => {
    const was = left.get(id)?.xy;
    if (was === undefined) return [];
    const total = answer.occluded.reduce((sum, _, frame) => sum + apart(answer.xy, was, frame), 0);
    return [total / answer.occluded.length];
  });
  const moved = median(moves);
  if (moved !== undefined) parts.push(`The other points move by ${px(moved)}.`);
  return `${parts.join(" ")}${parts.length > 0 ? " (Medians.)" : ""}`;
}

const apart = (a: Float32Array, b: Float32Array, frame: number): number =>
  Math.hypot((a[2 * frame] ?? 0) - (b[2 * frame] ?? 0), (a[2 * frame + 1] ?? 0) - (b[2 * frame + 1] ?? 0));

function median(values: readonly number[]): number | undefined {
  const known = values.filter(Number.isFinite).sort((a, b) => a - b);
  return known[Math.floor(known.length / 2)];
}

const px = (value: number): string => `${value.toFixed(value < 10 ? 1 : 0)} px`;
