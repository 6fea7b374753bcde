/** Refits by `decomo-view`, which runs them beside the page: asked for, watched and decided on. One is there for all tabs. */

import { InputError } from "./model/facts";

const ADDRESS = "refit";
const TOKEN_HEADER = "X-Decomo-Token";
const TOKEN_KEY = "decomo-token";
/** Between two looks; longer where the server did not answer. */
const MILLISECONDS = { usual: 500, lost: 2000 };

/** What `decomo-view` says of the last refit. */
export interface RefitState {
  /** Of the refit, counted from 1; 0 where there was none. */
  readonly number: number;
  readonly state: "idle" | "running" | "finished" | "taken" | "rejected" | "cancelled" | "failed";
  /** What is done of the step that it is at, from 0 to 1; null where nobody knows. */
  readonly share: number | null;
  /** One line: of its progress, or why it failed. */
  readonly said: string;
  /** Path of the new model beside the page, once finished. */
  readonly model: string | null;
  /** Folder of the new run, and the file or folder of its model, once finished. */
  readonly run: string | null;
  readonly file: string | null;
}

let taken = "";

/**
 * The token of the address, `#token=…`, taken out of it, or else the one that this or another tab of this server was given.
 * `decomo-view` has another one after each start: what its page is told then, it uses.
 */
export function takeToken(): string {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given !== null) {
    history.replaceState(null, "", location.pathname + location.search);
    taken = given;
  }
  try {
    if (given !== null) localStorage.setItem(TOKEN_KEY, given);
    return localStorage.getItem(TOKEN_KEY) ?? taken;
  } catch {
    return taken; // this browser keeps nothing for pages
  }
}

export class Refits {
  /** Begins one with the text of a corrections.csv. */
  begin(corrections: string): Promise<RefitState> {
    return this.ask("POST", "", corrections);
  }

  cancel(): Promise<RefitState> {
    return this.ask("POST", "/cancel");
  }

  /** Decides on the refit with that number. */
  decide(verdict: "take" | "reject", number: number): Promise<RefitState> {
    return this.ask("POST", `/${verdict}`, String(number));
  }

  /** Tells every state that is another than before, and with `onLost` when the server does not answer or refuses to. */
  async watch(onState: (state: RefitState) => void, onLost: (error: Error) => void): Promise<never> {
    let last = "";
    for (;;) {
      const state = await this.ask("GET", "").catch((error: Error) => error);
      const text = state instanceof Error ? state.message : JSON.stringify(state);
      if (state instanceof Error) onLost(state);
      else if (text !== last) onState(state);
      last = text;
      await new Promise((done) => setTimeout(done, state instanceof Error ? MILLISECONDS.lost : MILLISECONDS.usual));
    }
  }

  private async ask(method: "GET" | "POST", path: string, body?: string): Promise<RefitState> {
    const request = { method, headers: { [TOKEN_HEADER]: takeToken() }, ...(body === undefined ? {} : { body }) };
    const response = await fetch(ADDRESS + path, request).catch(() => undefined);
    if (response === undefined) throw new InputError("decomo-view has ended, so nothing is refitted; start it again. What you did is still here to be saved.");
    if (response.status === 403) {
      throw new InputError("This page may not refit: open the whole address that decomo-view printed, with what follows the #.");
    }
    const answer = await response.json().catch(() => ({}));
    if (!response.ok) throw new InputError(String(answer.error ?? `decomo-view answered with ${response.status}; start it again.`));
    return answer;
  }
}
