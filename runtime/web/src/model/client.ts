/** The model as the page sees it: promises in front of the worker that runs it. */

import { InputError, type ModelFacts, readFacts } from "./facts";
import type { Answer, Appearance, Backend, Kind, Request, Requests, Tracked } from "./protocol";

/** Rays in one request: each query's own and one for each frame. Short, so that a click never waits for long. */
const RAYS_PER_REQUEST = 2048;
const MIN_GAIN = 0.8;
const PROBE_RAYS = 1024;
/** Mean difference; a few rays graze an edge and may tip over. */
const PROBE_TOLERANCE = 0.005;

const CLOSED = "The model was closed before it had answered.";

class Runner {
  threads = 1;
  private readonly worker: Worker;
  private readonly waiting = new Map<number, { resolve: (value: never) => void; reject: (error: Error) => void }>();
  private lastId = 0;
  private closed = false;

  constructor(worker: Worker) {
    this.worker = worker;
    this.worker.onmessage = ({ data }: MessageEvent<Answer>) => {
      const request = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if ("error" in data) request?.reject(new Error(data.error));
      else request?.resolve(data.value as never);
    };
    this.worker.onerror = (event) => {
      for (const { reject } of this.waiting.values()) reject(new Error(event.message || "the worker did not start"));
      this.waiting.clear();
    };
  }

  ask<K extends Kind>(kind: K, args: Requests[K]["args"]): Promise<Requests[K]["answer"]> {
    const id = ++this.lastId;
    return new Promise((resolve, reject) => {
      if (this.closed) throw new InputError(CLOSED);
      this.waiting.set(id, { resolve, reject });
      this.worker.postMessage({ id, kind, args } as Request);
    });
  }

  async open(model: ArrayBuffer, backend: Backend): Promise<void> {
    const base = new URL("./", document.baseURI).href;
    this.threads = (await this.ask("open", { model, base, backend })).threads;
  }

  close(): void {
    this.closed = true;
    this.worker.terminate();
    for (const { reject } of this.waiting.values()) reject(new InputError(CLOSED));
    this.waiting.clear();
  }
}

const startWasm = (): Runner => new Runner(new Worker(new URL("./wasm.ts", import.meta.url), { type: "module" }));
const startWebgpu = (): Runner => new Runner(new Worker(new URL("./webgpu.ts", import.meta.url), { type: "module" }));

/**
 * An open model. Points are tracked with WebAssembly: one click is a long chain of small steps, for which a GPU is
 * slower. Layers, thousands of rays at once, are rendered on WebGPU once it has shown that it agrees and is faster.
 */
export class Model {
  /** What renders the layers. */
  backend: Backend = "wasm";
  private closed = false;

  private constructor(
    readonly facts: ModelFacts,
    private readonly wasm: Runner,
    private renderer: Runner,
  ) {}

  /** Opens the file `name`; `InputError` where it is not a model or does not run here. */
  static async open(bytes: ArrayBuffer, name: string): Promise<Model> {
    const facts = readFacts(new Uint8Array(bytes), name);
    const wasm = startWasm();
    try {
      await wasm.open(bytes, "wasm");
      const model = new Model(facts, wasm, wasm);
      await model.track(new Float32Array([0, facts.width / 2, facts.height / 2]));
      return model;
    } catch (error) {
      wasm.close();
      const reason = error instanceof Error ? error.message : String(error);
      throw new InputError(`${name} does not run in this browser (${reason}); try another browser, or export it again.`);
    }
  }

  get threads(): number {
    return this.wasm.threads;
  }

  /** Follows `queries` [N, 3], rows of (t, x, y), through every frame; `onProgress` hears how many are done. */
  async track(queries: Float32Array, onProgress?: (done: number) => void): Promise<Tracked> {
    const { numFrames } = this.facts;
    const count = queries.length / 3;
    const tracks = new Float32Array(count * numFrames * 2);
    const occlusion = new Float32Array(count * numFrames);
    const step = Math.max(1, Math.floor(RAYS_PER_REQUEST / (1 + numFrames)));
    for (let first = 0; first < count; first += step) {
      const part = queries.slice(first * 3, (first + step) * 3);
      const answer = await this.wasm.ask("track", { queries: part, numFrames });
      tracks.set(answer.tracks, first * numFrames * 2);
      occlusion.set(answer.occlusion, first * numFrames);
      onProgress?.(Math.min(count, first + step));
    }
    return { tracks, occlusion };
  }

  /** What the model sees along the rays of `queries` [N, 3]; by WebAssembly again once WebGPU fails, as after a sleep. */
  async render(queries: Float32Array): Promise<Appearance> {
    const renderer = this.renderer;
    try {
      return await renderer.ask("render", { queries });
    } catch (error) {
      if (renderer === this.wasm || this.closed) throw error;
      renderer.close();
      this.renderer = this.wasm;
      this.backend = "wasm";
      return this.wasm.ask("render", { queries });
    }
  }

  /** Moves the rendering of layers to WebGPU where there is one that agrees with WebAssembly and is faster. */
  async tryWebgpu(bytes: ArrayBuffer): Promise<void> {
    if (!(await hasHardwareWebgpu())) return;
    const gpu = startWebgpu();
    try {
      await gpu.open(bytes, "webgpu");
      const probe = probeRays(this.facts);
      await gpu.ask("render", { queries: probe }); // the first run compiles the shaders
      const [fast, slow] = [await timed(() => gpu.ask("render", { queries: probe })), await timed(() => this.render(probe))];
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
