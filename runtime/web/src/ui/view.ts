/** The page's controls: what they show, and what they set going. */

import type { App } from "../app";
import { SIDES } from "../comparison";
import { withoutCorrections, withoutPoints } from "../document";
import type { Layer } from "../layers";
import { LAYERS } from "../layers";
import type { Model } from "../model/client";
import { InputError } from "../model/facts";
import { summary, warning } from "../model/quality";
import type { Pictures } from "../pictures";
import { element, make } from "./dom";
import { ErrorPanel } from "./errors";
import { Pen } from "./pen";
import { Stage } from "./stage";
import { Tools } from "./tools";

const NO_SPLIT = "nothing";
const WHAT_IT_SHOWS: Readonly<Record<Layer, string>> = {
  clip: "The clip's own frames",
  fused: "What the model renders: the scene and what moves, together",
  static: "The scene alone, as the model has it; chequered where it was never seen",
  dynamic: "What moves alone, as the model has it",
  mask: "White moves",
  depth: "White is near; the model's own measure, not metres",
};
/** As in the style sheet. */
const SMALL = "(max-width: 56rem)";
const PLACING = "Click where the point belongs in this frame, or move the cross there and press Enter; Escape gives up.";

export class View {
  readonly list = element("points", HTMLOListElement);
  readonly corrections = element("corrections", HTMLOListElement);
  readonly drawings = element("drawings", HTMLOListElement);
  readonly pen = new Pen({
    onBegin: (tool, t) => {
      this.app?.pauseAt(t); // it may stand in for another
      this.app?.sketch.begin(tool, t);
    },
    onDraft: (mark) => this.app?.sketch.sketch(mark),
    onMark: (mark) => this.app?.sketch.mark(mark),
  });
  readonly stage: Stage;
  private readonly tools = new Tools(this.pen, this);
  private app: App | undefined;
  private readonly errors = new ErrorPanel();
  private readonly scrub = element("scrub", HTMLInputElement);
  private readonly splitSelect = element("split", HTMLSelectElement);
  private readonly divider = element("divider", HTMLInputElement);
  private readonly trails = element("trails", HTMLInputElement);
  private readonly spacing = element("spacing", HTMLInputElement);
  private readonly layerButtons = new Map<Layer, HTMLInputElement>();

  constructor() {
    this.stage = new Stage(element("stage", HTMLCanvasElement), element("frame", HTMLDivElement), {
      onClick: (place, t, id) => (id === undefined ? this.attempt(this.app?.addAt(place, t)) : this.app?.select(id)),
      onArea: (polygon, t) => this.attempt(this.app?.addArea(polygon, t, Math.max(1, this.spacing.valueAsNumber || 16))),
      onHold: (id, placing) => {
        this.app?.hold(id);
        if (placing) this.status(PLACING);
      },
      onPlaced: () => this.status(""),
      onCorrect: (id, place, t) => this.attempt(this.app?.correct(id, place, t)),
      onPress: (place, pressure, t) => {
        try {
          this.pen.press(place, pressure, t);
        } catch (error) {
          this.alert(error);
        }
      },
    }, this.pen);
    for (const layer of LAYERS) {
      const button = make("input", { type: "radio", name: "layer", value: layer, disabled: true });
      this.layerButtons.set(layer, button);
      const title = layer[0]?.toUpperCase() + layer.slice(1);
      element("layers", HTMLFieldSetElement).append(make("label", { title: WHAT_IT_SHOWS[layer] }, button, make("span", {}, title)));
    }
    const small = matchMedia(SMALL);
    const fold = (): boolean => (element("looks", HTMLDetailsElement).open = !small.matches);
    small.addEventListener("change", fold);
    fold();
    this.splitSelect.append(...[NO_SPLIT, ...LAYERS].map((value) => make("option", { value }, value)));
  }

  /** Wires the controls to what they control. */
  connect(app: App): void {
    this.app = app;
    this.tools.connect(app);
    for (const [layer, button] of this.layerButtons) button.addEventListener("change", () => app.showLayer(layer));
    this.splitSelect.addEventListener("change", () => app.showSplit(LAYERS.find((layer) => layer === this.splitSelect.value)));
    this.divider.addEventListener("input", () => {
      app.pictures.splitAt = this.divider.valueAsNumber;
      app.show();
    });
    this.scrub.addEventListener("input", () => app.player.seek(this.scrub.valueAsNumber));
    this.trails.addEventListener("input", () => {
      app.trail = this.trails.valueAsNumber;
      this.showTrail(app.trail);
      app.show();
    });
    for (const radio of document.querySelectorAll<HTMLInputElement>("input[name=drag]")) {
      radio.addEventListener("change", () => (this.stage.shape = radio.value === "lasso" ? "lasso" : "box"));
    }
    const onClick = (id: string, action: () => void): void =>
      element(id, HTMLButtonElement).addEventListener("click", () => this.attempt(Promise.resolve().then(action)));
    this.errors.connect(app);
    onClick("play", () => app.player.toggle());
    onClick("previous", () => app.player.step(-1));
    onClick("next", () => app.player.step(1));
    onClick("undo", () => app.document.undo());
    onClick("redo", () => app.document.redo());
    onClick("clear", () => app.document.change(withoutPoints));
    onClick("place", () => {
      this.tools.choose("points");
      this.stage.place();
    });
    onClick("mark-hidden", () => app.mark(true));
    onClick("mark-seen", () => app.mark(false));
    onClick("clear-corrections", () => app.document.change(withoutCorrections));
    for (const side of SIDES) {
      const radio = element(`side-${side}`, HTMLInputElement);
      radio.addEventListener("change", () => app.showSide(side));
    }
    onClick("help", () => element("keys", HTMLDialogElement).showModal());
    element("alert", HTMLDivElement).querySelector("button")?.addEventListener("click", () => this.dismiss());
    this.content(app);
  }

  /** Says what is open, and how it runs. */
  facts(model: Model, hasClip: boolean): void {
    const { clipName, numFrames, width, height, preset, quality } = model.facts;
    const count = model.windows.length;
    const windows = count > 1 ? ` in ${count} windows` : "";
    const threads = `${model.threads} thread${model.threads === 1 ? "" : "s"}`;
    const layers = model.backend === "webgpu" ? ", layers on WebGPU" : "";
    element("facts", HTMLParagraphElement).textContent =
      `${clipName} · ${numFrames} frames of ${width}×${height}${windows} · preset ${preset} · WebAssembly, ${threads}${layers}` +
      (hasClip ? "" : " · without its clip");
    const said = quality && warning(quality);
    const details = element("quality", HTMLDetailsElement);
    details.hidden = quality === undefined;
    const [what] = said?.split(":") ?? [];
    details.querySelector("summary")?.replaceChildren(what === undefined ? "How good the fit is" : make("strong", {}, asSentence(what)));
    details.querySelector("p")?.replaceChildren(
      quality ? asSentence((count > 1 ? "in the worst window, " : "") + summary(quality)) : "",
      ...(said === undefined ? [] : [" ", make("strong", {}, asSentence(`${said}; fit for longer with decomo-train --resume`))]),
    );
    document.title = `${clipName} · DecoMotion`;
  }

  /** Shows what a model, and perhaps its clip, bring. */
  opened(model: Model, hasClip: boolean): void {
    const { numFrames, width, height } = model.facts;
    this.facts(model, hasClip);
    this.stage.setImage(model.facts);
    this.tools.setImage(model.facts);
    this.scrub.max = String(numFrames - 1);
    this.trails.max = String(numFrames - 1);
    if (this.app === undefined) return;
    this.trails.value = String(this.app.trail);
    this.showTrail(this.app.trail);
    this.spacing.value = String(Math.max(4, Math.round(Math.max(width, height) / 16)));
    this.layers(LAYERS, this.app.pictures);
    this.errors.opened(this.app);
  }

  layers(all: readonly Layer[], pictures: Pictures): void {
    for (const layer of all) {
      const button = this.layerButtons.get(layer);
      if (button) Object.assign(button, { disabled: !pictures.available(layer), checked: layer === pictures.layer });
    }
    for (const option of this.splitSelect.options) {
      option.disabled = !LAYERS.every((layer) => layer !== option.value || pictures.available(layer));
    }
    this.splitSelect.value = pictures.split ?? NO_SPLIT;
    element("looks-said", HTMLSpanElement).textContent = [pictures.layer, pictures.split ?? []].flat().join(" and ");
    this.divider.hidden = pictures.split === undefined;
  }

  /** `shown`: the frame that stands in for one whose pictures are still to come, or the same. */
  showFrame({ followed, selected, player: { frame, playing } }: App, numFrames: number, shown: number): void {
    const picture = element("frame", HTMLDivElement);
    picture.ariaBusy = String(shown !== frame);
    picture.dataset.shown = String(shown);
    this.errors.showFrame(followed.find(({ id }) => id === selected), frame);
    this.scrub.value = String(frame);
    this.scrub.ariaValueText = `frame ${frame} of 0 to ${numFrames - 1}`;
    element("frame-number", HTMLOutputElement).value = `${frame} / ${numFrames - 1}`;
    const play = element("play", HTMLButtonElement);
    play.ariaPressed = String(playing);
    play.ariaLabel = playing ? "Pause" : "Play";
  }

  /** `unfinished`: some are still being followed, and none can be saved. */
  content(app: App, unfinished = false): void {
    const { document: { points, corrections, drawings, canUndo, canRedo }, selected } = app;
    this.errors.update(app);
    const count = points.length;
    element("count", HTMLSpanElement).textContent = String(count);
    element("no-points", HTMLParagraphElement).hidden = count > 0;
    element("undo", HTMLButtonElement).disabled = !canUndo;
    element("redo", HTMLButtonElement).disabled = !canRedo;
    element("clear", HTMLButtonElement).disabled = count === 0;
    this.tools.content(drawings);
    this.drawOn(app);
    element("save", HTMLFieldSetElement).disabled = (count === 0 && drawings.length === 0) || unfinished;
    for (const button of document.querySelectorAll<HTMLButtonElement>("[data-of=points]")) button.disabled = count === 0;
    element("correction-count", HTMLSpanElement).textContent = String(corrections.length);
    element("no-corrections", HTMLParagraphElement).hidden = corrections.length > 0;
    element("no-refit", HTMLParagraphElement).hidden = corrections.length === 0 || !element("refit", HTMLDivElement).hidden;
    for (const id of ["clear-corrections", "save-corrections"]) element(id, HTMLButtonElement).disabled = corrections.length === 0;
    for (const id of ["place", "mark-hidden", "mark-seen"]) element(id, HTMLButtonElement).disabled = selected === undefined;
  }

  /** Shows the controls of what is drawn on. */
  drawOn({ sketch }: App): void {
    this.tools.drawOn(sketch.drawing?.kind);
  }

  loading(text: string | undefined): void {
    const loading = element("loading", HTMLParagraphElement);
    loading.hidden = text === undefined;
    loading.textContent = text ?? "";
  }

  status(text: string): void {
    element("status", HTMLParagraphElement).textContent = text;
  }

  answered(text: string, milliseconds: number): void {
    this.status(text);
    element("status", HTMLParagraphElement).dataset.milliseconds = milliseconds.toFixed(1);
    this.dismiss();
  }

  /** Shows what went wrong, until it is dismissed. */
  alert(error: unknown): void {
    const text = error instanceof Error ? error.message : String(error);
    const known = error instanceof InputError;
    const box = element("alert", HTMLDivElement);
    const paragraph = box.querySelector("p");
    if (paragraph) paragraph.textContent = known ? text : `Something went wrong: ${text}`;
    box.hidden = false;
    if (!known) console.error(error);
  }

  dismiss(): void {
    element("alert", HTMLDivElement).hidden = true;
  }

  /** Shows the error of work that goes on in the background. */
  attempt(work: Promise<unknown> | undefined): void {
    work?.catch((error: unknown) => this.alert(error));
  }

  private showTrail(trail: number): void {
    element("trail-length", HTMLOutputElement).value = trail === 0 ? "none" : `${trail} frame${trail === 1 ? "" : "s"}`;
  }
}

const asSentence = (text: string): string => `${text[0]?.toUpperCase()}${text.slice(1)}.`;
