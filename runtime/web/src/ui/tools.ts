/** The controls of drawing: the tool, its colour and size, and new layers. */

import type { App } from "../app";
import { type Drawing, OWNERS } from "../drawings";
import { contentOf } from "../files/content";
import { frameInName, readLabels } from "../files/labels";
import type { Size } from "../geometry";
import { InputError } from "../model/facts";
import { base64, decode } from "../marks";
import { element, enable, make } from "./dom";
import { type Pen, TOOLS, type Tool } from "./pen";

/** Of a picture's file: it goes into the project. */
const MOST_BYTES = 16 * 2 ** 20;
/** As in the page: of lines and letters, in pixels of the clip. */
const MOST_SIZE = 999;

const HINTS: Readonly<Record<Tool, string>> = {
  points: "Click a pixel to follow it; drag an area for many points; drag a point to where it belongs.",
  brush: "Drag to draw: it moves with what it is drawn on, in all frames.",
  eraser: "Drag to erase of the layer that is selected in the list.",
  polygon: "Drag an outline, or click corners, the last one twice.",
  box: "Drag a box: it is filled.",
  text: "Write the text above, then click where its middle belongs.",
  picture: "Choose a picture, then click, or drag to say how large.",
};

/** Says what was done, and shows what goes wrong. */
interface Alerts {
  attempt(work: Promise<unknown> | undefined): void;
  status(text: string): void;
}

export class Tools {
  private readonly colour = element("draw-colour", HTMLInputElement);
  private readonly size = element("draw-size", HTMLInputElement);
  private readonly text = element("draw-text", HTMLInputElement);
  private readonly on = element("draw-on", HTMLSelectElement);
  private readonly picture = element("picture-file", HTMLInputElement);
  private readonly mask = element("mask-file", HTMLInputElement);
  private readonly radios = new Map<Tool, HTMLInputElement>();
  /** Of the layer that is drawn on. */
  private kind: Drawing["kind"] | undefined;
  /** Files are taken one after the other: of two the second is put over the first. */
  private turn: Promise<void> = Promise.resolve();

  constructor(
    private readonly pen: Pen,
    private readonly alerts: Alerts,
  ) {
    for (const tool of TOOLS) {
      const radio = make("input", { type: "radio", name: "tool", value: tool, checked: tool === pen.tool });
      radio.addEventListener("change", () => this.choose(tool));
      this.radios.set(tool, radio);
      element("tools", HTMLFieldSetElement).append(make("label", {}, radio, make("span", {}, `${tool[0]?.toUpperCase()}${tool.slice(1)}`)));
    }
    this.colour.addEventListener("input", () => (pen.colour = this.colour.value));
    this.size.addEventListener("input", () => (pen.size = Math.min(MOST_SIZE, Math.max(1, this.size.valueAsNumber || 1))));
    this.text.addEventListener("input", () => (pen.text = this.text.value));
    this.choose(pen.tool);
  }

  connect(app: App): void {
    const { sketch } = app;
    this.on.addEventListener("change", () => sketch.drawOn(OWNERS.find((owner) => owner === this.on.value) ?? "seen"));
    const onClick = (id: string, action: () => void): void => element(id, HTMLButtonElement).addEventListener("click", action);
    onClick("new-layer", () => this.begin(() => sketch.add("paint")));
    onClick("new-mask", () => this.begin(() => sketch.add("mask")));
    onClick("load-mask", () => {
      app.pauseAt(app.pictures.nearest(app.player.frame)); // it may stand in for another
      this.mask.click();
    });
    onClick("draw-picture", () => this.picture.click());
    this.picture.addEventListener("change", () => this.take(this.picture, (file, turn) => this.openPicture(file, turn)));
    this.mask.addEventListener("change", () => this.take(this.mask, (file, turn) => this.openMask(file, app, turn)));
  }

  /** Fits the width of lines to another clip. */
  setImage({ width, height }: Size): void {
    this.pen.size = Math.max(1, Math.round(Math.max(width, height) / 60));
    this.size.value = String(this.pen.size);
  }

  content(drawings: readonly Drawing[]): void {
    element("drawing-count", HTMLSpanElement).textContent = String(drawings.length);
    element("no-drawings", HTMLParagraphElement).hidden = drawings.length > 0;
    const has = (kind: Drawing["kind"]): boolean => drawings.some((each) => each.kind === kind && each.marks.length > 0);
    for (const button of document.querySelectorAll<HTMLButtonElement>("[data-of=paint]")) enable(button, has("paint"));
    for (const button of document.querySelectorAll<HTMLButtonElement>("[data-of=mask]")) enable(button, has("mask"));
  }

  /** Takes up a tool. */
  choose(tool: Tool): void {
    this.pen.cancel();
    this.pen.tool = tool;
    const radio = this.radios.get(tool);
    if (radio) radio.checked = true;
    this.showFields();
    const [hint] = element("hint", HTMLParagraphElement).childNodes;
    if (hint) hint.textContent = HINTS[tool];
  }

  /** Draws on a layer of that kind; undefined: on a new one. */
  drawOn(kind: Drawing["kind"] | undefined): void {
    if (kind === this.kind) return;
    this.kind = kind;
    this.showFields();
  }

  /** What the tool needs to know of a layer of paint, or of a mask, which has its own colour. */
  private showFields(): void {
    const { tool } = this.pen;
    const paints = this.kind !== "mask";
    const shown = {
      "draw-colour": paints && !["points", "eraser", "picture"].includes(tool),
      "draw-size": ["brush", "eraser", "text"].includes(tool),
      "draw-text": tool === "text",
      "draw-on": paints && tool !== "points" && tool !== "eraser",
    };
    for (const [id, is] of Object.entries(shown)) element(`${id}-field`, HTMLLabelElement).hidden = !is;
    element("draw-picture", HTMLButtonElement).hidden = tool !== "picture";
  }

  /** Makes a layer, and takes the brush to it. */
  private begin(make: () => void): void {
    make();
    if (!this.pen.isOut) this.choose("brush");
  }

  /** `open` waits for `turn` before it puts the file anywhere. */
  private take(input: HTMLInputElement, open: (file: File, turn: Promise<void>) => Promise<void>): void {
    const [file] = input.files ?? [];
    input.value = "";
    if (file === undefined) return;
    const opened = open(file, this.turn);
    this.turn = opened.catch(() => undefined);
    this.alerts.attempt(opened);
  }

  /** Over the frame that the file's name tells, or that was shown when it was chosen. */
  private async openMask(file: File, app: App, turn: Promise<void>): Promise<void> {
    const { name } = file;
    const facts = app.model?.facts;
    if (facts === undefined) throw new InputError("Open a model before a mask.");
    const shown = app.player.frame;
    const coming = app.document.expect();
    try {
      const [bytes] = await Promise.all([contentOf(file, name), turn]);
      const labels = readLabels(name, bytes, facts);
      const named = frameInName(name, facts.numFrames) ?? { t: shown, sure: true };
      if (!app.document.isExpected(coming)) return;
      const t = named.sure || named.t === shown ? named.t : await askFrame(name, named.t, shown);
      if (t === undefined || !app.document.arrive(coming)) return;
      const { added, replaced } = app.sketch.addMasks(labels, t);
      app.pauseAt(t);
      const instead = replaced.length > 0 ? `, in place of what was drawn there of ${replaced.join(", ")}; Undo brings it back` : "";
      this.alerts.status(`${name}: ${added === 1 ? "a mask" : `${added} masks`} over frame ${t}${instead}.`);
    } finally {
      app.document.giveUp(coming);
    }
  }

  private async openPicture(file: File, turn: Promise<void>): Promise<void> {
    if (file.size > MOST_BYTES) throw new InputError(`${file.name} has more than ${MOST_BYTES / 2 ** 20} MB; make it smaller.`);
    const source = base64(await contentOf(file, file.name));
    const size = await decode(source).catch(() => {
      throw new InputError(`${file.name} does not decode as an image; give a PNG, JPEG or WebP.`);
    });
    await turn;
    this.pen.picture = { ...size, source };
    element("draw-picture", HTMLButtonElement).textContent = file.name;
  }
}

/** Asks whether a mask is of the frame that its name may tell, or of the one that is shown; undefined: of none. */
function askFrame(name: string, named: number, shown: number): Promise<number | undefined> {
  const dialog = element("mask-frame", HTMLDialogElement);
  element("mask-frame-file", HTMLParagraphElement).textContent = name;
  element("mask-frame-named", HTMLButtonElement).textContent = `Frame ${named}, by its name`;
  element("mask-frame-shown", HTMLButtonElement).textContent = `Frame ${shown}, shown now`;
  dialog.returnValue = ""; // what Escape leaves
  dialog.showModal();
  return new Promise((resolve) => {
    const frames: Record<string, number> = { named, shown };
    dialog.addEventListener("close", () => resolve(frames[dialog.returnValue]), { once: true });
  });
}
