import { describe, expect, it } from "vitest";
import { Document, changed, colourOf, corrected, withoutCorrection, withoutCorrections, withoutPoint, withoutPoints } from "../src/document";
import { marked } from "../src/drawings";

const draft = (x: number) => ({ t: 0, x, y: 0 });
const at = (x: number, y: number) => ({ x, y });

/** A document with two points, the ids 1 and 2. */
function two(): Document {
  const document = new Document();
  document.add([draft(1), draft(2)]);
  return document;
}

const names = (document: Document) => document.points.map(({ name }) => name);
const frames = (document: Document) => document.corrections.map(({ point, t }) => [point, t]);

describe("the document", () => {
  it("undoes and redoes each change as one step, whatever it is of", () => {
    const document = two();
    document.change((content) => changed(content, 2, { name: "eye" }));
    document.change((content) => corrected(content, { point: 2, t: 3, place: null }));
    document.change((content) => withoutPoint(content, 1));
    expect(names(document)).toEqual(["eye"]);
    document.undo();
    document.undo();
    expect([names(document), frames(document)]).toEqual([["Point 1", "eye"], []]);
    document.redo();
    expect(frames(document)).toEqual([[2, 3]]);
    document.undo();
    document.undo();
    expect(names(document)).toEqual(["Point 1", "Point 2"]);
    document.change(withoutPoints);
    expect(document.canRedo).toBe(false);
    for (let step = 0; step < 9; step++) document.undo();
    expect(document.content).toEqual({ points: [], corrections: [], drawings: [] });
    expect(document.canUndo).toBe(false);
  });

  it("is unsaved where corrections or drawings are in no file", () => {
    const document = two();
    expect(document.isUnsaved).toBe(false); // points are quickly placed again
    document.change((content) => corrected(content, { point: 2, t: 3, place: null }));
    expect(document.isUnsaved).toBe(true);
    document.keep("corrections");
    expect(document.isUnsaved).toBe(false);
    const layer = document.newDrawing("paint", "static");
    document.change((content) => marked(content, layer, []));
    expect(document.isUnsaved).toBe(true);
    document.keep("corrections", "drawings");
    expect(document.isUnsaved).toBe(false);
    document.undo();
    expect(document.isUnsaved).toBe(false);
    document.redo();
    document.change((content) => withoutPoint(content, 1));
    document.change(withoutCorrections);
    expect(document.isUnsaved).toBe(false);
  });

  it("takes back what is on its way before what is there, which can be done again", () => {
    const document = two();
    const [first, second] = [document.expect(), document.expect()];
    document.undo();
    expect([document.isExpected(first), document.arrive(second)]).toEqual([true, false]);
    document.undo();
    document.giveUp(first);
    expect([names(document), document.canRedo]).toEqual([["Point 1", "Point 2"], false]);
    document.undo();
    expect([names(document), document.canUndo, document.canRedo]).toEqual([[], false, true]);
    const third = document.expect();
    expect(document.canUndo).toBe(true);
    document.reset();
    expect([document.arrive(third), document.canUndo]).toEqual([false, false]);
  });

  it("takes what a file holds as one step, which is as unsaved as what was there", () => {
    const document = two();
    const layer = document.newDrawing("paint", "static");
    const given = [{ t: 3, place: null }];
    const added = document.add([{ ...draft(7), given }], [layer]);
    expect([frames(document), document.drawings, document.isUnsaved]).toEqual([[[3, 3]], [layer], false]);
    document.forget(added, [layer]);
    expect([names(document), frames(document), document.drawings]).toEqual([["Point 1", "Point 2"], [], []]);
    document.change((content) => corrected(content, { point: 2, t: 3, place: null }));
    document.add([{ ...draft(7), given }], [layer]);
    expect(document.isUnsaved).toBe(true);
    document.undo();
    expect([names(document), document.drawings]).toEqual([["Point 1", "Point 2"], []]);
  });

  it("has one correction of a point in a frame, in the order of points and frames", () => {
    const document = two();
    for (const [point, t, x] of [[2, 4, 1], [1, 9, 2], [1, 3, 3], [2, 4, 4]] as const) {
      document.change((content) => corrected(content, { point, t, place: at(x, 0) }));
    }
    expect(document.corrections.map(({ point, t, place }) => [point, t, place?.x])).toEqual([[1, 3, 3], [1, 9, 2], [2, 4, 4]]);
    document.change((content) => withoutCorrection(content, { point: 1, t: 3 }));
    expect(frames(document)).toEqual([[1, 9], [2, 4]]);
    document.change((content) => withoutPoint(content, 1));
    expect(frames(document)).toEqual([[2, 4]]);
    document.change(withoutCorrections);
    expect([names(document), frames(document)]).toEqual([["Point 2"], []]);
  });

  it("takes no step where nothing changes", () => {
    const document = two();
    document.undo();
    document.change((content) => withoutCorrection(content, { point: 1, t: 3 }));
    expect(document.canRedo).toBe(true);
  });

  it("adds points with what is given of them as one step", () => {
    const document = two();
    document.add([{ ...draft(7), given: [{ t: 2, place: null }] }]);
    expect([names(document), frames(document)]).toEqual([["Point 1", "Point 2", "Point 3"], [[3, 2]]]);
    document.undo();
    expect([names(document), frames(document)]).toEqual([["Point 1", "Point 2"], []]);
  });

  it("gives corrections without a name to the point that has their query, and a named draft is a point of its own", () => {
    const document = two();
    const given = [{ t: 2, place: at(5, 6) }];
    expect(document.add([{ ...draft(2), given }])).toEqual([]);
    expect(frames(document)).toEqual([[2, 2]]);
    expect(document.add([{ ...draft(2), name: "eye", given }]).map(({ id }) => id)).toEqual([3]);
    expect(document.add([draft(2)]).map(({ id }) => id)).toEqual([4]);
  });

  it("takes points back that were not to be followed, as if it had always been so", () => {
    const document = two();
    const others = document.add([{ ...draft(3), given: [{ t: 2, place: null }] }]);
    document.change((content) => changed(content, 1, { name: "eye" }));
    document.undo();
    document.forget(others);
    expect([names(document), frames(document)]).toEqual([["Point 1", "Point 2"], []]);
    document.redo();
    expect([names(document), frames(document)]).toEqual([["eye", "Point 2"], []]);
    for (const expected of [2, 2, 0]) {
      document.undo();
      expect(document.points).toHaveLength(expected);
    }
  });

  it("knows the points that undo and redo can bring", () => {
    const document = two();
    document.change((content) => changed(content, 1, { x: 8 }));
    document.undo();
    document.undo();
    expect(new Set(document.everyPoint().map(({ x }) => x))).toEqual(new Set([1, 2, 8]));
  });

  it("gives neighbours colours that differ", () => {
    const colours = Array.from({ length: 12 }, (_, id) => colourOf(id));
    expect(new Set(colours).size).toBe(12);
    expect(colours.every((colour) => /^#[0-9a-f]{6}$/.test(colour))).toBe(true);
  });
});
