/** How good a fit is, by links that were held out of it: `decomotion/quality.py`, which states and explains it. */

/** Thresholds of the warning. */
const FEW_STEPS = 300;
const WELL_ABOVE = 3;
const SLACK = 0.5;
const TELLING = 50;

const LENGTHS = ["median", "p90", "median_pixels", "p90_pixels", "own_error"] as const;
const SHARES = ["within_1", "within_2", "within_4"] as const;

/** How far held-out links of one kind end from where the model leads; names are those of the file. */
export type Figures = Readonly<Record<"links" | (typeof LENGTHS)[number] | (typeof SHARES)[number], number>>;

export interface Quality {
  readonly steps: number;
  /** What of the links there was no time for. */
  readonly thinned: string | null;
  readonly all: Figures;
  /** All figures there are, each with the name of its kind of link, `all` first. */
  readonly rows: readonly (readonly [string, Figures])[];
}

/** Reads what `Quality.as_json` of Python writes, parsed; `RangeError` where something is missing or impossible. */
export function readQuality(content: unknown): Quality {
  const { steps, thinned, all, static: fixed, dynamic, gaps } = entries(content);
  if (!(thinned === null || typeof thinned === "string") || !Array.isArray(gaps)) throw new RangeError("no quality");
  const whole = figures(all);
  const kinds = [["static", fixed], ["dynamic", dynamic]] as const;
  const volumes = kinds.flatMap(([name, each]) => (each === null ? [] : [[name, figures(each)] as const]));
  let last = 0;
  const apart = gaps.map((each: unknown) => {
    const gap = entries(each);
    const [shortest, longest] = [count(gap.shortest), count(gap.longest)];
    if (shortest <= last || longest < shortest) throw new RangeError("gaps that overlap");
    last = longest;
    return [`gap ${shortest}${longest > shortest ? ` to ${longest}` : ""}`, figures(gap.figures)] as const;
  });
  return { steps: count(steps), thinned, all: whole, rows: [["all", whole], ...volumes, ...apart] };
}

/** Of those that tell, the one whose held-out links are missed the most in the median. */
export function worst(qualities: readonly (Quality | undefined)[]): Quality | undefined {
  const told = qualities.filter((each) => each !== undefined);
  return told.reduce<Quality | undefined>((a, b) => (a && a.all.median >= b.all.median ? a : b), undefined);
}

/** The figures of all links in a line. */
export function summary({ all }: Quality): string {
  const [median, medianPixels, p90, p90Pixels] = [all.median, all.median_pixels, all.p90, all.p90_pixels].map((each) => each.toFixed(2));
  const [one, two, four] = SHARES.map((name) => `${(100 * all[name]).toFixed(0)}%`);
  return (
    `held-out links are missed by ${median} px of 256 in the median (${medianPixels} px of the clip), ${p90} (${p90Pixels}) ` +
    `at the 90th percentile; ${one} are met within 1 px of 256, ${two} within 2, ${four} within 4`
  );
}

/** What is wrong with the fit, a sentence to which what to do may be added; undefined: nothing that can be told. */
export function warning({ steps, thinned, rows }: Quality): string | undefined {
  const starved: string[] = [];
  if (steps < FEW_STEPS) starved.push(`it took ${steps} step${steps > 1 ? "s" : ""}, which is few`);
  if (thinned !== null) starved.push(`its links are thinned (${thinned})`);
  const missed = rows
    .filter(([, { links, median, own_error }]) => links >= TELLING && median > WELL_ABOVE * own_error + SLACK)
    .map(
      ([name, { median, own_error }]) =>
        `held-out links${name === "all" ? "" : ` (${name})`} are missed by ${short(median)} px of 256 in the median where ` +
        `they are good to ${short(own_error)}, so that the flow it came from may be better`,
    );
  if (starved.length + missed.length === 0) return undefined;
  const what = starved.length > 0 ? "the fit is starved" : "the fit falls short of its links";
  return `${what}: ${[...starved, ...missed.slice(0, 1)].join(", ")}`;
}

const short = (value: number): string => String(Number(value.toPrecision(2)));

function figures(content: unknown): Figures {
  const said = entries(content);
  const read = Object.fromEntries([...LENGTHS, ...SHARES].map((name) => [name, number(said[name])]));
  const found = { ...read, links: count(said.links) } as Figures;
  const { median, p90, median_pixels, p90_pixels, within_1, within_2, within_4 } = found;
  if (median > p90 || median_pixels > p90_pixels) throw new RangeError("a median above its 90th percentile");
  if (within_1 > within_2 || within_2 > within_4 || within_4 > 1) throw new RangeError("shares that are none");
  return found;
}

function entries(content: unknown): Readonly<Record<string, unknown>> {
  if (typeof content !== "object" || content === null) throw new RangeError("no quality");
  return content as Record<string, unknown>;
}

function number(value: unknown): number {
  if (typeof value !== "number" || !(value >= 0 && Number.isFinite(value))) throw new RangeError("no figure");
  return value;
}

function count(value: unknown): number {
  if (!Number.isInteger(value) || number(value) < 1) throw new RangeError("no count");
  return number(value);
}
