/** Marks as pixels. */

import { getStroke } from "perfect-freehand";
import type { Mark, Stroke } from "./drawings";
import type { Place, Size } from "./geometry";
import { LastUsed } from "./last_used";

export type Context = CanvasRenderingContext2D | OffscreenCanvasRenderingContext2D;

/** Erased with: any opaque colour does. */
const OPAQUE = "#000";
/** How much a pen's pressure changes the width of a line; a mouse presses by half. */
const THINNING = 0.5;

/** Pixels of decoded pictures that are kept, of 4 bytes each. */
const MOST_PIXELS = 2 ** 26;

/** Image files in base64, decoded. */
const pictures = new LastUsed<ImageBitmap | OffscreenCanvas>(MOST_PIXELS, (picture) => {
  if ("close" in picture) picture.close();
});
const outlines = new WeakMap<Stroke, Path2D>();

/** A frame's size by a factor, so that what is drawn on small frames is not coarse. */
export const LONG_SIDE = 720;
export const scaleFor = ({ width, height }: Size): number => Math.max(1, Math.ceil(LONG_SIDE / Math.max(width, height)));

/** A transparent canvas for a frame, `scale` pixels for each of its own; reading it back is quick. */
export function blank({ width, height }: Size, scale: number): { canvas: OffscreenCanvas; context: OffscreenCanvasRenderingContext2D } {
  const canvas = new OffscreenCanvas(width * scale, height * scale);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  if (context === null) throw new Error("this browser gives no canvas");
  return { canvas, context };
}

/** Draws marks, whose pictures are decoded, on a canvas of `scale` pixels for each of the clip's. */
export function drawMarks(context: Context, marks: readonly Mark[], scale: number): void {
  context.save();
  context.setTransform(scale, 0, 0, scale, 0.5 * scale, 0.5 * scale);
  for (const mark of marks) {
    if (mark.kind === "picture") {
      const { at, size, source } = mark;
      const picture = pictures.get(source);
      if (picture) context.drawImage(picture, at.x - size.width / 2, at.y - size.height / 2, size.width, size.height);
      continue;
    }
    context.globalCompositeOperation = mark.ink === null ? "destination-out" : "source-over";
    context.fillStyle = mark.ink ?? OPAQUE;
    if (mark.kind === "text") {
      context.font = `600 ${mark.size}px system-ui, sans-serif`;
      context.textAlign = "center";
      context.textBaseline = "middle";
      context.fillText(mark.text, mark.at.x, mark.at.y);
    } else {
      context.fill(mark.kind === "stroke" ? outlineOf(mark) : polygon(mark.corners));
    }
    context.globalCompositeOperation = "source-over";
  }
  context.restore();
}

function outlineOf(stroke: Stroke): Path2D {
  const had = outlines.get(stroke);
  if (had !== undefined) return had;
  const options = { size: stroke.size, thinning: THINNING, smoothing: 0.5, streamline: 0.2, simulatePressure: false, last: true };
  const outline = getStroke(stroke.path.map((each) => [...each]), options).map(([x = 0, y = 0]) => ({ x, y }));
  const path = polygon(outline);
  outlines.set(stroke, path);
  return path;
}

function polygon(corners: readonly Place[]): Path2D {
  const path = new Path2D();
  for (const { x, y } of corners) path.lineTo(x, y);
  path.closePath();
  return path;
}

/** Whether all pictures among the marks are decoded; if not, they will be, and `onDecoded` hears of it. */
export function areDecoded(marks: readonly Mark[], onDecoded: () => void): boolean {
  const wanted = new Set(marks.flatMap((mark) => (mark.kind === "picture" ? [mark.source] : [])));
  const missing = [...wanted].filter((source) => pictures.get(source) === undefined);
  if (missing.length > 0) void Promise.all(missing.map((source) => decode(source, wanted))).then(onDecoded, () => undefined);
  return missing.length === 0;
}

/** Decodes an image file in base64 and returns its size; rejects where it is none. Those `besides` it stay decoded. */
export async function decode(source: string, besides?: ReadonlySet<string>): Promise<Size> {
  const picture = pictures.get(source) ?? (await createImageBitmap(new Blob([bytesOf(source)])));
  const { width, height } = picture;
  pictures.set(source, picture, besides);
  return { width, height };
}

/** Keeps what was already seen of a picture, so that it is not missing for a moment. */
export const keepDecoded = (source: string, canvas: OffscreenCanvas): unknown => pictures.set(source, canvas);

export function base64(bytes: Uint8Array): string {
  let text = "";
  for (let at = 0; at < bytes.length; at += 8192) text += String.fromCharCode(...bytes.subarray(at, at + 8192));
  return btoa(text);
}

export const bytesOf = (source: string): Uint8Array<ArrayBuffer> => Uint8Array.from(atob(source), (letter) => letter.charCodeAt(0));
