/** Runs models in a worker, one request after the other, so that the page never waits. */

import type * as Ort from "onnxruntime-web";
import { APPEARANCE, TRACKING } from "./contract";
import type { Answer, Kind, Request, Requests } from "./protocol";

type Runtime = typeof Ort;

const ERRORS_ONLY = "error";

/** Answers the page's requests with `ort`, whose binary is `runtime/<backend>.wasm.gz`. */
export function serve(ort: Runtime): void {
  const sessions = new Map<number, Ort.InferenceSession>();
  let queue: Promise<void> = Promise.resolve();

  async function answer(request: Request): Promise<Requests[Kind]["answer"]> {
    if (request.kind === "open") {
      sessions.set(request.args.session, await open(ort, request.args));
      return { threads: ort.env.wasm.numThreads ?? 1 };
    }
    const session = sessions.get(request.args.session);
    if (session === undefined) throw new Error("that model is not open");
    if (request.kind === "close") {
      sessions.delete(request.args.session);
      await session.release();
      return null;
    }
    return request.kind === "track"
      ? ask(ort, session, TRACKING, request.args.queries, request.args.frames)
      : ask(ort, session, APPEARANCE, request.args.queries, []);
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

async function open(ort: Runtime, { model, base, backend, prepared }: Requests["open"]["args"]): Promise<Ort.InferenceSession> {
  if (ort.env.wasm.wasmBinary === undefined) {
    ort.env.logLevel = ERRORS_ONLY;
    ort.env.wasm.wasmPaths = { mjs: `${base}runtime/${backend}.mjs` };
    ort.env.wasm.wasmBinary = await fetchUnpacked(`${base}runtime/${backend}.wasm.gz`);
  }
  const session = await ort.InferenceSession.create(new Uint8Array(model), {
    executionProviders: [backend],
    graphOptimizationLevel: prepared ? "all" : "disabled",
    logSeverityLevel: 3,
  });
  model.transfer?.(0); // it is copied: its memory goes now, and not when this worker, which makes little garbage, collects it
  return session;
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
  frames: readonly number[],
): Promise<Record<Name, Float32Array>> {
  const inputs = {
    queries: new ort.Tensor("float32", queries, [queries.length / 3, 3]),
    frames: new ort.Tensor("int64", BigInt64Array.from(frames, BigInt), [frames.length]),
  };
  const answers = await session.run(inputs, outputs.filter((name) => session.outputNames.includes(name)));
  const opaque = new Float32Array(queries.length / 3).fill(1);
  return Object.fromEntries(outputs.map((name) => [name, answers[name]?.data ?? opaque])) as Record<Name, Float32Array>;
}
