import { describe, expect, it } from "vitest";
import type { Content } from "../src/document";
import { Answers, type Track, bend, isBent, misses } from "../src/tracks";

/** Seven frames; x runs 0, 10, …, y is 5; hidden in frames 4 and 5. */
const ANSWER: Track = {
  xy: Float32Array.from({ length: 14 }, (_, index) => (index % 2 === 0 ? 5 * index : 5)),
  occlusion: Float32Array.of(0, 0, 0, 0, 0.8, 0.9, 0.2),
  occluded: [false, false, false, false, true, true, false],
  error: Float32Array.of(1, 0, 1, 2, 8, 9, 3),
};
const QUERY = { t: 1, x: 10, y: 5 };
const at = (x: number, y: number) => ({ x, y });
const places = ({ xy }: Track) => Array.from({ length: 7 }, (_, frame) => [xy[2 * frame], xy[2 * frame + 1]]);
const hidden = ({ occluded }: Track) => occluded.map(Number).join("");

describe("a bent track", () => {
  it("is the answer where nothing is given", () => {
    expect(bend(ANSWER, QUERY, [])).toBe(ANSWER);
  });

  it("goes through what is given, in straight lines of the offset, held beyond the first and the last", () => {
    const bent = bend(ANSWER, QUERY, [{ t: 5, place: at(58, 1) }, { t: 3, place: at(34, 5) }]);
    expect(places(bent)).toEqual([[0, 5], [10, 5], [22, 5], [34, 5], [46, 3], [58, 1], [68, 1]]);
    const early = bend(ANSWER, { t: 6, x: 60, y: 5 }, [{ t: 4, place: at(40, 9) }]);
    expect(places(early).map(([, y]) => y)).toEqual([9, 9, 9, 9, 9, 7, 5]);
    expect([0, 4, 6].map((frame) => isBent({ track: early, answer: ANSWER }, frame))).toEqual([true, true, false]);
  });

  it("holds a state from its frame on, to the next that is given or to where the answer changes", () => {
    expect(hidden(bend(ANSWER, QUERY, [{ t: 2, place: null }]))).toBe("0011110");
    expect(hidden(bend(ANSWER, QUERY, [{ t: 2, place: null }, { t: 3, place: at(30, 5) }]))).toBe("0010110");
    expect(hidden(bend(ANSWER, QUERY, [{ t: 0, place: null }]))).toBe("1000110"); // the query ends it
    const seen = bend(ANSWER, QUERY, [{ t: 5, place: at(50, 5) }]);
    expect(hidden(seen)).toBe("0000100");
    expect(Array.from(seen.occlusion, (score) => Math.round(100 * score) / 100)).toEqual([0, 0, 0, 0, 0.8, 0, 0.2]);
  });

  it("has no error where it is given", () => {
    const bent = bend(ANSWER, QUERY, [{ t: 3, place: at(34, 5) }, { t: 6, place: null }]);
    expect([...bent.error]).toEqual([1, 0, 1, 0, 8, 9, 3]);
  });

  it("waits with places in frames that are not answered yet", () => {
    const part = { ...ANSWER, xy: ANSWER.xy.map((value, index) => (index < 6 ? value : Number.NaN)) };
    const bent = bend(part, QUERY, [{ t: 5, place: at(58, 1) }, { t: 2, place: at(20, 7) }]);
    expect(places(bent).slice(0, 3)).toEqual([[0, 5], [10, 5], [20, 7]]);
    expect(places(bent)[5]).toEqual([Number.NaN, Number.NaN]);
  });

  it("misses nothing that the answer missed", () => {
    const given = [{ t: 3, place: at(33, 9) }, { t: 2, place: null }];
    expect(misses(ANSWER, given)).toEqual([5]);
    expect(misses(bend(ANSWER, QUERY, given), given)).toEqual([0]);
  });
});

describe("answers", () => {
  const point = { id: 1, name: "a", colour: "#102030", ...QUERY };
  const correction = { point: 1, t: 3, place: at(33, 9) };

  it("are of a query, so that one that was asked before is known again", () => {
    const answers = new Answers();
    const elsewhere = { ...ANSWER };
    answers.set([QUERY, { ...QUERY, x: 11 }], [ANSWER, elsewhere]);
    const content = (x: number): Pick<Content, "points" | "corrections"> => ({ points: [{ ...point, x }], corrections: [] });
    expect(answers.follow(content(10))[0]?.answer).toBe(ANSWER);
    expect(answers.follow(content(11))[0]?.answer).toBe(elsewhere);
    expect(answers.follow(content(10))[0]?.answer).toBe(ANSWER);
    expect(answers.follow(content(12))).toEqual([]);
  });

  it("make a new object only of a point for which something has changed", () => {
    const answers = new Answers();
    answers.set([QUERY], [ANSWER]);
    const first = answers.follow({ points: [point], corrections: [] })[0];
    expect(answers.follow({ points: [{ ...point }], corrections: [] })[0]).toBe(first);
    const second = answers.follow({ points: [point], corrections: [correction] })[0];
    expect(second?.track).not.toBe(first?.track);
    const renamed = answers.follow({ points: [{ ...point, name: "b" }], corrections: [correction] })[0];
    expect([renamed?.name, renamed?.track]).toEqual(["b", second?.track]);
  });
});
