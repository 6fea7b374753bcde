import { describe, expect, it } from "vitest";
import { INPUTS, OUTPUTS } from "../src/model/contract";
import { InputError, readFacts } from "../src/model/facts";

const METADATA: Record<string, string> = {
  "decomotion.format_version": "1",
  "decomotion.clip_name": "goat",
  "decomotion.num_frames": "32",
  "decomotion.height": "240",
  "decomotion.width": "320",
  "decomotion.fps": "12.5",
  "decomotion.preset": "cpu",
  "decomotion.occlusion_threshold": "0.5",
};

/** One length-delimited protobuf field. */
function field(number: number, content: string | Uint8Array): Uint8Array {
  const bytes = typeof content === "string" ? new TextEncoder().encode(content) : content;
  return Uint8Array.of(...varint(number * 8 + 2), ...varint(bytes.length), ...bytes);
}

function varint(value: number): number[] {
  return value < 128 ? [value] : [(value % 128) + 128, ...varint(Math.floor(value / 128))];
}

const join = (parts: Uint8Array[]): Uint8Array => Uint8Array.from(parts.flatMap((part) => [...part]));

function model(metadata: Record<string, string>, outputs: readonly string[] = OUTPUTS): Uint8Array {
  const ports = [...INPUTS.map((name) => field(11, field(1, name))), ...outputs.map((name) => field(12, field(1, name)))];
  const weights = field(5, new Uint8Array(300));
  const entries = Object.entries(metadata).map(([key, value]) => field(14, join([field(1, key), field(2, value)])));
  return join([Uint8Array.of(8, 9), field(7, join([weights, ...ports])), ...entries]); // 8, 9: ir_version
}

const refusal = (bytes: Uint8Array): string => {
  try {
    readFacts(bytes, "m.onnx");
  } catch (error) {
    expect(error).toBeInstanceOf(InputError);
    return (error as Error).message;
  }
  throw new Error("it was taken");
};

describe("readFacts", () => {
  it("reads what the exporter writes", () => {
    expect(readFacts(model(METADATA), "m.onnx")).toEqual({
      ...{ clipName: "goat", numFrames: 32, height: 240, width: 320 },
      ...{ fps: 12.5, preset: "cpu", occlusionThreshold: 0.5, objectShare: 0.5 },
      times: Array.from({ length: 32 }, (_, frame) => frame / 12.5),
    });
  });

  it("reads the times of a clip without a steady rate, one for each frame", () => {
    const uneven = Array.from({ length: 32 }, (_, frame) => frame ** 2 / 30);
    const written = (times: string) => model({ ...METADATA, "decomotion.times": times });
    expect(readFacts(written(JSON.stringify(uneven)), "m.onnx").times).toEqual(uneven);
    const [falling, late] = [uneven.with(7, 0.1), uneven.with(0, 0.01)].map((times) => JSON.stringify(times));
    for (const wrong of ["[0, 1]", falling ?? "", late ?? "", JSON.stringify(uneven.map(String)), "[0, 1", "7"]) {
      expect(refusal(written(wrong))).toContain("impossible metadata decomotion.times");
    }
  });

  it("reads how good the fit is, where the file says it", () => {
    const figures = { links: 60, median: 0.5, p90: 1, median_pixels: 1, p90_pixels: 2, within_1: 0.5, within_2: 0.6, within_4: 0.7, own_error: 0.1 };
    const quality = { steps: 900, thinned: null, all: figures, static: null, dynamic: null, gaps: [] };
    const written = (text: string) => model({ ...METADATA, "decomotion.quality": text });
    expect(readFacts(written(JSON.stringify(quality)), "m.onnx").quality?.all.median).toBe(0.5);
    for (const wrong of ["", "[", "{}", JSON.stringify({ ...quality, steps: 0 })]) {
      expect(refusal(written(wrong))).toContain("impossible metadata decomotion.quality");
    }
  });

  it("refuses what is no ONNX file", () => {
    expect(refusal(new TextEncoder().encode("hello, world"))).toContain("m.onnx is not an ONNX file");
    expect(refusal(new Uint8Array(0))).toContain("is not an ONNX file");
    expect(refusal(model(METADATA).slice(0, 200))).toContain("cut short");
  });

  it("refuses a foreign, a newer and an incomplete model", () => {
    expect(refusal(model({}))).toContain("holds no decomotion model");
    expect(refusal(model({ ...METADATA, "decomotion.format_version": "2" }))).toContain("format version 2");
    expect(refusal(model(METADATA, ["tracks"]))).toContain("lacks the output occlusion, rgb");
  });

  it.each([
    ["format_version", "first"],
    ["num_frames", "0"],
    ["width", "1.5"],
    ["fps", "inf"],
    ["occlusion_threshold", "2"],
    ["object_share", "1"],
    ["height", ""],
  ])("refuses the impossible %s = %s", (key, value) => {
    expect(refusal(model({ ...METADATA, [`decomotion.${key}`]: value }))).toContain(`impossible metadata decomotion.${key}`);
  });
});
