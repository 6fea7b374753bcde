/**
 * The one order of a clip's frames, by the names of their files.
 *
 * The rules are those of `decomotion/frame_order.py`, which states and explains them, function by function; both are
 * held to `tests/recorded/frame_order.json`.
 */

import { InputError } from "./model/facts";

/** Text and numbers in turn; text, which may be empty, is first and last. */
type Key = readonly (string | bigint)[];

/** How a name is cut: whether a dash may be a minus and a dot a decimal point. */
interface Reading {
  readonly minus?: boolean;
  readonly decimal?: boolean;
}

/** The names in their order; `InputError` where they are of two clips, or nothing tells which of two orders is meant. */
export function frameOrder(given: Iterable<string>): string[] {
  const names = [...given].sort(byCodePoints);
  checkSingle(names);
  const keys = new Keys(names);
  checkSeries(names, keys);
  const minus = hasMinus(names, keys);
  return keys.sorted({ minus, decimal: hasDecimals(names, keys, minus) });
}

/** The keys of some names. Numbers are counted in the smallest decimal place of all. */
class Keys {
  readonly places: number;

  constructor(private readonly names: readonly string[]) {
    this.places = Math.max(0, ...names.flatMap(fractionsOf).map((digits) => digits.length));
  }

  of(name: string, { minus = false, decimal = false }: Reading = {}): Key {
    const number = `${minus ? "-?" : ""}[0-9]+${decimal ? "(?:[.,][0-9]+)?" : ""}`;
    let alone = `(?<![0-9])(?<![0-9]\\.)${number}(?!\\.?[0-9])`; // 1.2.3 is no decimal number
    if (decimal) alone = `(?<![0-9],(?=[0-9]))${alone}(?!,[0-9])`;
    const parts = stem(name).toLowerCase().normalize("NFC").split(new RegExp(`(${alone}|[0-9]+)`));
    return parts.map((part, index) => (index % 2 ? this.count(part) : part));
  }

  sorted(reading: Reading): string[] {
    const keyed = this.names.map((name) => ({ name, key: this.of(name, reading) }));
    return keyed.sort((a, b) => byKeys(a.key, b.key) || byCodePoints(a.name, b.name)).map(({ name }) => name);
  }

  private count(number: string): bigint {
    const [whole = "", fraction = ""] = number.split(/[.,]/);
    return BigInt(whole.replace("-", "") + fraction.padEnd(this.places, "0")) * (whole.startsWith("-") ? -1n : 1n);
  }
}

/** Refuses two files of one name. */
function checkSingle(names: readonly string[]): void {
  const named = new Map<string, string>();
  for (const name of names) {
    const other = named.get(stem(name));
    if (other === name) throw new InputError(`Two files are called ${name}; give the frames of one folder.`);
    if (other !== undefined) {
      throw new InputError(
        `${other} and ${name} differ in their ending alone; keep frames and their masks in folders of their own.`,
      );
    }
    named.set(stem(name), name);
  }
}

/** Refuses two series that have the same numbers, as `0001.png` and `0001_mask.png`. */
function checkSeries(names: readonly string[], keys: Keys): void {
  const series = new Map<string, Map<string, string>>();
  for (const name of names) {
    const key = keys.of(name);
    if (key.length === 1) continue; // no number
    const words = asText(key.filter((part) => typeof part === "string").map((part) => part.replace(/[^\p{L}]/gu, "")));
    const numbers = asText(key.filter((part) => typeof part === "bigint"));
    series.set(words, (series.get(words) ?? new Map<string, string>()).set(numbers, name));
  }
  const all = [...series.values()];
  all.forEach((one, index) => {
    for (const other of all.slice(index + 1)) {
      const shared = [...one.keys()].filter((numbers) => other.has(numbers));
      const [first] = shared;
      if (first === undefined || shared.length < 2) continue;
      const pair = [one.get(first) ?? "", other.get(first) ?? ""].sort(byCodePoints);
      throw new InputError(
        `${pair.join(" and ")} have one number, and so have ${shared.length - 1} more pairs: two clips, or frames and ` +
          "their masks; keep them in folders of their own.",
      );
    }
  });
}

/** Whether a dash before a number is a minus: where others have a number there without one, as `-1` and `0`. */
function hasMinus(names: readonly string[], keys: Keys): boolean {
  const signed = new Map<string, { before: string; name: string }>();
  const plain = new Set<string>();
  for (const name of names) {
    const key = keys.of(name, { minus: true, decimal: true });
    key.forEach((part, place) => {
      if (typeof part === "string") return;
      const before = key.slice(0, place);
      if (part < 0n) signed.set(asText(before), { before: String(before.at(-1)), name });
    });
    for (const way of [key, keys.of(name, { minus: true })]) { // (0,-1) and (0,1) are no decimal numbers
      way.forEach((part, place) => {
        if (typeof part === "bigint" && part >= 0n) plain.add(asText(way.slice(0, place)));
      });
    }
  }
  if ([...signed.keys()].some((before) => plain.has(before))) return true;
  for (const { before, name } of signed.values()) {
    if (!/\p{L}$/u.test(before) && !same(keys.sorted({ minus: true }), keys.sorted({}))) {
      throw new InputError(
        `The number of ${name} has a minus or a dash before it, which makes two orders; rename the frames.`,
      );
    }
  }
  return false;
}

/** Whether a dot or a comma between numbers is a decimal point; false too where it makes no other order. */
function hasDecimals(names: readonly string[], keys: Keys, minus: boolean): boolean {
  if (minus && names.some((name) => /[0-9],-[0-9]/.test(name))) return false; // two numbers, as in (0,-1)
  const [counted, measured] = [keys.sorted({ minus }), keys.sorted({ minus, decimal: true })];
  const inOrder = measured.map((name) => keys.of(name, { minus, decimal: true }));
  if (same(counted, measured) || inOrder.some((key, index) => index > 0 && byKeys(inOrder[index - 1] ?? [], key) === 0)) {
    return false;
  }
  const longer = names.flatMap(fractionsOf).filter((digits) => digits.length > 1);
  if (longer.some((digits) => digits.startsWith("0"))) return true;
  if (!longer.some((digits) => digits.endsWith("0")) && evenlySpaced(inOrder)) return true;
  const first = counted.findIndex((name, index) => name !== measured[index]);
  throw new InputError(
    `${counted[first]} and ${measured[first]} follow each other in one order as decimal numbers and in the other as ` +
      "counters; give all names as many decimals.",
  );
}

/** Whether three names or more differ in one number alone, and by even steps as far as its digits tell. */
function evenlySpaced(keys: readonly Key[]): boolean {
  const [first] = keys;
  if (first === undefined || keys.length < 3 || keys.some((key) => key.length !== first.length)) return false;
  const changing = first.map((_, place) => place).filter((place) => keys.some((key) => key[place] !== first[place]));
  const numbers = keys.map((key) => key[changing[0] ?? 0]).filter((part) => typeof part === "bigint");
  if (changing.length > 1 || numbers.length === 0) return false;
  const steps = numbers.slice(1).map((number, index) => number - (numbers[index] ?? 0n));
  const spread = steps.reduce((a, b) => (a > b ? a : b)) - steps.reduce((a, b) => (a < b ? a : b));
  return spread <= 2n;
}

const stem = (name: string): string => name.replace(/(?<=.)\.[^.]+$/su, "");

/** The digits behind each dot or comma of a name. */
const fractionsOf = (name: string): string[] => [...stem(name).matchAll(/[.,]([0-9]+)/g)].map(([, digits]) => digits ?? "");

const asText = (parts: Key): string => JSON.stringify(parts.map(String));

const same = (a: readonly string[], b: readonly string[]): boolean => a.every((name, index) => name === b[index]);

function byKeys(a: Key, b: Key): number {
  for (let place = 0; place < Math.min(a.length, b.length); place++) {
    const [one, other] = [a[place], b[place]];
    const order = typeof one === "string" && typeof other === "string" ? byCodePoints(one, other) : sign(one, other);
    if (order !== 0) return order;
  }
  return a.length - b.length;
}

const sign = (a: string | bigint | undefined, b: string | bigint | undefined): number =>
  a === undefined || b === undefined || a === b ? 0 : a < b ? -1 : 1;

/** Not by UTF-16, as `<` does: it would put what lies beyond its first plane before U+E000. */
function byCodePoints(a: string, b: string): number {
  const [one, other] = [[...a], [...b]];
  for (let place = 0; place < Math.min(one.length, other.length); place++) {
    const difference = (one[place]?.codePointAt(0) ?? 0) - (other[place]?.codePointAt(0) ?? 0);
    if (difference !== 0) return difference;
  }
  return one.length - other.length;
}
