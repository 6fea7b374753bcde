/** What the page and a worker that runs models say to each other. */

import type { APPEARANCE } from "./contract";

export type Backend = "wasm" | "webgpu";

/** Colours and the rest along N rays, as the model file names them; `static_opacity` is 1 in files that do not say. */
export type Appearance = Readonly<Record<(typeof APPEARANCE)[number], Float32Array>>;

export interface Tracked {
  /** [N, M, 2], (x, y) in pixels of the clip. */
  readonly tracks: Float32Array;
  /** [N, M], score in [0, 1]. */
  readonly occlusion: Float32Array;
}

export interface Opened {
  /** Threads of one operator. */
  readonly threads: number;
}

/**
 * `session`: a model that is open, by a number of the page's choice; `base`: where the page lies, with `runtime/`;
 * `prepared`: what follows from the model's numbers alone is computed once, when it is opened, and not with each answer.
 */
export interface Requests {
  open: { args: { session: number; model: ArrayBuffer; base: string; backend: Backend; prepared: boolean }; answer: Opened };
  close: { args: { session: number }; answer: null };
  track: { args: { session: number; queries: Float32Array; frames: readonly number[] }; answer: Tracked };
  render: { args: { session: number; queries: Float32Array }; answer: Appearance };
}

export type Kind = keyof Requests;
export type Request = { [K in Kind]: { id: number; kind: K; args: Requests[K]["args"] } }[Kind];
export type Answer = { id: number } & ({ value: Requests[Kind]["answer"] } | { error: string });
