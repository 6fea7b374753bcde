import { readFileSync } from "node:fs";
import { encode } from "fast-png";
import { describe, expect, it } from "vitest";
import { Document } from "../src/document";
import { type Mark, drawnFrames, marked, redrawn, reordered, withoutDrawing } from "../src/drawings";
import { drawingsRecord, readDrawings } from "../src/files/drawings";
import { frameInName, labelPng, readLabels } from "../src/files/labels";
import { Sketch } from "../src/sketch";
import { Pen } from "../src/ui/pen";

const LABEL_PNGS: { what: string; png: string; labels: number[][] | null }[] = JSON.parse(
  readFileSync(new URL("../../../tests/recorded/label_pngs.json", import.meta.url), "utf8"),
);

const mark = (t: number): Mark => ({ kind: "area", t, ink: null, corners: [] });
const SIZE = { width: 5, height: 3 };

describe("layers in the document", () => {
  it("puts a layer there with its first mark, as one step", () => {
    const document = new Document();
    const layer = document.newDrawing("paint", "static");
    document.change((content) => marked(content, layer, [mark(4)]));
    document.change((content) => marked(content, layer, [mark(4)]));
    expect(document.drawings.map(({ id, on, marks }) => [id, on, marks.length])).toEqual([[layer.id, "static", 2]]);
    document.undo();
    document.undo();
    expect(document.drawings).toEqual([]);
    document.redo();
    expect(document.drawings[0]?.marks).toEqual([mark(4)]);
  });

  it("orders, changes and removes layers, and leaves the rest", () => {
    const document = new Document();
    const [a, b] = [document.newDrawing("paint", "seen"), document.newDrawing("paint", "seen")];
    for (const each of [a, b]) document.change((content) => marked(content, each, []));
    document.change((content) => reordered(content, a.id, 1));
    expect(document.drawings.map(({ id }) => id)).toEqual([b.id, a.id]);
    const before = document.content;
    document.change((content) => reordered(content, a.id, 1));
    expect(document.content).toBe(before);
    document.change((content) => redrawn(content, b.id, { shown: false }));
    expect(document.drawings.map(({ shown }) => shown)).toEqual([false, true]);
    document.change((content) => withoutDrawing(content, b.id));
    expect(document.drawings.map(({ id }) => id)).toEqual([a.id]);
  });

  it("numbers masks within what label images hold", () => {
    const document = new Document();
    for (const label of [255, 1, 3]) document.change((content) => marked(content, { ...document.newDrawing("mask", "seen"), label }, []));
    expect(document.newDrawing("mask", "seen").label).toBe(2);
  });

  it("gives masks of a project numbers of their own", () => {
    const document = new Document();
    const sketch = new Sketch(document, () => undefined, () => undefined);
    document.add([], sketch.layersOf([document.newDrawing("paint", "seen"), { ...document.newDrawing("mask", "seen"), label: 2 }]));
    document.add([], sketch.layersOf([{ ...document.newDrawing("mask", "seen"), label: 2 }, { ...document.newDrawing("mask", "seen"), label: 3 }]));
    expect(document.drawings.map(({ label }) => label)).toEqual([0, 2, 4, 3]);
  });

  it("numbers masks by the highest that is there", () => {
    const document = new Document();
    document.change((content) => marked(content, { ...document.newDrawing("mask", "seen"), label: 7 }, [mark(9), mark(2), mark(9)]));
    expect(document.newDrawing("mask", "seen").label).toBe(8);
    expect(document.newDrawing("paint", "seen").label).toBe(0);
    expect(document.drawings.map(drawnFrames)).toEqual([[2, 9]]);
  });
});

describe("drawings in a project", () => {
  const project = (drawings: unknown): Uint8Array => new TextEncoder().encode(JSON.stringify({ drawings }));

  it("come back as they were drawn, whatever their size and number", () => {
    const marks: Mark[] = [];
    const pen = new Pen({ onBegin: () => undefined, onDraft: () => undefined, onMark: (mark) => marks.push(mark) });
    Object.assign(pen, { size: 999, text: "far", picture: { width: 4000, height: 2, source: "AAAA" } });
    for (const tool of ["brush", "text", "picture"] as const) {
      pen.tool = tool;
      pen.press({ x: 1, y: 1 }, 0.5, 2);
      pen.go({ x: 4, y: 8 }, 0.5);
      pen.lift({ x: 4, y: 8 }, 1);
    }
    expect(marks.map(({ kind }) => kind)).toEqual(["stroke", "text", "picture"]);
    const document = new Document();
    for (let layer = 0; layer < 300; layer++) document.change((content) => marked(content, document.newDrawing("paint", "seen"), marks));
    const read = readDrawings("p.json", project(drawingsRecord(document.drawings)), { numFrames: 3 });
    expect(read).toEqual(document.drawings.map(({ id: _, ...drawing }) => drawing));
  });

  it.each([0, 1.5, 256, Number.NaN])("are refused with a mask of the number %d", (label) => {
    const mask = { ...new Document().newDrawing("mask", "seen"), label };
    expect(() => readDrawings("p.json", project([mask]), { numFrames: 3 })).toThrow("p.json, drawing 0 (counted from 0), is damaged");
  });
});

describe("label images", () => {
  const labels = Uint8Array.from({ length: 15 }, (_, index) => [0, 1, 3][index % 3] ?? 0);

  it("reads what it writes, and palettes", () => {
    expect([...readLabels("m.png", labelPng(SIZE, labels), SIZE)]).toEqual([...labels]);
    const palette = [[0, 0, 0], [200, 0, 0], [0, 200, 0], [0, 0, 200]];
    expect([...readLabels("m.png", encode({ ...SIZE, data: labels, channels: 1, depth: 8, palette }), SIZE)]).toEqual([...labels]);
  });

  it.each([
    [1, "iVBORw0KGgoAAAANSUhEUgAAAAUAAAADAQMAAABh+Fe7AAAABlBMVEUAAAD/AAAb/40iAAAADklEQVR4nGMIYFjBEAAAA94BSXfAiOEAAAAASUVORK5CYII="],
    [2, "iVBORw0KGgoAAAANSUhEUgAAAAUAAAADAgMAAAAmWC1rAAAADFBMVEUAAAD/AAAA/wAAAP+bwBPcAAAAEUlEQVR4nGOQZmAJvMLiKgIABogBoqvmt1sAAAAASUVORK5CYII="],
  ])("reads palettes of %d bits, several pixels in a byte", (bits, file) => {
    const read = readLabels("m.png", Uint8Array.from(atob(file), (letter) => letter.charCodeAt(0)), SIZE);
    expect([...read]).toEqual(Array.from({ length: 15 }, (_, index) => index % 2 ** bits));
  });

  it.each(LABEL_PNGS)("reads as decomo-propagate does: $what", ({ png, labels }) => {
    const read = (): number[] => [...readLabels("m.png", Uint8Array.from(atob(png), (letter) => letter.charCodeAt(0)), SIZE)];
    if (labels === null) expect(read).toThrow("m.png has colours");
    else expect(read()).toEqual(labels.flat());
  });

  it("tells the frame by the name: surely behind an @, perhaps by a number at its end", () => {
    expect(frameInName("cat@12.png", 30)).toEqual({ t: 12, sure: true });
    expect(frameInName("00012.png", 30)).toEqual({ t: 12, sure: false });
    expect(frameInName("frame-7.PNG", 30)).toEqual({ t: 7, sure: false });
    for (const name of ["12@cat.png", "mask.png", "00030.png", "12"]) expect(frameInName(name, 30)).toBeUndefined();
    expect(() => frameInName("cat@30.png", 30)).toThrow("cat@30.png is of frame 30, as its name says, but the clip has frames 0 to 29");
  });

  it("says what is wrong", () => {
    const png = (given: object): Uint8Array => encode({ ...SIZE, data: labels, channels: 1, depth: 8, ...given });
    expect(() => readLabels("m.png", Uint8Array.of(1, 2), SIZE)).toThrow("m.png does not decode as a PNG");
    expect(() => readLabels("m.png", png({ channels: 3, data: Uint8Array.from({ length: 45 }, (_, index) => index) }), SIZE)).toThrow("has colours");
    expect(() => readLabels("m.png", png({}), { width: 3, height: 5 })).toThrow("is 5x3 but the clip is 3x5");
    expect(() => readLabels("m.png", png({ data: new Uint8Array(15) }), SIZE)).toThrow("is black");
    expect(() => readLabels("m.png", png({ data: new Uint16Array(15).fill(300), depth: 16 }), SIZE)).toThrow("above 255");
  });
});
