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
