/** What the user drew: layers of marks over frames, as part of the document. How they look elsewhere is derived. */

import type { Content } from "./document";
import type { Place, Size } from "./geometry";

/** What a drawing belongs to, as `decomo-render --on`: whatever is seen, or the scene or the moving objects alone. */
export const OWNERS = ["seen", "static", "dynamic"] as const;
export type Owner = (typeof OWNERS)[number];

/** `#rrggbb`; null erases. */
export type Ink = string | null;

/** A line of the brush: (x, y, pressure) in pixels of the clip, pressure in [0, 1]; `size` is its width. */
export interface Stroke {
  readonly kind: "stroke";
  readonly t: number;
  readonly ink: Ink;
  readonly size: number;
  readonly path: readonly (readonly [number, number, number])[];
}

/** A filled polygon. */
export interface Area {
  readonly kind: "area";
  readonly t: number;
  readonly ink: Ink;
  readonly corners: readonly Place[];
}

/** A line of text, its middle at `at`; `size` is the height of its letters. */
export interface Lettering {
  readonly kind: "text";
  readonly t: number;
  readonly ink: Ink;
  readonly size: number;
  readonly at: Place;
  readonly text: string;
}

/** An image file in base64, its middle at `at`, as large as `size`. */
export interface Picture {
  readonly kind: "picture";
  readonly t: number;
  readonly at: Place;
  readonly size: Size;
  readonly source: string;
}

/** The highest number of an object that label images of 8 bits hold. */
export const MOST_LABEL = 255;

/** A number for one more mask: the one after the highest of those `taken`, or where labels end there the lowest that is free. */
export function freeLabel(taken: readonly number[]): number {
  const next = 1 + Math.max(0, ...taken);
  if (next <= MOST_LABEL) return next;
  return Array.from({ length: MOST_LABEL }, (_, index) => index + 1).find((label) => !taken.includes(label)) ?? MOST_LABEL;
}

/** Drawn over frame t. */
export type Mark = Stroke | Area | Lettering | Picture;

/** A layer: of paint, which is over one frame; or the mask of an object, drawn in one frame or more. */
export interface Drawing {
  readonly id: number;
  readonly name: string;
  readonly kind: "paint" | "mask";
  readonly on: Owner;
  readonly shown: boolean;
  /** `#rrggbb`, of a mask. */
  readonly colour: string;
  /** Of a mask: its object's number in label images, from 1 on. */
  readonly label: number;
  readonly marks: readonly Mark[];
}

/** Frames over which there is something, in order. */
export const drawnFrames = ({ marks }: Drawing): number[] => [...new Set(marks.map(({ t }) => t))].sort((a, b) => a - b);

/** With marks added to the drawing `to`, which is put on top where it is not there yet. */
export function marked(content: Content, to: Drawing, marks: readonly Mark[]): Content {
  const isThere = content.drawings.some(({ id }) => id === to.id);
  const drawings = isThere ? content.drawings : [...content.drawings, to];
  return { ...content, drawings: drawings.map((each) => (each.id === to.id ? { ...each, marks: [...each.marks, ...marks] } : each)) };
}

export const redrawn = (content: Content, id: number, part: Partial<Omit<Drawing, "id">>): Content => ({
  ...content,
  drawings: content.drawings.map((each) => (each.id === id ? { ...each, ...part } : each)),
});

export const withoutDrawing = (content: Content, id: number): Content => ({
  ...content,
  drawings: content.drawings.filter((each) => each.id !== id),
});

/** With a drawing moved `by` places towards the top; as it is where there is no such place. */
export function reordered(content: Content, id: number, by: number): Content {
  const from = content.drawings.findIndex((each) => each.id === id);
  const other = content.drawings[from + by];
  const moved = content.drawings[from];
  if (other === undefined || moved === undefined) return content;
  return { ...content, drawings: content.drawings.map((each) => (each === moved ? other : each === other ? moved : each)) };
}
