/** Points and corrections from files that this page or `decomo-track` wrote. Tracks in them are asked for anew. */

import { unzipSync } from "fflate";
import Papa from "papaparse";
import type { Draft, Given, Query } from "../document";
import { InputError, type ModelFacts } from "../model/facts";
import { type NumberArray, readNpy } from "./npy";
import { CORRECTION_FIELDS, JSON_FORMAT, JSON_VERSION } from "./write";

/** Each is a row of the list and a trail in every picture. */
const MOST_POINTS = 2000;
/** Of a project: what the page holds it opens again. */
const MOST_OF_PROJECT = 20_000;

/** The points of a .csv, .json or .npz file; `InputError` says what is wrong and where. */
export function readPoints(name: string, bytes: Uint8Array, facts: ModelFacts): Draft[] {
  const suffix = name.slice(name.lastIndexOf(".")).toLowerCase();
  const read = { ".csv": readCsv, ".json": readJson, ".npz": readNpz }[suffix];
  if (read === undefined) throw new InputError(`${name} is nothing that this page opens; give a model (.onnx), frames (.jpg, .png) or points (.csv, .json, .npz).`);
  const drafts = read(bytes, name, facts);
  const most = suffix === ".json" ? MOST_OF_PROJECT : MOST_POINTS;
  if (drafts.length > most) {
    throw new InputError(`${name} holds ${drafts.length} points, more than the ${most} that this page takes at once; ask decomo-track for them.`);
  }
  drafts.forEach((draft, row) => {
    const where = `${name}, point ${row} (counted from 0)`;
    check(draft, where, facts);
    draft.given?.forEach((given, index) => {
      checkGiven(given, draft, `${where}, correction ${index}`, facts);
      if (draft.given?.some(({ t }, other) => other < index && t === given.t)) {
        throw new InputError(`${where} has two corrections in frame ${given.t}; leave one of them out.`);
      }
    });
  });
  return drafts;
}

function checkGiven({ t, place }: Given, query: Query, where: string, facts: ModelFacts): void {
  check({ ...(place ?? query), t }, where, facts);
  if (t === query.t) throw new InputError(`${where} is in frame ${t}, in which the point was placed; give it for another frame.`);
}

function check({ t, x, y }: Query, where: string, { numFrames, width, height }: ModelFacts): void {
  if (![t, x, y].every(Number.isFinite)) throw new InputError(`${where}: t, x and y must be finite numbers.`);
  if (!Number.isInteger(t) || t < 0 || t > numFrames - 1) {
    throw new InputError(`${where}: t is ${t} but must be a whole number within 0 .. ${numFrames - 1}, the clip's frames.`);
  }
  if (x < -0.5 || x > width - 0.5 || y < -0.5 || y > height - 0.5) {
    throw new InputError(`${where}: (${x}, ${y}) lies outside the frame of ${width}x${height}.`);
  }
}

/** A row of a table, by the names of its columns. */
interface Line {
  readonly cell: (column: string) => string;
  /** NaN where the cell is empty or no number. */
  readonly number: (column: string) => number;
}

/** Columns of tracks, a line for each point and frame. */
const TRACK_FIELDS = ["point", "frame", "query_t", "query_x", "query_y"];

/** Points, tracks or corrections, which the header tells. The delimiter is told by the file: a comma, a semicolon, a tab. */
function readCsv(bytes: Uint8Array, name: string): Draft[] {
  const { data, errors } = Papa.parse<string[]>(textOf(bytes, name), { skipEmptyLines: true });
  const broken = errors.find(({ type }) => type === "Quotes");
  if (broken) throw new InputError(`${name}, row ${(broken.row ?? 1) - 1} (counted from 0) has a quote that is not closed; mend it.`);
  const [header = [], ...rows] = data;
  const columns = header.map((column) => column.trim().toLowerCase());
  const has = (column: string): boolean => columns.includes(column);
  const ofTracks = TRACK_FIELDS.every(has);
  const names = ofTracks ? { t: "query_t", x: "query_x", y: "query_y" } : { t: "t", x: "x", y: "y" };
  const missing = Object.values(names).filter((column) => columns.indexOf(column) !== columns.lastIndexOf(column) || !columns.includes(column));
  if (missing.length > 0) {
    throw new InputError(`${name} must begin with the header t,x,y; it has no column ${missing.join(", ")}, or more than one.`);
  }
  const cells = rows.map((row, index): Line => {
    if (row.length !== columns.length) {
      throw new InputError(`${name}, row ${index} (counted from 0) has ${row.length} values, not ${columns.length}; mend it.`);
    }
    const cell = (column: string): string => row[columns.indexOf(column)] ?? "";
    const number = (column: string): number => (cell(column).trim() === "" ? Number.NaN : Number(cell(column)));
    return { cell, number };
  });
  if (CORRECTION_FIELDS.every(has)) return corrections(cells);
  const drafts = cells.map(({ cell, number }) => draft(number(names.t), number(names.x), number(names.y), cell("name"), cell("colour")));
  return ofTracks ? firsts(drafts, cells.map(({ cell }) => cell("point"))) : drafts;
}

/** Lines of corrections as drafts: a point that several lines have is one. */
function corrections(lines: readonly Line[]): Draft[] {
  const drafts = new Map<string, Query & { given: Given[] }>();
  for (const { cell, number } of lines) {
    const query = { t: number("t"), x: number("x"), y: number("y") };
    const hidden = cell("target_x").trim() === "" && cell("target_y").trim() === "";
    const given = { t: number("target_t"), place: hidden ? null : { x: number("target_x"), y: number("target_y") } };
    const key = Object.values(query).join();
    const draft = drafts.get(key) ?? { ...query, given: [] };
    draft.given.push(given);
    drafts.set(key, draft);
  }
  return [...drafts.values()];
}

/** The first draft of each point, whose numbers `points` are. */
const firsts = (drafts: readonly Draft[], points: readonly string[]): Draft[] =>
  [...new Map(drafts.map((each, index) => [points[index], each] as const).reverse()).values()].reverse();

function textOf(bytes: Uint8Array, name: string): string {
  try {
    return new TextDecoder("utf-8", { fatal: true }).decode(bytes);
  } catch {
    throw new InputError(`${name} is not text in UTF-8; save it as such.`);
  }
}

function readJson(bytes: Uint8Array, name: string, facts: ModelFacts): Draft[] {
  let content: { format?: unknown; version?: unknown; clip?: Record<string, unknown>; points?: unknown } | null;
  const text = textOf(bytes, name);
  try {
    content = JSON.parse(text);
  } catch {
    throw new InputError(`${name} is not JSON, or it is cut short; write it with this page.`);
  }
  const { format = JSON_FORMAT, version = JSON_VERSION, clip, points } = content ?? {};
  if (format !== JSON_FORMAT || !Array.isArray(points)) {
    throw new InputError(`${name} is no file of points, or has no list 'points'; write it with this page.`);
  }
  if (typeof version !== "number" || version > JSON_VERSION) {
    throw new InputError(
      `${name} has version ${JSON.stringify(version)} but this page reads up to ${JSON_VERSION}; upgrade with 'pip install -U decomotion', ` +
        "or save the points as CSV.",
    );
  }
  checkClip(name, clip ?? {}, facts);
  return points.map((point: Record<string, unknown> | null) => {
    const [t, x, y] = [point?.t, point?.x, point?.y].map((value) => (typeof value === "number" ? value : Number.NaN));
    const read = draft(t ?? Number.NaN, x ?? Number.NaN, y ?? Number.NaN, point?.name, point?.colour);
    return point?.corrections === undefined ? read : { ...read, given: givens(point.corrections, name) };
  });
}

function givens(corrections: unknown, name: string): Given[] {
  if (!Array.isArray(corrections)) throw new InputError(`${name} has corrections that are no list; write it with this page.`);
  return corrections.map((each: Record<string, unknown> | null) => {
    const [t, x, y] = [each?.t, each?.x, each?.y].map((value) => (typeof value === "number" ? value : Number.NaN));
    return { t: t ?? Number.NaN, place: each?.hidden === true ? null : { x: x ?? Number.NaN, y: y ?? Number.NaN } };
  });
}

function readNpz(bytes: Uint8Array, name: string, facts: ModelFacts): Draft[] {
  let entries: Record<string, Uint8Array>;
  try {
    entries = unzipSync(bytes, { filter: (file) => ["queries.npy", "height.npy", "width.npy"].includes(file.name) });
  } catch {
    throw new InputError(`${name} is not an npz file, or it is cut short; write it with 'decomo-track'.`);
  }
  const array = (key: string): NumberArray | undefined => {
    const entry = entries[`${key}.npy`];
    return entry && readNpy(entry, `${name}: ${key}`);
  };
  checkClip(name, { height: array("height")?.values[0], width: array("width")?.values[0] }, facts);
  const queries = array("queries");
  if (queries === undefined) throw new InputError(`${name} lacks the array queries; write it with 'decomo-track'.`);
  const { shape, values } = queries;
  if (shape.length !== 2 || shape[1] !== 3) {
    throw new InputError(`${name}: queries must have the shape [N, 3], got [${shape.join(", ")}].`);
  }
  const at = (index: number): number => values[index] ?? Number.NaN;
  return Array.from({ length: shape[0] ?? 0 }, (_, row) => draft(at(3 * row), at(3 * row + 1), at(3 * row + 2)));
}

/** `InputError` where a file says that its points are of a clip of another length or size. */
function checkClip(name: string, told: Readonly<Record<string, unknown>>, { clipName, numFrames, height, width }: ModelFacts): void {
  for (const [key, own] of Object.entries({ num_frames: numFrames, height, width })) {
    if (told[key] !== undefined && told[key] !== own) {
      throw new InputError(
        `${name} has points of a clip whose ${key} is ${JSON.stringify(told[key])} but the model was fitted to ${clipName}, whose ${key} is ` +
          `${own}; give points of that clip.`,
      );
    }
  }
}

function draft(t: number, x: number, y: number, name?: unknown, colour?: unknown): Draft {
  return {
    ...{ t, x, y },
    ...(typeof name === "string" && name !== "" ? { name } : {}),
    ...(typeof colour === "string" && /^#[0-9a-f]{6}$/i.test(colour) ? { colour } : {}),
  };
}
