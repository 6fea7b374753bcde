/** Runs the model in a worker, one request after the other, so that the page never waits. */

import type * as Ort from "onnxruntime-web";
import { APPEARANCE, TRACKING } from "./contract";
import type { Answer, Appearance, Backend, Opened, Request, Tracked } from "./protocol";

type Runtime = typeof Ort;

const ERRORS_ONLY = "error";

/** Answers the page's requests with `ort`, whose binary is `runtime/<backend>.wasm.gz`. */
export function serve(ort: Runtime): void {
  let session: Ort.InferenceSession | undefined;
  let queue: Promise<void> = Promise.resolve();

  async function answer(request: Request): Promise<Opened | Tracked | Appearance> {
    if (request.kind === "open") {
      const { model, base, backend } = request.args;
      await session?.release();
      session = await open(ort, model, base, backend);
      return { threads: ort.env.wasm.numThreads ?? 1 };
    }
    if (session === undefined) throw new Error("no model is open");
    return request.kind === "track"
      ? ask(ort, session, TRACKING, request.args.queries, request.args.numFrames)
      : ask(ort, session, APPEARANCE, request.args.queries, 0);
  }

  self.onmessage = ({ data: request }: MessageEvent<Request>) => {
    queue = queue.then(async () => {
      let reply: Answer;
      try {
        reply = { id: request.id, value: await answer(request) };
      } catch (error) {
        reply = { id: request.id, error: error instanceof Error ? error.message : String(error) };
      }
      self.postMessage(reply);
    });
  };
}

async function open(ort: Runtime, model: ArrayBuffer, base: string, backend: Backend): Promise<Ort.InferenceSession> {
  if (ort.env.wasm.wasmBinary === undefined) {
    ort.env.logLevel = ERRORS_ONLY;
    ort.env.wasm.wasmPaths = { mjs: `${base}runtime/${backend}.mjs` };
    ort.env.wasm.wasmBinary = await fetchUnpacked(`${base}runtime/${backend}.wasm.gz`);
  }
  return ort.InferenceSession.create(new Uint8Array(model), {
    executionProviders: [backend],
    logSeverityLevel: 3,
  });
}

/** The unpacked content of a gzip file, also where the host has already unpacked it on the way. */
async function fetchUnpacked(url: string): Promise<ArrayBuffer> {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url} cannot be loaded (${response.status}); build or install the page again.`);
  const content = await response.blob();
  const [first, second] = new Uint8Array(await content.slice(0, 2).arrayBuffer());
  if (first !== 0x1f || second !== 0x8b) return content.arrayBuffer();
  return new Response(content.stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

async function ask<Name extends string>(
  ort: Runtime,
  session: Ort.InferenceSession,
  outputs: readonly Name[],
  queries: Float32Array,
  numFrames: number,
): Promise<Record<Name, Float32Array>> {
  const frames = BigInt64Array.from({ length: numFrames }, (_, frame) => BigInt(frame));
  const inputs = {
    queries: new ort.Tensor("float32", queries, [queries.length / 3, 3]),
    frames: new ort.Tensor("int64", frames, [numFrames]),
  };
  const answers = await session.run(inputs, outputs.filter((name) => session.outputNames.includes(name)));
  const opaque = new Float32Array(queries.length / 3).fill(1);
  return Object.fromEntries(outputs.map((name) => [name, answers[name]?.data ?? opaque])) as Record<Name, Float32Array>;
}
