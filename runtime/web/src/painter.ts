/** What of the drawings is to be seen in a frame. */

import type { Carrier, Wanted } from "./carrier";
import { type Drawing, type Mark, drawnFrames } from "./drawings";
import type { Size } from "./geometry";
import { areDecoded, blank, drawMarks } from "./marks";
import { type Looks, looksOf } from "./looks";
import { sceneMap } from "./scene_map";
import { removeSpecks } from "./specks";
import { type CarryMap, type Cel, SAME, type Shares, type Warped, boundsOf, warp } from "./warp";

/** A layer in one frame: `scale` pixels of its canvas for each of the clip's, from (left, top) of that canvas's on. */
export interface Painted {
  readonly canvas: OffscreenCanvas;
  readonly left: number;
  readonly top: number;
  readonly scale: number;
  readonly alpha: number;
}

/** What is being drawn, and not yet in the document. */
export interface Draft {
  readonly drawing: Drawing;
  /** After those that the layer has. */
  readonly marks: readonly Mark[];
}

const MASK_ALPHA = 0.55;

/** What the marks of a layer make of one frame that was drawn on. */
interface Sheet {
  readonly canvas: OffscreenCanvas;
  /** Read when first moved. */
  cel: Cel | undefined;
}

/** How a layer looked in the frame in which it was last asked for, and from what that follows. */
interface Kept {
  readonly frame: number;
  readonly maps: readonly (CarryMap | undefined)[];
  readonly shares: readonly (Shares | undefined)[];
  readonly painted: Painted | undefined;
}

export class Painter {
  private readonly sheets = new WeakMap<readonly Mark[], Map<string, Sheet>>();
  private readonly kept = new WeakMap<Drawing, Kept>();

  constructor(
    private readonly image: Size,
    private readonly scale: number,
    private readonly carrier: Carrier,
    private readonly onDecoded: () => void,
  ) {}

  /** The layers that are shown, as they are in `frame`, as far as the model has answered; the last on top. */
  painted(frame: number, drawings: readonly Drawing[], draft?: Draft): Painted[] {
    return withDraft(drawings, draft)
      .filter(({ shown }) => shown)
      .flatMap((drawing) => this.layer(frame, drawing, draft) ?? []);
  }

  /** What the model must be asked for. */
  static wanted(drawings: readonly Drawing[]): Wanted {
    const shown = drawings.filter(({ shown, marks }) => shown && marks.length > 0);
    const anchors = [...new Set(shown.flatMap(drawnFrames))].sort((a, b) => a - b);
    const masks = [...new Set(shown.filter(({ kind }) => kind === "mask").flatMap(drawnFrames))];
    return { anchors, taught: masks, owners: masks.length > 0 || shown.some(({ on }) => on !== "seen") };
  }

  /** Whether something can be shown of each layer in `frame`. */
  isReady(frame: number, drawings: readonly Drawing[]): boolean {
    return Painter.wanted(drawings).anchors.every((anchor) => this.carrier.isSettled(frame, anchor));
  }

  /** What was drawn over frame t, with `scale` pixels for each of the clip's. */
  sheet(marks: readonly Mark[], t: number, scale = this.scale): OffscreenCanvas {
    return this.sheetOf(marks, t, scale).canvas;
  }

  /** A mask in `frame`, with one pixel for each of the clip's: 255 where it is. */
  carriedMask(frame: number, { marks }: Drawing): Uint8Array {
    const { width, height } = this.image;
    const alpha = new Uint8Array(width * height);
    const { pixels, left, top } = this.carried(frame, marks, 1) ?? { pixels: undefined, left: 0, top: 0 };
    for (let row = 0; pixels && row < pixels.height; row++) {
      for (let column = 0; column < pixels.width; column++) {
        if ((pixels.data[4 * (row * pixels.width + column) + 3] ?? 0) > 127) alpha[(top + row) * width + left + column] = 255;
      }
    }
    return alpha;
  }

  private layer(frame: number, drawing: Drawing, draft: Draft | undefined): Painted | undefined {
    const own = draft?.drawing.id === drawing.id && draft.marks.some(({ t }) => t === frame) ? draft.marks : undefined;
    const { marks, kind } = drawing;
    const frames = drawnFrames(drawing);
    const owner = kind === "paint" && drawing.on !== "seen" ? this.carrier.shares(frame) : undefined;
    const shares = kind === "mask" ? [frame, ...frames].map((t) => this.carrier.shares(t)) : [owner];
    const maps = frames.map((t) => this.carrier.map(frame, t));
    const kept = this.kept.get(drawing);
    if (own === undefined && kept?.frame === frame && same(shares, kept.shares) && same(maps, kept.maps)) return kept.painted;
    const alpha = kind === "mask" ? MASK_ALPHA : 1;
    const atOwn = marks.some(({ t }) => t === frame);
    let painted: Painted | undefined;
    if (own !== undefined || (atOwn && owner === undefined)) {
      const sheet = this.sheet(marks, frame);
      const canvas = own === undefined && kind === "paint" ? sheet : this.drawnOn(sheet, own ?? [], kind === "mask" ? drawing.colour : undefined);
      painted = { canvas, left: 0, top: 0, scale: this.scale, alpha };
    } else {
      const owned = owner && { shares: owner, moving: drawing.on === "dynamic" };
      const warped = kind === "mask" ? this.carried(frame, marks, this.scale) : this.warped(frame, marks, this.scale, owned);
      painted = warped && { ...this.onCanvas(warped, kind === "mask" ? drawing.colour : undefined), scale: this.scale, alpha };
    }
    const finished = own === undefined && areDecoded(marks, this.onDecoded);
    if (finished) this.kept.set(drawing, { frame, maps, shares, painted });
    return painted;
  }

  /** A copy of a sheet with more marks, all in one colour where one is given. */
  private drawnOn(sheet: OffscreenCanvas, more: readonly Mark[], colour: string | undefined): OffscreenCanvas {
    const { canvas, context } = blank(this.image, this.scale);
    context.drawImage(sheet, 0, 0);
    drawMarks(context, more, this.scale);
    if (colour !== undefined) tint(context, colour);
    return canvas;
  }

  private onCanvas({ pixels, left, top }: Warped, colour: string | undefined): Pick<Painted, "canvas" | "left" | "top"> {
    const { canvas, context } = blank(pixels, 1);
    context.putImageData(pixels, 0, 0);
    if (colour !== undefined) tint(context, colour);
    return { canvas, left, top };
  }

  /** The marks of a mask; where they are not in sight, by its looks, once these are known. */
  private carried(frame: number, marks: readonly Mark[], scale: number): Warped | undefined {
    const warped = this.warped(frame, marks, scale, undefined, this.looks(frame, marks, scale));
    if (warped !== undefined) removeSpecks(warped.pixels);
    return warped;
  }

  private looks(frame: number, marks: readonly Mark[], scale: number): Looks | undefined {
    const shares = this.carrier.shares(frame);
    if (shares === undefined) return undefined;
    const taught = [...new Set(marks.map(({ t }) => t))].map((t) => {
      const known = this.carrier.shares(t);
      return known && { cel: this.celOf(this.sheetOf(marks, t, scale), scale), shares: known };
    });
    const all = taught.filter((each) => each !== undefined);
    return all.length === taught.length ? looksOf(all, shares, this.image) : undefined;
  }

  /** The marks of all frames that were drawn on, the nearest in time first. */
  private warped(frame: number, marks: readonly Mark[], scale: number, owned?: { shares: Shares; moving: boolean }, looks?: Looks): Warped | undefined {
    const frames = [...new Set(marks.map(({ t }) => t))].sort((a, b) => Math.abs(a - frame) - Math.abs(b - frame));
    const sources = frames.flatMap((t) => {
      const seen = this.carrier.map(frame, t);
      if (seen === undefined) return [];
      const map = owned === undefined || owned.moving || seen === SAME ? seen : sceneMap(seen, owned.shares, this.image);
      return [{ map, cel: this.celOf(this.sheetOf(marks, t, scale), scale) }];
    });
    return warp(sources, this.image, owned, looks);
  }

  private celOf(sheet: Sheet, scale: number): Cel {
    if (sheet.cel !== undefined) return sheet.cel;
    const { canvas } = sheet;
    const pixels = canvas.getContext("2d")?.getImageData(0, 0, canvas.width, canvas.height) ?? new ImageData(1, 1);
    sheet.cel = { pixels, scale, bounds: boundsOf(pixels) };
    return sheet.cel;
  }

  private sheetOf(marks: readonly Mark[], t: number, scale: number): Sheet {
    const ofMarks = this.sheets.get(marks) ?? new Map<string, Sheet>();
    const key = `${t} ${scale}`;
    const had = ofMarks.get(key);
    if (had !== undefined) return had;
    const { canvas, context } = blank(this.image, scale);
    const own = marks.filter((mark) => mark.t === t);
    drawMarks(context, own, scale);
    const sheet = { canvas, cel: undefined };
    if (!areDecoded(own, this.onDecoded)) return sheet;
    ofMarks.set(key, sheet);
    this.sheets.set(marks, ofMarks);
    return sheet;
  }
}

const same = (some: readonly unknown[], others: readonly unknown[]): boolean =>
  some.length === others.length && some.every((each, index) => each === others[index]);

/** Gives all that is there one colour. */
function tint(context: OffscreenCanvasRenderingContext2D, colour: string): void {
  context.globalCompositeOperation = "source-in";
  context.fillStyle = colour;
  context.fillRect(0, 0, context.canvas.width, context.canvas.height);
  context.globalCompositeOperation = "source-over";
}

const withDraft = (drawings: readonly Drawing[], draft: Draft | undefined): readonly Drawing[] =>
  draft === undefined || drawings.some(({ id }) => id === draft.drawing.id) ? drawings : [...drawings, draft.drawing];
