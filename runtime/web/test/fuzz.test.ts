/** Whatever a file holds, it is read, or refused in a sentence: the page is never left broken. */

import { zipSync } from "fflate";
import fc from "fast-check";
import { describe, test } from "vitest";
import { writeNpy } from "../src/files/npy";
import type { Query } from "../src/document";
import { readPoints } from "../src/files/read";
import { InputError, type ModelFacts, readFacts } from "../src/model/facts";
import { frameOrder } from "../src/order";
import { readWindows } from "../src/model/windows";
import { readSite } from "../src/site";

fc.configureGlobal({ seed: 22, numRuns: 300 });

const FACTS: ModelFacts = { clipName: "c", numFrames: 3, height: 8, width: 10, fps: 12, times: Array.from({ length: 3 }, (_, i) => i / 12), preset: "cpu", occlusionThreshold: 0.5, objectShare: 0.5 };

/** What `read` gives; undefined where it says in a sentence what is wrong. */
function orRefused<T>(read: () => T): T | undefined {
  try {
    return read();
  } catch (error) {
    if (error instanceof InputError && /^[^\n]+\.$/s.test(error.message.replace(/\n/g, " "))) return undefined;
    throw error;
  }
}

function arePoints(name: string, bytes: Uint8Array): boolean {
  const drafts = orRefused(() => readPoints(name, bytes, FACTS)) ?? [];
  return drafts.every(
    ({ t, x, y, given = [] }) => isQuery({ t, x, y }) && given.every((each) => isQuery({ x, y, ...each.place, t: each.t })) && drafts.length <= 2000,
  );
}

const isQuery = ({ t, x, y }: Query): boolean => [0, 1, 2].includes(t) && x >= -0.5 && x <= 9.5 && y >= -0.5 && y <= 7.5;

const bytesOf = (text: string): Uint8Array => new TextEncoder().encode(text);
const suffix = fc.constantFrom("csv", "json", "npz");
const cell = fc.oneof(fc.constantFrom("t", "x", "y", "0", "1", "2.5", '"', '""', ",", ";", "\t", "\n", "\r\n", "nan"), fc.string());
/** Anything that JSON can say, also where a list of points is wanted. */
const value = fc.oneof(fc.jsonValue(), fc.constantFrom({ valueOf: 1, toString: 1 }, { x: 1, y: 2, t: 0 }, 1e400, "constructor"));
const pointsFile = fc.record(
  { format: fc.oneof(fc.constant("decomotion.points"), value), version: value, clip: value, points: fc.oneof(fc.array(value), value) },
  { requiredKeys: [] },
);
const header = fc.oneof(
  fc.string(),
  fc
    .tuple(fc.constantFrom("<f4", "<i8", "|b1", ">f4", "|O", "constructor"), fc.array(fc.oneof(fc.integer(), fc.double(), fc.constant("x"))))
    .map(([dtype, shape]) => `{'descr': '${dtype}', 'fortran_order': False, 'shape': (${shape.join(",")}), }`),
);

describe("a file of points", () => {
  test("of any bytes", () => {
    fc.assert(fc.property(suffix, fc.uint8Array({ maxLength: 300 }), (kind, bytes) => arePoints(`p.${kind}`, bytes)));
  });

  test("of pieces of csv", () => {
    fc.assert(fc.property(fc.array(cell), (cells) => arePoints("p.csv", bytesOf(cells.join("")))));
    for (const header of ["t,x,y", "t,x,y,target_t,target_x,target_y", "point,frame,query_t,query_x,query_y"]) {
      fc.assert(fc.property(fc.array(cell), (cells) => arePoints("p.csv", bytesOf(`${header}\n${cells.join("")}`))));
      const row = fc.array(fc.constantFrom("0", "1", "2", "1.5", "", "x"), { minLength: 5, maxLength: 6 });
      fc.assert(fc.property(fc.array(row), (rows) => arePoints("p.csv", bytesOf([header, ...rows.map((cells) => cells.join())].join("\n")))));
    }
  });

  test("of any JSON", () => {
    const corrections = fc.array(fc.oneof(value, fc.record({ t: fc.nat(3), x: fc.nat(9), y: value, hidden: value }, { requiredKeys: ["t"] })));
    const points = fc.array(fc.record({ t: fc.nat(2), x: fc.nat(9), y: fc.nat(7), corrections: fc.oneof(corrections, value) }, { requiredKeys: ["t", "x", "y"] }));
    fc.assert(fc.property(points, (all) => arePoints("p.json", bytesOf(JSON.stringify({ points: all })))));
    fc.assert(fc.property(fc.oneof(value, pointsFile), (content) => arePoints("p.json", bytesOf(JSON.stringify(content)))));
  });

  test("of arrays with any header, cut anywhere", () => {
    fc.assert(
      fc.property(header, fc.nat(200), fc.constantFrom("queries", "height", "width"), (text, end, key) => {
        const array = writeNpy("<f4", [2, 3], [0, 1, 2, 1, 3, 4]);
        array.set(bytesOf(text).subarray(0, array.length - 10), 10);
        const file = zipSync({ "queries.npy": writeNpy("<f4", [1, 3], [0, 1, 2]), [`${key}.npy`]: array.subarray(0, end) });
        return arePoints("p.npz", file);
      }),
    );
  });
});

test("a model of any bytes", () => {
  const bytes = fc.oneof(fc.uint8Array({ maxLength: 300 }), fc.array(fc.constantFrom(0x3a, 0x72, 0x0a, 0x12, 2, 8, 255), { maxLength: 60 }).map((all) => Uint8Array.from(all)));
  fc.assert(fc.property(bytes, (file) => (orRefused(() => readFacts(file, "m.onnx"))?.numFrames ?? 1) >= 1));
});

test("any windows.json: its windows lead from the first frame to the last", () => {
  const whole = fc.integer({ min: -1, max: 12 });
  const window = fc.record({ name: fc.constantFrom("window-0", "window-1", "w", ""), begin: whole, end: whole });
  const numbers = { num_frames: whole, height: whole, width: whole, fps: whole, pixel_aspect: whole };
  const layout = fc.record({ format_version: fc.constantFrom(1, 2, null), clip: fc.string(), ...numbers, seconds: fc.oneof(fc.constant(null), value), windows: fc.array(window, { maxLength: 3 }), quality: value }, { requiredKeys: ["clip", "seconds"] });
  fc.assert(
    fc.property(fc.oneof(fc.string(), value.map((content) => JSON.stringify(content)), layout.map((content) => JSON.stringify(content))), (text) => {
      const { windows, facts } = orRefused(() => readWindows(text ?? "", "windows.json")) ?? {};
      return windows === undefined || (windows[0]?.begin === 0 && windows.at(-1)?.end === facts?.numFrames && facts?.times.length === facts?.numFrames);
    }),
  );
});

test("any site.json", () => {
  const site = fc.record({ model: value, refit: value, clip: fc.oneof(value, fc.record({ name: value, frames: fc.array(value) })) }, { requiredKeys: [] });
  fc.assert(
    fc.property(fc.oneof(fc.string(), site.map((content) => JSON.stringify(content))), (text) => {
      const read = orRefused(() => readSite(text));
      return read === undefined || (typeof read.refit === "boolean" && typeof read.model === "string" && (read.clip?.frames ?? []).every((path) => typeof path === "string"));
    }),
  );
});

test("any names of frames: all of them, whatever the order in which they are given", () => {
  const part = fc.oneof(fc.constantFrom("1", "0", "10", "-", ".", "_", "a", "A", " ", "(", "0.5", "\u{1f600}", "\uff46"), fc.string({ maxLength: 2 }));
  const names = fc.uniqueArray(fc.array(part, { maxLength: 5 }).map((parts) => `${parts.join("")}.png`), { maxLength: 6 });
  fc.assert(
    fc.property(names, (files) => {
      const [one, other] = [files, [...files].reverse()].map((given) => orRefused(() => frameOrder(given)));
      return JSON.stringify(one) === JSON.stringify(other) && (one === undefined || [...one].sort().join() === [...files].sort().join());
    }),
  );
});
