import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { type Files, Model } from "../src/model/client";
import { InputError } from "../src/model/facts";

vi.mock("../src/model/facts", async (original) => ({
  ...(await original<object>()),
  readFacts: (bytes: Uint8Array) => ({ clipName: "part", numFrames: bytes[0], width: 4, height: 3, preset: "cpu", occlusionThreshold: 0.5, objectShare: 0.5 }),
}));

interface Asked {
  readonly id: number;
  readonly kind: string;
  readonly args: { session: number; queries: Float32Array; frames: number[]; model: ArrayBuffer; prepared: boolean };
}

/** A model of frames of nothing; `read` is what was read of it. */
function filesOf(lengths: Readonly<Record<string, number>>, texts: Readonly<Record<string, object>> = {}): { files: Files; read: string[] } {
  const read: string[] = [];
  const has = (path: string): boolean => path in lengths || path in texts;
  const content = async (path: string): Promise<ArrayBuffer> => {
    read.push(path);
    await new Promise((done) => setTimeout(done));
    const text = texts[path];
    return (text ? new TextEncoder().encode(JSON.stringify(text)) : Uint8Array.of(lengths[path] ?? 0)).buffer as ArrayBuffer;
  };
  return { files: { has, read: content }, read };
}

const ONE = filesOf({ "m.onnx": 1 }).files;

/** Answers at once, and no more once it is ended; fails as a worker does where a model is asked that is not open. */
class FakeWorker {
  static open: Set<number>;
  static most: number;
  static asked: Asked[];
  onmessage: ((message: { data: unknown }) => void) | undefined;
  private ended = false;
  postMessage(request: Asked): void {
    if (this.ended) return;
    const { id, kind, args } = request;
    FakeWorker.asked.push(request);
    const known = FakeWorker.open.has(args.session);
    if (kind === "open") FakeWorker.open.add(args.session);
    if (kind === "close") FakeWorker.open.delete(args.session);
    FakeWorker.most = Math.max(FakeWorker.most, FakeWorker.open.size);
    const rays = (args.queries?.length ?? 0) / 3;
    const counted = rays * (args.frames?.length ?? 0);
    const value = { threads: 1, tracks: new Float32Array(2 * counted), occlusion: new Float32Array(counted), rgb: args.queries };
    const data = known || kind === "open" ? { id, value } : { id, error: "not open" };
    queueMicrotask(() => this.onmessage?.({ data }));
  }
  terminate(): void {
    this.ended = true;
  }
}

beforeEach(() => {
  Object.assign(FakeWorker, { open: new Set(), most: 0, asked: [] });
  vi.stubGlobal("Worker", FakeWorker);
  vi.stubGlobal("document", { baseURI: "http://here/" });
});
afterEach(() => vi.unstubAllGlobals());

it("a closed model refuses to answer", async () => {
  const model = await Model.open("m.onnx", ONE);
  await model.render(new Float32Array(3));
  model.close();
  await expect(model.render(new Float32Array(3))).rejects.toThrow("The model was closed before it had answered.");
});

it.each([[16 * 2 ** 20, true], [16 * 2 ** 20 + 1, false]])("of a model file of %d bytes, what is to be prepared: %s", async (length, prepared) => {
  const bytes = new Uint8Array(length);
  bytes[0] = 1;
  const model = await Model.open("m.onnx", { has: () => true, read: async () => bytes.buffer });
  expect(FakeWorker.asked.filter(({ kind }) => kind === "open").map(({ args }) => args.prepared)).toEqual([prepared]);
  model.close();
});

describe("a model folder", () => {
  const windows = Array.from({ length: 7 }, (_, number) => ({ name: `window-00${number}`, begin: 10 * number, end: 10 * number + 12 }));
  const said = { format_version: 1, clip: "walk", num_frames: 72, height: 3, width: 4, fps: 10, pixel_aspect: 1, seconds: null, windows };
  const lengths = Object.fromEntries(windows.map(({ name }) => [`model/${name}.onnx`, 12]));
  const opened = (changes: object = {}, sizes: Record<string, number> = lengths) => {
    const { files, read } = filesOf(sizes, { "model/windows.json": { ...said, ...changes } });
    return { model: Model.open("model/windows.json", files), read };
  };

  it("is one clip, whose models are read when they are first asked", async () => {
    const { model, read } = opened();
    expect((await model).facts).toMatchObject({ clipName: "walk", numFrames: 72, fps: 10, preset: "cpu" });
    expect(read).toEqual(["model/windows.json", "model/window-000.onnx"]);
    const shares: number[] = [];
    const { tracks, occlusion } = await (await model).track(Float32Array.of(0, 1, 1, 71, 1, 1), (share) => shares.push(share));
    expect([tracks.length, occlusion.length]).toEqual([2 * 2 * 72, 2 * 72]);
    expect(new Set(read).size).toBe(8);
    expect(shares).toEqual([...shares].sort((a, b) => a - b));
    expect(shares.at(-1)).toBe(1);
  });

  it("has few models open at a time, whoever asks", async () => {
    const model = await opened().model;
    const work = [0, 35, 71, 50, 20].map((t) => model.track(Float32Array.of(t, 1, 1)));
    const pictures = [5, 70, 33, 5, 60, 14].map((t) => model.render(Float32Array.of(t, 1, 1)));
    await Promise.all([...work, ...pictures]);
    expect(FakeWorker.most).toBe(3);
    await model.render(Float32Array.of(0, 1, 1));
    expect(FakeWorker.open.size).toBe(3);
  });

  it("is asked for a ray in the window of its frame, which counts from its first", async () => {
    const model = await opened().model;
    expect((await model.render(Float32Array.of(35, 2, 1, 35, 3, 2))).rgb).toEqual(Float32Array.of(5, 2, 1, 5, 3, 2));
  });

  it("is rendered by WebAssembly", async () => {
    const requestAdapter = vi.fn(async () => ({ info: {} }));
    vi.stubGlobal("location", { search: "" });
    vi.stubGlobal("navigator", { gpu: { requestAdapter } });
    vi.stubGlobal("WebAssembly", { Suspending: class {} });
    const model = await opened().model;
    await model.tryWebgpu();
    expect(model.backend).toBe("wasm");
    expect(requestAdapter).not.toHaveBeenCalled();
  });

  it("is refused where a file is missing, or another's", async () => {
    const { "model/window-003.onnx": _, ...others } = lengths;
    await expect(opened({}, others).model).rejects.toThrow("model/window-003.onnx is missing beside model/windows.json");
    await expect(opened({}, { ...lengths, "model/window-000.onnx": 13 }).model).rejects.toThrow("window-000.onnx is of 13 frames of 4x3");
    await expect(opened({ width: 5 }).model).rejects.toThrow("and model/windows.json says otherwise");
    await expect(opened({ windows: [] }).model).rejects.toThrow(InputError);
  });

  it("goes on after a file could not be read", async () => {
    const { files } = filesOf(lengths, { "model/windows.json": said });
    let lost = true;
    const read = async (path: string): Promise<ArrayBuffer> => {
      if (lost && path.includes("003")) throw new InputError("it cannot be read");
      return files.read(path);
    };
    const model = await Model.open("model/windows.json", { ...files, read });
    await expect(model.track(Float32Array.of(0, 1, 1))).rejects.toThrow("it cannot be read");
    lost = false;
    expect((await model.track(Float32Array.of(0, 1, 1))).occlusion).toHaveLength(72);
  });
});

/** As `FakeWorker`; the first, WebAssembly's, is slow, the second, WebGPU's, is lost at its fourth rendering. */
class Contestant {
  static started = 0;
  onmessage: ((message: { data: unknown }) => void) | undefined;
  private readonly isGpu = Contestant.started++ === 1;
  private rendered = 0;
  postMessage({ id, kind }: Asked): void {
    const lost = this.isGpu && kind === "render" && ++this.rendered > 3;
    const seen = { rgb: Float32Array.of(0.5) };
    const value = kind === "render" ? seen : { threads: 1, tracks: new Float32Array(2), occlusion: new Float32Array(1) };
    setTimeout(() => this.onmessage?.({ data: lost ? { id, error: "device lost" } : { id, value } }), this.isGpu ? 0 : 30);
  }
  terminate(): void {}
}

it("layers are rendered on once WebGPU is lost", async () => {
  vi.stubGlobal("Worker", Contestant);
  vi.stubGlobal("location", { search: "" });
  vi.stubGlobal("navigator", { gpu: { requestAdapter: async () => ({ info: {} }) } });
  vi.stubGlobal("WebAssembly", { Suspending: class {} });
  const model = await Model.open("m.onnx", ONE);
  await model.tryWebgpu();
  expect(model.backend).toBe("webgpu");
  const ask = (): Promise<unknown> => model.render(new Float32Array(3));
  for (let time = 0; time < 3; time++) expect(await ask()).toEqual({ rgb: Float32Array.of(0.5) });
  expect(model.backend).toBe("wasm");
});
