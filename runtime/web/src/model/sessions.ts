/** A worker and the models that it has open: each is opened when it is first asked, and few stay so. */

import { InputError, type ModelFacts } from "./facts";
import type { Answer, Backend, Kind, Request, Requests } from "./protocol";

/** Models that a worker has open at a time. */
const MOST_OPEN = 3;
/**
 * Bytes of a model that is prepared when it is opened, which takes some twenty times as many, and a worker's memory never
 * shrinks. What is larger is opened as it is: each answer comes later, by 0.1 to 0.2 s of a file of 40 MB.
 */
const MOST_PREPARED = 16 * 2 ** 20;
const CLOSED = "The model was closed before it had answered.";

/** A model file, read and checked. */
export interface ModelFile {
  readonly path: string;
  readonly bytes: ArrayBuffer;
  readonly facts: ModelFacts;
}

/** One of them that the worker has open, under a number that no other ever has. */
interface Open {
  readonly session: number;
  readonly facts: ModelFacts;
}

export class Sessions {
  /** Threads of one operator. */
  threads = 1;
  private readonly runner: Runner;
  /** By the model's number, the last used last. */
  private readonly opened = new Map<number, Open>();
  /** Ends when all is opened that was asked for: one after the other, so that nobody's is closed before it is used. */
  private turn: Promise<unknown> = Promise.resolve();
  private lastSession = 0;

  /** `load` reads the file of the model with a number. */
  constructor(
    worker: Worker,
    private readonly backend: Backend,
    private readonly load: (number: number) => Promise<ModelFile>,
  ) {
    this.runner = new Runner(worker);
  }

  /** What the model `number` answers; `InputError` where it cannot be opened. */
  async ask<K extends "track" | "render">(
    kind: K,
    number: number,
    args: Omit<Requests[K]["args"], "session">,
  ): Promise<Requests[K]["answer"]> {
    const [answer] = await this.whileOpen(number, ({ session }) => [this.runner.ask(kind, { session, ...args } as Requests[K]["args"])]);
    return answer;
  }

  /** What the file of the model `number` says of itself; `InputError` where it cannot be opened. */
  facts(number: number): Promise<ModelFacts> {
    return this.whileOpen(number, ({ facts }) => facts);
  }

  close(): void {
    this.runner.close();
  }

  /** Calls `action`, which must not wait, while the model `number` is open. */
  private async whileOpen<T>(number: number, action: (open: Open) => T): Promise<T> {
    const open = this.use(number);
    if (open !== undefined) return action(open);
    const result = this.turn.then(async () => action(this.use(number) ?? (await this.open(number))));
    this.turn = result.catch(() => undefined);
    return result;
  }

  private use(number: number): Open | undefined {
    const open = this.opened.get(number);
    if (open === undefined) return undefined;
    this.opened.delete(number); // to the end of the order in which they are closed
    this.opened.set(number, open);
    return open;
  }

  private async open(number: number): Promise<Open> {
    const { path, bytes, facts } = await this.load(number);
    for (const [oldest, { session }] of this.opened) {
      if (this.opened.size < MOST_OPEN) break;
      this.opened.delete(oldest);
      await this.runner.ask("close", { session });
    }
    const session = ++this.lastSession;
    const base = new URL("./", document.baseURI).href;
    const args = { session, model: bytes, base, backend: this.backend, prepared: bytes.byteLength <= MOST_PREPARED };
    this.threads = (await runs(path, this.runner.ask("open", args, [bytes]))).threads;
    this.opened.set(number, { session, facts });
    return { session, facts };
  }
}

/** What is answered; an error that is not bad input already says that the model `path` does not run. */
export async function runs<T>(path: string, answer: Promise<T>): Promise<T> {
  try {
    return await answer;
  } catch (error) {
    if (error instanceof InputError) throw error;
    const reason = error instanceof Error ? error.message : String(error);
    throw new InputError(`${path} does not run in this browser (${reason}); try another browser, or export it again.`);
  }
}

/** Promises in front of a worker. */
class Runner {
  private readonly waiting = new Map<number, { resolve: (value: never) => void; reject: (error: Error) => void }>();
  private lastId = 0;
  private closed = false;

  constructor(private readonly worker: Worker) {
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

  /** `given` is handed over, not copied. */
  ask<K extends Kind>(kind: K, args: Requests[K]["args"], given: Transferable[] = []): Promise<Requests[K]["answer"]> {
    const id = ++this.lastId;
    return new Promise((resolve, reject) => {
      if (this.closed) throw new InputError(CLOSED);
      this.waiting.set(id, { resolve, reject });
      this.worker.postMessage({ id, kind, args } as Request, given);
    });
  }

  close(): void {
    this.closed = true;
    this.worker.terminate();
    for (const { reject } of this.waiting.values()) reject(new InputError(CLOSED));
    this.waiting.clear();
  }
}
