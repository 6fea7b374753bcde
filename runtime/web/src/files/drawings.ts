/** What is drawn as files: in projects, as pictures for `decomo-render --edit`, and as masks for `decomo-propagate`. */

import { zipSync } from "fflate";
import { drawPainted } from "../draw";
import { type Drawing, type Ink, MOST_LABEL, type Mark, OWNERS, drawnFrames } from "../drawings";
import { blank } from "../marks";
import { InputError, type ModelFacts } from "../model/facts";
import type { Painted } from "../painter";
import type { Sketch } from "../sketch";
import { labelPng } from "./labels";

type Folder = Record<string, Uint8Array>;

/** Layers of paint: each as it was drawn, and all of them in every frame, with what to do with them. */
export async function drawingsZip(drawings: readonly Drawing[], sketch: Sketch, facts: ModelFacts, onFrame: (frame: number) => void): Promise<Uint8Array> {
  const paint = drawings.filter(({ kind, shown, marks }) => kind === "paint" && shown && marks.length > 0);
  const files: Folder = {};
  const edits: string[] = [];
  for (const [index, drawing] of paint.entries()) {
    const [t = 0] = drawnFrames(drawing);
    const sheet = sketch.sheet(drawing, t);
    const name = `edits/${String(index + 1).padStart(2, "0")}-${plain(drawing.name)}.png`;
    if (sheet) files[name] = await png(sheet);
    edits.push(`--edit ${name}@${t} --on ${drawing.on}`);
  }
  const finished = sketch.finished(paint);
  for (let frame = 0; frame < facts.numFrames; frame++) {
    onFrame(frame);
    files[`frames/${String(frame).padStart(5, "0")}.png`] = await png(over(facts, await finished(frame)));
  }
  files["README.txt"] = text([
    "frames/: what is drawn, in every frame, with alpha, as the page shows it.",
    "edits/: each layer over the frame it was drawn on. Every pixel anew, on the clip, or without it as video with alpha:",
    "",
    `decomo-render MODEL --clip CLIP ${edits.join(" ")} --out edited.mp4`,
    `decomo-render MODEL --clip CLIP ${edits.join(" ")} --alone --out drawings.mov`,
  ]);
  return zipSync(files, { level: 0 });
}

/** Draws the layers on a transparent frame. */
export function over(facts: ModelFacts, painted: readonly Painted[]): OffscreenCanvas {
  const { canvas, context } = blank(facts, 1);
  drawPainted(context, painted, 1, 1);
  return canvas;
}

/** Masks as they were drawn: a label image for each frame with one, and how they are carried to the others. */
export function masksZip(drawings: readonly Drawing[], sketch: Sketch, facts: ModelFacts): Uint8Array {
  const masks = drawings.filter(({ kind, shown, marks }) => kind === "mask" && shown && marks.length > 0);
  const files: Folder = {};
  const frames = [...new Set(masks.flatMap(drawnFrames))].sort((a, b) => a - b);
  for (const frame of frames) {
    const labels = new Uint8Array(facts.width * facts.height);
    for (const mask of masks) {
      const sheet = sketch.sheet(mask, frame, 1);
      const data = sheet?.getContext("2d")?.getImageData(0, 0, facts.width, facts.height).data;
      for (let pixel = 0; data && pixel < labels.length; pixel++) if ((data[4 * pixel + 3] ?? 0) > 127) labels[pixel] = mask.label;
    }
    if (labels.every((label) => label === 0)) continue;
    files[`${String(frame).padStart(5, "0")}.png`] = labelPng(facts, labels);
  }
  const names = Object.keys(files);
  if (names.length === 0) throw new InputError("The masks that are shown are empty; draw one.");
  files["README.txt"] = text([
    "Label images: the value of a pixel is its object's number, 0 is none.",
    ...masks.map(({ label, name }) => `${label}: ${name}`),
    "",
    "Carried to all frames:",
    "",
    `decomo-propagate MODEL ${names.map((name) => `--from ${name}@${Number(name.slice(0, 5))}`).join(" ")} --clip CLIP --out masks`,
  ]);
  return zipSync(files, { level: 0 });
}

/** Drawings as a project keeps them. */
export const drawingsRecord = (drawings: readonly Drawing[]): unknown => drawings.map(({ id: _, ...drawing }) => drawing);

/** The drawings of a project; `InputError` where they are not what this page writes. */
export function readDrawings(name: string, bytes: Uint8Array, { numFrames }: Pick<ModelFacts, "numFrames">): Omit<Drawing, "id">[] {
  const { drawings = [] } = JSON.parse(new TextDecoder().decode(bytes)) as { drawings?: unknown };
  const refuse = (where: string): never => {
    throw new InputError(`${name}, drawing ${where}, is damaged; write it with this page.`);
  };
  const number = (value: unknown, where: string, least = -FARTHEST, most = FARTHEST): number =>
    typeof value === "number" && value >= least && value <= most ? value : refuse(where);
  const list = (value: unknown, where: string, most: number): Record<string, unknown>[] =>
    Array.isArray(value) && value.length <= most && value.every((each) => typeof each === "object" && each !== null) ? value : refuse(where);
  const words = (value: unknown, where: string, most: number): string => (typeof value === "string" && value.length <= most ? value : refuse(where));
  const place = (value: unknown, where: string): { x: number; y: number } => {
    const { x, y } = (value ?? {}) as Record<string, unknown>;
    return { x: number(x, where), y: number(y, where) };
  };
  const mark = (read: Record<string, unknown>, where: string): Mark => {
    const t = number(read.t, where, 0, numFrames - 1);
    if (!Number.isInteger(t)) refuse(where);
    if (read.kind === "picture") {
      const { width: across, height: down } = (read.size ?? {}) as Record<string, unknown>;
      const size = { width: number(across, where, 0), height: number(down, where, 0) };
      const source = words(read.source, where, MOST_SOURCE);
      if (!/^[A-Za-z0-9+/]+={0,2}$/.test(source)) refuse(where);
      return { kind: "picture", t, at: place(read.at, where), size, source };
    }
    const ink: Ink = read.ink === null ? null : colourOf(read.ink, () => refuse(where));
    if (read.kind === "area") return { kind: "area", t, ink, corners: list(read.corners, where, MOST_PLACES).map((each) => place(each, where)) };
    const size = number(read.size, where, 0);
    if (read.kind === "text") return { kind: "text", t, ink, size, at: place(read.at, where), text: words(read.text, where, MOST_LETTERS) };
    if (read.kind !== "stroke") return refuse(where);
    const path = list(read.path, where, MOST_PLACES).map((each) => {
      const [x, y, pressure] = Array.isArray(each) ? each : [];
      return [number(x, where), number(y, where), number(pressure, where, 0, 1)] as const;
    });
    return { kind: "stroke", t, ink, size, path };
  };
  return list(drawings, "list", MOST_DRAWINGS).map((read, index) => {
    const where = `${index} (counted from 0)`;
    const on = OWNERS.find((owner) => owner === read.on) ?? refuse(where);
    const kind = read.kind === "mask" || read.kind === "paint" ? read.kind : refuse(where);
    const marks = list(read.marks, where, MOST_MARKS).map((each) => mark(each, where));
    if (kind === "paint" && new Set(marks.map(({ t }) => t)).size > 1) refuse(where);
    const label = number(read.label, where, kind === "mask" ? 1 : 0, MOST_LABEL);
    if (!Number.isInteger(label)) refuse(where);
    const colour = colourOf(read.colour, () => refuse(where));
    return { name: words(read.name, where, 80), kind, on, shown: read.shown === true, colour, label, marks };
  });
}

/** Pixels of the clip: places and sizes may lie outside of its frames, as those of a long picture drawn high. */
const FARTHEST = 1e6;
/** A layer of paint is over one frame. */
const MOST_DRAWINGS = 10_000;
const MOST_MARKS = 20_000;
const MOST_PLACES = 100_000;
const MOST_LETTERS = 400;
/** Of a picture in base64. */
const MOST_SOURCE = 24 * 2 ** 20;

const colourOf = (value: unknown, refuse: () => never): string => (typeof value === "string" && /^#[0-9a-f]{6}$/i.test(value) ? value : refuse());

const png = async (canvas: OffscreenCanvas): Promise<Uint8Array> =>
  new Uint8Array(await (await canvas.convertToBlob({ type: "image/png" })).arrayBuffer());

const plain = (name: string): string => name.toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "") || "layer";

const text = (lines: readonly string[]): Uint8Array => new TextEncoder().encode(`${lines.join("\n")}\n`);
