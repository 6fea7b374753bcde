/** Windows: parts of a clip, each with a model of its own, and the file that says where they lie. */

import { InputError, type ModelFacts, rises } from "./facts";
import { readQuality, worst } from "./quality";

export const WINDOWS_FILE = "windows.json";
const FORMAT_VERSION = 1;

export interface Window {
  /** Of the model's file, without its ending. */
  readonly name: string;
  /** First frame in the clip. */
  readonly begin: number;
  /** The frame after its last. */
  readonly end: number;
}

/** What `windows.json` says. */
export interface Layout {
  readonly windows: readonly Window[];
  /** Of the whole clip; `quality` is that of the window which misses its held-out links the most. */
  readonly facts: Pick<ModelFacts, "clipName" | "numFrames" | "height" | "width" | "fps" | "times" | "quality">;
}

/** The frames that window `number` shares with the next; none at a cut. */
export function shared(windows: readonly Window[], number: number): number[] {
  return frames(windows[number + 1]?.begin ?? Infinity, windows[number]?.end ?? 0);
}

/** The window in which `frame` lies farther from either end. */
export function home(windows: readonly Window[], frame: number): number {
  const lasts = windows.slice(1).map(({ begin }, number) => (begin + (windows[number]?.end ?? 0)) / 2);
  return lasts.filter((last) => last < frame + 0.5).length;
}

/** `begin` up to but without `end`. */
export const frames = (begin: number, end: number): number[] =>
  Array.from({ length: Math.max(0, end - begin) }, (_, index) => begin + index);

/** Reads the text of the file `name`; `InputError` where it is damaged, newer or contradicts itself. */
export function readWindows(text: string, name: string): Layout {
  const content = parsed(text);
  const { format_version: version, clip, num_frames, height, width, fps, pixel_aspect, seconds, windows, quality } = content ?? {};
  if (typeof version === "number" && version > FORMAT_VERSION) {
    throw new InputError(
      `${name} has format version ${version} but this page reads up to ${FORMAT_VERSION}; upgrade with 'pip install -U decomotion'.`,
    );
  }
  const counts = [num_frames, height, width];
  const rates = [fps, pixel_aspect];
  if (
    !(typeof version === "number" && typeof clip === "string" && counts.every(Number.isInteger) && rates.every(Number.isFinite)) ||
    !(seconds === null || (Array.isArray(seconds) && seconds.every(Number.isFinite))) ||
    !(Array.isArray(windows) && windows.every(isWindow)) ||
    !(quality === undefined || quality === null || Array.isArray(quality))
  ) {
    throw damaged(name);
  }
  const [numFrames, rate] = [Number(num_frames), Number(fps)];
  const positive = [...counts, ...rates].every((value) => Number(value) > 0);
  if (!positive || !covers(windows, numFrames) || (seconds !== null && !rises(seconds, numFrames)) || (quality ?? windows).length !== windows.length) {
    throw new InputError(`${name} contradicts itself: its windows do not cover the clip; write it again with 'decomo-export'.`);
  }
  try {
    const times = seconds ?? frames(0, numFrames).map((frame) => frame / rate);
    const told = worst((quality ?? []).map((each: unknown) => (each === null ? undefined : readQuality(each))));
    const size = { height: Number(height), width: Number(width) };
    return { windows, facts: { clipName: clip, numFrames, ...size, fps: rate, times, quality: told } };
  } catch (error) {
    if (error instanceof RangeError) throw damaged(name);
    throw error;
  }
}

const damaged = (name: string): InputError =>
  new InputError(`${name} does not tell where the clip's windows are, or is damaged; copy the folder again, or write it with 'decomo-export'.`);

function parsed(text: string): Record<string, any> | null {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

function isWindow(window: Partial<Window> | null): window is Window {
  const { name, begin, end } = window ?? {};
  return typeof name === "string" && Number.isInteger(begin) && Number.isInteger(end);
}

/** Whether they follow each other without a gap, from the first frame to the last, under names of their own. */
function covers(windows: readonly Window[], numFrames: number): boolean {
  const connected = windows.slice(1).every(({ begin, end }, number) => {
    const before = windows[number];
    return before !== undefined && before.begin < begin && begin <= before.end && before.end < end;
  });
  const [first, last] = [windows[0], windows.at(-1)];
  const plain = windows.every(({ name }) => /^window-[0-9]+$/.test(name)) && new Set(windows.map(({ name }) => name)).size === windows.length;
  return plain && connected && first?.begin === 0 && first.end > 0 && last?.end === numFrames;
}
