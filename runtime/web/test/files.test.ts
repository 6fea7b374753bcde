import { unzipSync, zipSync } from "fflate";
import { describe, expect, it } from "vitest";
import { readNpy, writeNpy } from "../src/files/npy";
import { readPoints } from "../src/files/read";
import { correctionsCsv, pointsCsv, projectJson, tracksCsv, tracksNpz } from "../src/files/write";
import type { ModelFacts } from "../src/model/facts";
import type { Correction } from "../src/document";
import type { Followed } from "../src/tracks";

const FACTS: ModelFacts = { clipName: "c", numFrames: 2, height: 8, width: 10, fps: 12, times: Array.from({ length: 2 }, (_, i) => i / 12), preset: "cpu", occlusionThreshold: 0.5, objectShare: 0.5 };
const GIVEN: Correction[] = [{ point: 1, t: 0, place: { x: 1, y: 2 } }];
const POINTS: Followed[] = [
  {
    ...{ id: 1, name: 'a "b", c', colour: "#102030", t: 1, x: 2.25, y: -0.5 },
    track: { xy: Float32Array.of(1, 2, 2.25, -0.5), occlusion: Float32Array.of(0.75, 0), occluded: [true, false], error: Float32Array.of(6, 0) },
  },
  {
    ...{ id: 2, name: "d", colour: "#405060", t: 0, x: 9.5, y: 7.5 },
    track: { xy: Float32Array.of(9.5, 7.5, 11, 12), occlusion: Float32Array.of(0.25, 1), occluded: [false, true], error: Float32Array.of(0, 8) },
  },
].map((point) => ({ ...point, answer: point.track, given: [] }));
const DRAFTS = POINTS.map(({ name, colour, t, x, y }) => ({ name, colour, t, x, y }));
const bytes = (text: string): Uint8Array => new TextEncoder().encode(text);

describe("files of points", () => {
  it("writes tracks as decomo-track does", () => {
    expect(tracksCsv(POINTS, FACTS).split("\n")).toEqual([
      "point,frame,x,y,occlusion,occluded,query_t,query_x,query_y,time,error",
      "0,0,1.0000,2.0000,0.7500,1,1,2.2500,-0.5000,0.000000,6.0000",
      "0,1,2.2500,-0.5000,0.0000,0,1,2.2500,-0.5000,0.083333,0.0000",
      "1,0,9.5000,7.5000,0.2500,0,0,9.5000,7.5000,0.000000,0.0000",
      "1,1,11.0000,12.0000,1.0000,1,0,9.5000,7.5000,0.083333,8.0000",
      "",
    ]);
  });

  it("reads back what it writes", () => {
    expect(readPoints("p.csv", bytes(pointsCsv(POINTS)), FACTS)).toEqual(DRAFTS);
    expect(readPoints("p.json", bytes(projectJson(POINTS, FACTS)), FACTS)).toEqual(DRAFTS);
    const queries = DRAFTS.map(({ t, x, y }) => ({ t, x, y }));
    expect(readPoints("p.npz", tracksNpz(POINTS, FACTS), FACTS)).toEqual(queries);
  });

  it("reads tracks back as points", () => {
    const queries = DRAFTS.map(({ t, x, y }) => ({ t, x, y }));
    expect(readPoints("p.csv", bytes(tracksCsv(POINTS, FACTS)), FACTS)).toEqual(queries);
    expect(readPoints("p.csv", bytes(tracksCsv([...POINTS, ...POINTS], FACTS)), FACTS)).toHaveLength(4);
  });

  it("writes and reads corrections, the last two columns empty where a point is hidden", () => {
    const corrections: Correction[] = [...GIVEN, { point: 2, t: 1, place: null }];
    const text = correctionsCsv({ points: POINTS, corrections });
    expect(text).toBe("t,x,y,target_t,target_x,target_y\n1,2.25,-0.5,0,1,2\n0,9.5,7.5,1,,\n");
    expect(readPoints("corrections.csv", bytes(text), FACTS)).toEqual([
      { t: 1, x: 2.25, y: -0.5, given: [{ t: 0, place: { x: 1, y: 2 } }] },
      { t: 0, x: 9.5, y: 7.5, given: [{ t: 1, place: null }] },
    ]);
  });

  it("keeps corrections in a project", () => {
    const [first, second] = POINTS.map((point) => ({ ...point, given: point.id === 1 ? GIVEN : [{ point: 2, t: 1, place: null }] }));
    const read = first && second ? readPoints("p.json", bytes(projectJson([first, second], FACTS)), FACTS) : [];
    expect(read.map(({ name, given }) => [name, given])).toEqual([
      ['a "b", c', [{ t: 0, place: { x: 1, y: 2 } }]],
      ["d", [{ t: 1, place: null }]],
    ]);
  });

  it("writes the arrays of decomo-track", () => {
    const files = unzipSync(tracksNpz(POINTS, FACTS));
    const array = (key: string) => readNpy(files[`${key}.npy`] ?? new Uint8Array(), key);
    expect(array("tracks")).toEqual({ shape: [2, 2, 2], values: [1, 2, 2.25, -0.5, 9.5, 7.5, 11, 12] });
    expect(array("occluded")).toEqual({ shape: [2, 2], values: [1, 0, 0, 1] });
    expect(array("frames")).toEqual({ shape: [2], values: [0, 1] });
    expect(array("times")).toEqual({ shape: [2], values: [0, 1 / 12] });
  });

  it("aligns the header as numpy does", () => {
    const file = writeNpy("<f4", [3], [1, 2, 3]);
    expect((file.length - 12) % 64).toBe(0);
    expect(new TextDecoder("latin1").decode(file)).toContain("'shape': (3,), ");
  });

  it("refuses tracks of a clip of another size", () => {
    const foreign = tracksNpz(POINTS, { ...FACTS, height: 9 });
    expect(() => readPoints("p.npz", foreign, FACTS)).toThrow("p.npz has points of a clip whose height is 9");
  });

  it("refuses more points than it can draw", () => {
    const many = bytes(`t,x,y\n${"0,1,1\n".repeat(2001)}`);
    expect(() => readPoints("p.csv", many, FACTS)).toThrow("p.csv holds 2001 points, more than the 2000 that this page takes");
  });

  it("opens a project of all points that it held", () => {
    const [point] = POINTS;
    const project = projectJson(Array.from({ length: 2001 }, () => point ?? POINTS[1]!), FACTS);
    expect(readPoints("p.json", bytes(project), FACTS)).toHaveLength(2001);
  });

  it("takes a byte order mark, as spreadsheets write it", () => {
    expect(readPoints("p.csv", bytes("\ufefft;x;y\r\n1;2.5;3\r\n"), FACTS)).toEqual([{ t: 1, x: 2.5, y: 3 }]);
    expect(readPoints("p.json", bytes(`\ufeff${projectJson(POINTS, FACTS)}`), FACTS)).toEqual(DRAFTS);
  });

  it("takes columns in any order, and Windows' line ends", () => {
    expect(readPoints("p.csv", bytes("x,Y,note,t\r\n1,2,hm,0\r\n\r\n3,4,,1\r\n"), FACTS)).toEqual([
      { t: 0, x: 1, y: 2 },
      { t: 1, x: 3, y: 4 },
    ]);
  });

  it("takes semicolons and tabs for commas, and quoted cells", () => {
    for (const text of ["t;x;y\n1;2.5;3\n", "t\tx\ty\n1\t2.5\t3\n", '"t","x","y"\n"1","2.5","3"\n']) {
      expect(readPoints("p.csv", bytes(text), FACTS)).toEqual([{ t: 1, x: 2.5, y: 3 }]);
    }
  });

  it("refuses text of another encoding", () => {
    const utf16 = Uint8Array.from([0xff, 0xfe, ...[..."t,x,y\n"].flatMap((letter) => [letter.charCodeAt(0), 0])]);
    expect(() => readPoints("p.csv", utf16, FACTS)).toThrow("p.csv is not text in UTF-8; save it as such.");
  });

  it.each([[[-1, 3]], [[0.5, 3]], [[Number.NaN, 3]]])("refuses an array of the shape %s", (shape) => {
    const file = zipSync({ "queries.npy": writeNpy("<f4", shape, [0, 1, 2]) });
    expect(() => readPoints("p.npz", file, FACTS)).toThrow("p.npz: queries is an array of no shape");
  });

  it.each([
    ["p.csv", "x,y\n1,2\n", "no column t"],
    ["p.csv", "t,x,y,T\n0,1,2,0\n", "it has no column t, or more than one"],
    ["p.csv", 't,x,y\n0,1,2\n0,,1"2,3\n', "row 1 (counted from 0) has 4 values, not 3"],
    ["p.csv", 't,x,y,name\n0,1,2,"a\n0,1,2,b\n', "row 0 (counted from 0) has a quote that is not closed"],
    ["p.csv", "t,x,y\n0,1\n", "row 0 (counted from 0) has 2 values, not 3"],
    ["p.csv", "t,x,y\n0,1,2\n0,one,2\n", "point 1 (counted from 0): t, x and y must be finite numbers"],
    ["p.csv", "t,x,y\n2,1,2\n", "within 0 .. 1, the clip's frames"],
    ["p.csv", "t,x,y\n0,10,2\n", "outside the frame of 10x8"],
    ["p.csv", "point,frame,query_t,query_x,query_y,y\n0,0,0,1,x,1\n", "point 0 (counted from 0): t, x and y must be finite numbers"],
    ["c.csv", "t,x,y,target_t,target_x,target_y\n0,1,2,1,3,\n", "point 0 (counted from 0), correction 0: t, x and y must be finite"],
    ["c.csv", "t,x,y,target_t,target_x,target_y\n0,1,2,2,3,4\n", "correction 0: t is 2 but must be a whole number within 0 .. 1"],
    ["c.csv", "t,x,y,target_t,target_x,target_y\n0,1,2,1,3,9\n", "correction 0: (3, 9) lies outside the frame of 10x8"],
    ["c.csv", "t,x,y,target_t,target_x,target_y\n1,1,2,1,3,4\n", "correction 0 is in frame 1, in which the point was placed"],
    ["c.csv", "t,x,y,target_t,target_x,target_y\n0,1,2,1,3,4\n0,1,2,1,,\n", "has two corrections in frame 1"],
    ["p.json", '{"points": [{"t": 0, "x": 1, "y": 2, "corrections": 1}]}', "has corrections that are no list"],
    ["p.json", '{"points": [{"t": 0, "x": 1, "y": 2, "corrections": [null]}]}', "correction 0: t, x and y must be finite"],
    ["p.json", "{", "not JSON"],
    ["p.json", "[]", "no list 'points'"],
    ["p.json", '{"format": "other", "points": []}', "is no file of points"],
    ["p.json", '{"version": 2, "points": []}', "has version 2 but this page reads up to 1"],
    ["p.json", '{"clip": {"num_frames": 3}, "points": []}', "a clip whose num_frames is 3 but the model was fitted to c"],
    ["p.json", '{"clip": {"num_frames": 2, "width": 8}, "points": []}', "whose width is 8"],
    ["p.json", '{"version": {"valueOf": 1, "toString": 1}, "points": []}', "has version {"],
    ["p.json", '{"clip": {"width": {"valueOf": 1, "toString": 1}}, "points": []}', "whose width is {"],
    ["p.npz", "PK", "not an npz file"],
    ["p.txt", "", "nothing that this page opens"],
  ])("refuses %s with %j", (name, text, sentence) => {
    expect(() => readPoints(name, bytes(text), FACTS)).toThrow(sentence);
  });
});
