import { afterEach, expect, it, vi } from "vitest";
import { Model } from "../src/model/client";

vi.mock("../src/model/facts", async (original) => ({
  ...(await original<object>()),
  readFacts: () => ({ numFrames: 1, width: 1, height: 1 }),
}));

/** Answers at once, and no more once it is ended. */
class FakeWorker {
  onmessage: ((message: { data: unknown }) => void) | undefined;
  private ended = false;
  postMessage({ id }: { id: number }): void {
    const value = { threads: 1, tracks: new Float32Array(2), occlusion: new Float32Array(1) };
    if (!this.ended) queueMicrotask(() => this.onmessage?.({ data: { id, value } }));
  }
  terminate(): void {
    this.ended = true;
  }
}

afterEach(() => vi.unstubAllGlobals());

it("a closed model refuses to answer", async () => {
  vi.stubGlobal("Worker", FakeWorker);
  vi.stubGlobal("document", { baseURI: "http://here/" });
  const model = await Model.open(new ArrayBuffer(0), "m.onnx");
  await model.render(new Float32Array(3));
  model.close();
  await expect(model.render(new Float32Array(3))).rejects.toThrow("The model was closed before it had answered.");
});

/** As `FakeWorker`; the first, WebAssembly's, is slow, the second, WebGPU's, is lost at its fourth rendering. */
class Contestant {
  static started = 0;
  onmessage: ((message: { data: unknown }) => void) | undefined;
  private readonly isGpu = Contestant.started++ === 1;
  private rendered = 0;
  postMessage({ id, kind }: { id: number; kind: string }): void {
    const lost = this.isGpu && kind === "render" && ++this.rendered > 3;
    const seen = { rgb: Float32Array.of(0.5) };
    const value = kind === "render" ? seen : { threads: 1, tracks: new Float32Array(2), occlusion: new Float32Array(1) };
    setTimeout(() => this.onmessage?.({ data: lost ? { id, error: "device lost" } : { id, value } }), this.isGpu ? 0 : 30);
  }
  terminate(): void {}
}

it("layers are rendered on once WebGPU is lost", async () => {
  vi.stubGlobal("Worker", Contestant);
  vi.stubGlobal("document", { baseURI: "http://here/" });
  vi.stubGlobal("location", { search: "" });
  vi.stubGlobal("navigator", { gpu: { requestAdapter: async () => ({ info: {} }) } });
  vi.stubGlobal("WebAssembly", { Suspending: class {} });
  const model = await Model.open(new ArrayBuffer(0), "m.onnx");
  await model.tryWebgpu(new ArrayBuffer(0));
  expect(model.backend).toBe("webgpu");
  const ask = (): Promise<unknown> => model.render(new Float32Array(3));
  for (let time = 0; time < 3; time++) expect(await ask()).toEqual({ rgb: Float32Array.of(0.5) });
  expect(model.backend).toBe("wasm");
});
