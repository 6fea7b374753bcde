/** The models of a clip's windows as the page sees them: one that answers for the whole clip. */

import { InputError, type ModelFacts, readFacts } from "./facts";
import { follow } from "./journey";
import type { Appearance, Backend, Tracked } from "./protocol";
import { type Models, Returnings } from "./returning";
import { type ModelFile, Sessions, runs } from "./sessions";
import { type Window, frames, home, readWindows } from "./windows";

/** Rays in one request: each query's own and one for each frame. Short, so that a click never waits for long. */
const RAYS_PER_REQUEST = 2048;
const MIN_GAIN = 0.8;
const PROBE_RAYS = 1024;
/** Mean difference; a few rays graze an edge and may tip over. */
const PROBE_TOLERANCE = 0.005;

/** Where model files are read from. */
export interface Files {
  /** `InputError` where it cannot be read. */
  read(path: string): Promise<ArrayBuffer>;
  /** False where it is known that there is no such file. */
  has(path: string): boolean;
}

const startWasm = (): Worker => new Worker(new URL("./wasm.ts", import.meta.url), { type: "module" });
const startWebgpu = (): Worker => new Worker(new URL("./webgpu.ts", import.meta.url), { type: "module" });

/**
 * An open model file, which is the one window of its clip, or a folder with `windows.json` and a file for each window;
 * of these, few are open at a time. Points are tracked with WebAssembly: one click is a long chain of small steps, for
 * which a GPU is slower. Layers of a clip of one window, thousands of rays at once, are rendered on WebGPU once it has
 * shown that it agrees and is faster.
 */
export class Model {
  /** What renders the layers. */
  backend: Backend = "wasm";
  private renderer: Sessions;
  private readonly models: Models;
  private readonly returnings: Returnings;
  private closed = false;

  private constructor(
    /** Of the whole clip. */
    readonly facts: ModelFacts,
    readonly windows: readonly Window[],
    private readonly wasm: Sessions,
    private readonly load: (number: number) => Promise<ModelFile>,
  ) {
    this.renderer = wasm;
    this.models = {
      windows,
      facts,
      track: (number, queries, asked) => this.ask(number, queries, asked),
      onObject: (number, queries) => this.onObject(number, queries),
    };
    this.returnings = new Returnings(this.models);
  }

  /** Opens `path`, a model file or `windows.json`; `InputError` where it is none, lacks a file or does not run here. */
  static async open(path: string, files: Files): Promise<Model> {
    const layout = path.endsWith(".json") ? readWindows(new TextDecoder().decode(await files.read(path)), path) : undefined;
    const folder = path.slice(0, path.lastIndexOf("/") + 1);
    const paths = layout?.windows.map(({ name }) => `${folder}${name}.onnx`) ?? [path];
    const missing = paths.filter((each) => !files.has(each));
    if (missing.length > 0) {
      throw new InputError(`${missing.join(", ")} is missing beside ${path}; open the whole folder, or copy it again.`);
    }
    const load = async (number: number): Promise<ModelFile> => {
      const file = paths[number] ?? path;
      const bytes = await files.read(file);
      const facts = readFacts(new Uint8Array(bytes), file);
      const window = layout?.windows[number];
      if (layout && window) checkWindow(file, facts, { ...layout.facts, numFrames: window.end - window.begin }, path);
      return { path: file, bytes, facts };
    };
    const wasm = new Sessions(startWasm(), "wasm", load);
    try {
      const first = await wasm.facts(0);
      const windows = layout?.windows ?? [{ name: path, begin: 0, end: first.numFrames }];
      const model = new Model({ ...first, ...layout?.facts }, windows, wasm, load);
      await runs(path, model.ask(0, new Float32Array([0, first.width / 2, first.height / 2]), frames(0, first.numFrames)));
      return model;
    } catch (error) {
      wasm.close();
      throw error;
    }
  }

  get threads(): number {
    return this.wasm.threads;
  }

  /**
   * Follows `queries` [N, 3], rows of (t, x, y), through every frame; `onProgress` hears what share of it is done,
   * `onPart` what is answered so far, as `follow` says it.
   */
  async track(queries: Float32Array, onProgress?: (share: number) => void, onPart?: (part: Tracked) => void): Promise<Tracked> {
    let done = 0;
    const onRays = (rays: number): void => {
      done += rays; // some frames are asked for twice, since windows share them
      onProgress?.(Math.min(1, done / ((queries.length / 3) * this.facts.numFrames)));
    };
    const models = { ...this.models, track: (number: number, part: Float32Array, asked: readonly number[]) => this.ask(number, part, asked, onRays) };
    return follow(models, this.returnings, queries, onPart);
  }

  /** Follows `queries` [N, 3], all of one frame, to those of `asked` that lie in that frame's window. */
  async glance(queries: Float32Array, asked: readonly number[]): Promise<Tracked & { readonly frames: readonly number[] }> {
    const number = home(this.windows, queries[0] ?? 0);
    const { begin, end } = this.windows[number] ?? { begin: 0, end: 0 };
    const near = asked.filter((frame) => frame >= begin && frame < end);
    const answer = await this.ask(number, counted(queries, begin), near.map((frame) => frame - begin));
    return { ...answer, frames: near };
  }

  /**
   * Where `queries` [N, 3], all of one frame, are in the frames `targets` [M] of the clip; in another window than the
   * queries' own as `track` follows them there, which takes long.
   */
  async carry(queries: Float32Array, targets: readonly number[]): Promise<Tracked> {
    const frame = queries[0] ?? 0;
    const holds = ({ begin, end }: Window): boolean => [frame, ...targets].every((each) => begin <= each && each < end);
    const own = home(this.windows, frame);
    const number = this.windows.map((_, index) => index).sort((a, b) => Math.abs(a - own) - Math.abs(b - own)).find((each) => this.windows.slice(each, each + 1).some(holds));
    if (number !== undefined) {
      const begin = this.windows[number]?.begin ?? 0;
      return this.ask(number, counted(queries, begin), targets.map((target) => target - begin));
    }
    const { tracks, occlusion } = await this.track(queries);
    const rows = Array.from({ length: queries.length / 3 }, (_, row) => row);
    const at = rows.flatMap((row) => targets.map((target) => row * this.facts.numFrames + target));
    return {
      tracks: Float32Array.from(at.flatMap((index) => [tracks[2 * index] ?? 0, tracks[2 * index + 1] ?? 0])),
      occlusion: Float32Array.from(at, (index) => occlusion[index] ?? 1),
    };
  }

  /**
   * What the model sees along the rays of `queries` [N, 3], all of one frame; by WebAssembly again once WebGPU fails, as
   * after a sleep.
   */
  async render(queries: Float32Array): Promise<Appearance> {
    const renderer = this.renderer;
    const number = home(this.windows, queries[0] ?? 0);
    const begin = this.windows[number]?.begin ?? 0;
    const args = { queries: counted(queries, begin) };
    try {
      return await renderer.ask("render", number, args);
    } catch (error) {
      if (renderer === this.wasm || this.closed) throw error;
      renderer.close();
      this.renderer = this.wasm;
      this.backend = "wasm";
      return this.wasm.ask("render", number, args);
    }
  }

  /** Moves the rendering of layers to WebGPU where there is one that agrees with WebAssembly and is faster. */
  async tryWebgpu(): Promise<void> {
    if (this.windows.length > 1 || !(await hasHardwareWebgpu())) return;
    const gpu = new Sessions(startWebgpu(), "webgpu", this.load);
    try {
      const probe = probeRays(this.facts);
      await gpu.ask("render", 0, { queries: probe }); // the first run compiles the shaders
      const [fast, slow] = [await timed(() => gpu.ask("render", 0, { queries: probe })), await timed(() => this.render(probe))];
      if (fast.seconds > MIN_GAIN * slow.seconds || !agree(fast.value, slow.value)) throw new Error("no gain");
      if (this.closed) throw new Error("closed meanwhile");
      this.renderer = gpu;
      this.backend = "webgpu";
    } catch {
      gpu.close(); // WebAssembly goes on
    }
  }

  close(): void {
    this.closed = true;
    this.renderer.close();
    this.wasm.close();
  }

  /** Asks the model of window `number`, in requests that are short; `onRays` hears of each answer how many rays it is of. */
  private async ask(
    number: number,
    queries: Float32Array,
    asked: readonly number[],
    onRays?: (rays: number) => void,
  ): Promise<Tracked> {
    const count = queries.length / 3;
    const tracks = new Float32Array(count * asked.length * 2);
    const occlusion = new Float32Array(count * asked.length);
    const step = Math.max(1, Math.floor(RAYS_PER_REQUEST / (1 + asked.length)));
    for (let first = 0; first < count; first += step) {
      const part = queries.slice(first * 3, (first + step) * 3);
      const answer = await this.wasm.ask("track", number, { queries: part, frames: asked });
      tracks.set(answer.tracks, first * asked.length * 2);
      occlusion.set(answer.occlusion, first * asked.length);
      onRays?.(answer.occlusion.length);
    }
    return { tracks, occlusion };
  }

  private async onObject(number: number, queries: Float32Array): Promise<boolean[]> {
    const owned: boolean[] = [];
    for (let first = 0; first < queries.length; first += 3 * RAYS_PER_REQUEST) {
      const part = queries.slice(first, first + 3 * RAYS_PER_REQUEST);
      const { static_confidence } = await this.wasm.ask("render", number, { queries: part });
      for (const confidence of static_confidence) owned.push(confidence < 1 - this.facts.objectShare);
    }
    return owned;
  }
}

/** Queries [N, 3] whose frames count from `begin`. */
const counted = (queries: Float32Array, begin: number): Float32Array => queries.map((value, index) => (index % 3 === 0 ? value - begin : value));

/** `InputError` where the model `file` has not the length and size that `path` says. */
function checkWindow(file: string, facts: ModelFacts, said: Pick<ModelFacts, "numFrames" | "height" | "width">, path: string): void {
  const { numFrames, height, width } = facts;
  if (numFrames !== said.numFrames || height !== said.height || width !== said.width) {
    throw new InputError(`${file} is of ${numFrames} frames of ${width}x${height}, and ${path} says otherwise; export the run again.`);
  }
}

async function hasHardwareWebgpu(): Promise<boolean> {
  const gpu = (navigator as { gpu?: { requestAdapter(): Promise<{ info?: { isFallbackAdapter?: boolean } } | null> } }).gpu;
  if (gpu === undefined || !("Suspending" in WebAssembly)) return false;
  const adapter = await gpu.requestAdapter().catch(() => null);
  if (adapter === null) return false;
  return new URLSearchParams(location.search).has("software-webgpu") || adapter.info?.isFallbackAdapter !== true;
}

async function timed<T>(work: () => Promise<T>): Promise<{ value: T; seconds: number }> {
  const start = performance.now();
  const value = await work();
  return { value, seconds: (performance.now() - start) / 1000 };
}

function probeRays({ width, height, numFrames }: ModelFacts): Float32Array {
  const side = Math.sqrt(PROBE_RAYS);
  return Float32Array.from({ length: PROBE_RAYS * 3 }, (_, index) => {
    const ray = Math.floor(index / 3);
    if (index % 3 === 0) return Math.floor(numFrames / 2);
    return index % 3 === 1 ? ((ray % side) / side) * (width - 1) : (Math.floor(ray / side) / side) * (height - 1);
  });
}

function agree(a: Appearance, b: Appearance): boolean {
  return (Object.keys(a) as (keyof Appearance)[]).every((key) => {
    const total = a[key].reduce((sum, value, index) => sum + Math.abs(value - (b[key][index] ?? Number.NaN)), 0);
    return total / a[key].length < PROBE_TOLERANCE;
  });
}
