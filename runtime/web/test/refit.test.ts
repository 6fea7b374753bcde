import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";

/** Tokens of the requests. */
let sent: string[];
let address: { hash: string; pathname: string; search: string };

beforeEach(() => {
  vi.resetModules();
  sent = [];
  address = { hash: "#token=first", pathname: "/", search: "?a=b" };
  vi.stubGlobal("location", address);
  vi.stubGlobal("history", { replaceState: () => (address.hash = "") });
  vi.stubGlobal("fetch", async (_: string, { headers }: { headers: Record<string, string> }) => {
    sent.push(headers["X-Decomo-Token"] ?? "");
    return { ok: true, status: 200, json: async () => ({}) };
  });
});

afterEach(() => vi.unstubAllGlobals());

const refits = async () => new (await import("../src/refit")).Refits();

describe("the token of a refit", () => {
  it("is taken out of the address, also when a later start of decomo-view has another", async () => {
    const kept = new Map<string, string>();
    vi.stubGlobal("localStorage", { getItem: (key: string) => kept.get(key) ?? null, setItem: (key: string, value: string) => kept.set(key, value) });
    const asked = await refits();
    await asked.cancel();
    expect(address.hash).toBe("");
    await asked.cancel();
    address.hash = "#token=second";
    await asked.cancel();
    expect([...kept.values()]).toEqual(["second"]);
    kept.set([...kept.keys()][0] ?? "", "third"); // by another tab
    await asked.cancel();
    expect(sent).toEqual(["first", "first", "second", "third"]);
  });

  it("is known to the page alone where the browser keeps nothing", async () => {
    const refuse = (): never => {
      throw new Error("denied");
    };
    vi.stubGlobal("localStorage", { getItem: refuse, setItem: refuse });
    const asked = await refits();
    await asked.cancel();
    await asked.cancel();
    expect(sent).toEqual(["first", "first"]);
  });
});
