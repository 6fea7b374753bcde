/** Drawing: which layer is drawn on, what is on the way to it, and how all of them are in a frame. */

import { encode } from "fast-png";
import { Carrier } from "./carrier";
import type { Document } from "./document";
import { type Drawing, type Mark, type Owner, drawnFrames, freeLabel, marked, redrawn } from "./drawings";
import type { Model } from "./model/client";
import { InputError } from "./model/facts";
import { base64, blank, keepDecoded, scaleFor } from "./marks";
import { type Draft, type Painted, Painter } from "./painter";
import type { Tool } from "./ui/pen";

export class Sketch {
  /** The layer that is drawn on. */
  selected: number | undefined;
  /** What new layers belong to. */
  on: Owner = "seen";
  private carrier: Carrier | undefined;
  private painter: Painter | undefined;
  private model: Model | undefined;
  private draft: Draft | undefined;
  /** What the next mark is for, and what comes before it there. */
  private target: { drawing: Drawing; before: readonly Mark[] } | undefined;

  /** `onLook` hears that layers look different in a frame; undefined: in all. */
  constructor(
    private readonly document: Document,
    private readonly onLook: (frame?: number) => void,
    private readonly onError: (error: unknown) => void,
  ) {}

  /** Moves what is drawn by another model from now on. */
  use(model: Model): void {
    this.close();
    const carrier = new Carrier(model.facts, model, (frame) => this.onLook(frame), this.onError);
    Object.assign(this, { model, carrier, painter: new Painter(model.facts, scaleFor(model.facts), carrier, () => this.onLook()) });
  }

  close(): void {
    this.carrier?.close();
  }

  get drawing(): Drawing | undefined {
    return this.document.drawings.find(({ id }) => id === this.selected);
  }

  /** The layers as they are in `frame`, as far as is known; asks for what is not. */
  shown(frame: number): Painted[] {
    this.carrier?.want(frame, Painter.wanted(this.document.drawings));
    return this.painter?.painted(frame, this.document.drawings, this.draft) ?? [];
  }

  /** The layers as they are in `frame`, waited for; those of now, whatever is drawn meanwhile. */
  finished(drawings: readonly Drawing[] = this.document.drawings): (frame: number) => Promise<Painted[]> {
    const { carrier, painter } = this;
    return async (frame) => {
      await carrier?.wait(frame, Painter.wanted(drawings));
      return painter?.painted(frame, drawings) ?? [];
    };
  }

  /** True where playing need not wait for a frame. */
  isReady(frame: number): boolean {
    return this.painter?.isReady(frame, this.document.drawings) ?? true;
  }

  /** What was drawn of a layer over frame t, in the clip's pixels or, where they are few, in finer ones. */
  sheet({ marks }: Drawing, t: number, scale?: number): OffscreenCanvas | undefined {
    return this.painter?.sheet(marks, t, scale);
  }

  /** Decides what the next mark is for; `InputError` where nothing can be drawn there. */
  begin(tool: Tool, t: number): void {
    const own = this.drawing;
    if (own !== undefined && !own.shown) throw new InputError(`${own.name} is not shown; show it, or select another layer, to draw.`);
    if (own?.kind === "mask") {
      if (tool === "text" || tool === "picture") throw new InputError(`${own.name} is a mask: draw it with the brush, the eraser, a polygon or a box.`);
      this.target = { drawing: own, before: this.carriedBase(own, t) };
      return;
    }
    const fits = own !== undefined && own.marks.every((mark) => mark.t === t);
    if (!fits && tool === "eraser") {
      const where = own === undefined ? "Select a layer to erase of." : `${own.name} was drawn over frame ${drawnFrames(own).join(", ")}; go there to erase of it.`;
      throw new InputError(where);
    }
    this.target = { drawing: fits ? own : this.document.newDrawing("paint", this.on), before: [] };
  }

  /** Shows a mark that is not done; undefined: none is. */
  sketch(mark: Mark | undefined): void {
    const { target } = this;
    this.draft = mark && target && { drawing: target.drawing, marks: [...target.before, mark] };
    this.onLook();
  }

  /** Adds a mark to the layer that it was begun on. */
  mark(mark: Mark): void {
    const { target } = this;
    this.draft = this.target = undefined;
    if (target === undefined) return;
    this.selected = target.drawing.id;
    this.document.change((content) => marked(content, target.drawing, [...target.before, mark]));
  }

  /** Says what new layers belong to, and the one that is drawn on where it is empty yet. */
  drawOn(owner: Owner): void {
    this.on = owner;
    const { drawing } = this;
    if (drawing?.kind === "paint" && drawing.marks.length === 0) this.document.change((content) => redrawn(content, drawing.id, { on: owner }));
  }

  /** Puts an empty layer on top, and draws on it from now on. */
  add(kind: Drawing["kind"]): void {
    const drawing = this.document.newDrawing(kind, kind === "mask" ? "seen" : this.on);
    this.selected = drawing.id;
    this.document.change((content) => marked(content, drawing, []));
  }

  /** The layers of a project, to be put on top; a mask whose number one that is there has gets another. */
  layersOf(drawings: readonly Omit<Drawing, "id">[]): Drawing[] {
    const masks = (all: readonly Omit<Drawing, "id">[]): number[] => all.filter(({ kind }) => kind === "mask").map(({ label }) => label);
    const there = masks(this.document.drawings);
    const taken = [...there, ...masks(drawings)];
    const labelOf = ({ kind, label }: Omit<Drawing, "id">): number => {
      if (kind !== "mask" || !there.includes(label)) return label;
      const free = freeLabel(taken);
      taken.push(free);
      return free;
    };
    return drawings.map((each) => this.document.newDrawing(each.kind, each.on, { ...each, label: labelOf(each) }));
  }

  /** Takes masks over frame t from labels, each pixel's object or 0: of the objects that are there, that is their mask now. Returns how many, and the names of those that were drawn there before. */
  addMasks(labels: ArrayLike<number>, t: number): { added: number; replaced: string[] } {
    const objects = [...new Set(Array.from(labels))].filter((label) => label > 0).sort((a, b) => a - b);
    const replaced = this.document.drawings
      .filter(({ kind, label, marks }) => kind === "mask" && objects.includes(label) && marks.some((mark) => mark.t === t))
      .map(({ name }) => name);
    this.document.change((content) =>
      objects.reduce((left, label) => {
        const there = left.drawings.find((each) => each.kind === "mask" && each.label === label);
        const to = there ?? { ...this.document.newDrawing("mask", "seen"), label, name: `Object ${label}` };
        const cleared = redrawn(left, to.id, { marks: to.marks.filter((mark) => mark.t !== t) });
        const alpha = Uint8Array.from(labels, (each) => (each === label ? 255 : 0));
        this.selected = to.id;
        return marked(cleared, to, [this.pictureOf(alpha, t)]);
      }, content),
    );
    return { added: objects.length, replaced };
  }

  /** A mask that is corrected in a frame begins as it was carried there. */
  private carriedBase(mask: Drawing, t: number): readonly Mark[] {
    if (mask.marks.length === 0 || mask.marks.some((mark) => mark.t === t)) return [];
    const { carrier, painter } = this;
    const frames = drawnFrames(mask);
    const isKnown = frames.every((each) => carrier?.map(t, each)) && [t, ...frames].every((each) => carrier?.shares(each));
    if (painter === undefined || !isKnown) throw new InputError(`${mask.name} is still being followed to this frame; draw in a moment.`);
    return [this.pictureOf(painter.carriedMask(t, mask), t)];
  }

  private pictureOf(alpha: Uint8Array, t: number): Mark {
    const { width, height } = this.model?.facts ?? { width: 1, height: 1 };
    const data = new Uint8Array(2 * alpha.length);
    const { canvas, context } = blank({ width, height }, 1);
    const pixels = new ImageData(width, height);
    alpha.forEach((value, index) => {
      data.set([255, value], 2 * index);
      pixels.data.set([255, 255, 255, value], 4 * index);
    });
    context.putImageData(pixels, 0, 0);
    const source = base64(encode({ width, height, data, channels: 2, depth: 8 }));
    keepDecoded(source, canvas);
    return { kind: "picture", t, at: { x: (width - 1) / 2, y: (height - 1) / 2 }, size: { width, height }, source };
  }
}
