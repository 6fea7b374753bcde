/** What an exported .onnx file says about itself, read from its bytes without onnxruntime. */

import { FORMAT_VERSION, INPUTS, REQUIRED_OUTPUTS } from "./contract";
import { type Quality, readQuality } from "./quality";

const WRITE_ONE = "write one with 'decomo-export'";

/** Of older files, which do not say. */
const OBJECT_SHARE = 0.5;

export interface ModelFacts {
  readonly clipName: string;
  readonly numFrames: number;
  /** Pixels, of the clip's own resolution; so is `width`. */
  readonly height: number;
  readonly width: number;
  readonly fps: number;
  /** Seconds of each frame, from 0. */
  readonly times: readonly number[];
  readonly preset: string;
  /** A point is occluded where its occlusion score is above this. */
  readonly occlusionThreshold: number;
  /** A point is one of an object where 1 - its static confidence is above this. */
  readonly objectShare: number;
  /** How good the fit is; absent of files that do not say. */
  readonly quality?: Quality | undefined;
}

/** Bad input: the text is one sentence that says what is wrong and what to do. */
export class InputError extends Error {}

/** Reads and checks the facts of the model file `name`; `InputError` where it is not a model that this page reads. */
export function readFacts(bytes: Uint8Array, name: string): ModelFacts {
  const file = readModelProto(bytes, name);
  const version = file.metadata.get("decomotion.format_version");
  if (version === undefined) {
    throw new InputError(`${name} is an ONNX file but holds no decomotion model; ${WRITE_ONE}.`);
  }
  if (!(Number(version) >= 1)) {
    throw new InputError(`${name} has the impossible metadata decomotion.format_version = '${version}'; export the model again.`);
  }
  if (Number(version) > FORMAT_VERSION) {
    throw new InputError(
      `${name} has format version ${version} but this page reads up to ${FORMAT_VERSION}; upgrade with ` +
        "'pip install -U decomotion', or export the model again.",
    );
  }
  requireNames("input", INPUTS, file.inputs, name);
  requireNames("output", REQUIRED_OUTPUTS, file.outputs, name);
  const text = (key: string): string => {
    const value = file.metadata.get(`decomotion.${key}`);
    if (value === undefined) {
      throw new InputError(`${name} lacks the metadata decomotion.${key}; export the model again.`);
    }
    return value;
  };
  const number = (key: string, valid: (value: number) => boolean, otherwise?: number): number => {
    if (otherwise !== undefined && !file.metadata.has(`decomotion.${key}`)) return otherwise;
    const value = text(key).trim() === "" ? Number.NaN : Number(text(key));
    if (!valid(value)) {
      throw new InputError(
        `${name} has the impossible metadata decomotion.${key} = '${text(key)}'; export the model again.`,
      );
    }
    return value;
  };
  const seconds = (frames: number, fps: number): readonly number[] => {
    const said = file.metadata.get("decomotion.times");
    if (said === undefined) return Array.from({ length: frames }, (_, frame) => frame / fps);
    const times: unknown = parsed(said);
    if (!rises(times, frames)) throw new InputError(`${name} has impossible metadata decomotion.times; export the model again.`);
    return times;
  };
  const quality = (): Quality | undefined => {
    const said = file.metadata.get("decomotion.quality");
    if (said === undefined) return undefined;
    try {
      return readQuality(parsed(said));
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      throw new InputError(`${name} has the impossible metadata decomotion.quality (${error.message}); export the model again.`);
    }
  };
  const count = (value: number): boolean => Number.isInteger(value) && value >= 1;
  const numFrames = number("num_frames", count);
  const fps = number("fps", (value) => value > 0 && Number.isFinite(value));
  return {
    clipName: text("clip_name"),
    numFrames,
    height: number("height", count),
    width: number("width", count),
    fps,
    times: seconds(numFrames, fps),
    preset: text("preset"),
    occlusionThreshold: number("occlusion_threshold", (value) => value >= 0 && value <= 1),
    objectShare: number("object_share", (value) => value >= 0 && value < 1, OBJECT_SHARE),
    quality: quality(),
  };
}

/** Whether these are seconds of so many frames, from 0. */
export const rises = (times: unknown, frames: number): times is number[] =>
  Array.isArray(times) &&
  times.length === frames &&
  times[0] === 0 &&
  times.every((time, frame) => Number.isFinite(time) && (frame === 0 || time > times[frame - 1]));

function parsed(text: string): unknown {
  try {
    return JSON.parse(text);
  } catch {
    return undefined;
  }
}

function requireNames(kind: string, required: readonly string[], present: readonly string[], name: string): void {
  const missing = required.filter((port) => !present.includes(port));
  if (missing.length > 0) {
    throw new InputError(`${name} lacks the ${kind} ${missing.join(", ")}; export the model again.`);
  }
}

interface ModelProto {
  metadata: Map<string, string>;
  inputs: string[];
  outputs: string[];
}

/** Field numbers of onnx.proto. */
const MODEL = { graph: 7, metadataProps: 14 };
const GRAPH = { input: 11, output: 12 };
const ENTRY = { key: 1, value: 2 };
const VALUE_INFO = { name: 1 };

function readModelProto(bytes: Uint8Array, name: string): ModelProto {
  const file: ModelProto = { metadata: new Map(), inputs: [], outputs: [] };
  let hasGraph = false;
  try {
    for (const [field, content] of fields(bytes)) {
      if (field === MODEL.metadataProps) {
        file.metadata.set(textField(content, ENTRY.key), textField(content, ENTRY.value));
      } else if (field === MODEL.graph) {
        hasGraph = true;
        for (const [inner, port] of fields(content)) {
          if (inner === GRAPH.input) file.inputs.push(textField(port, VALUE_INFO.name));
          if (inner === GRAPH.output) file.outputs.push(textField(port, VALUE_INFO.name));
        }
      }
    }
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    hasGraph = false;
  }
  if (!hasGraph) {
    throw new InputError(`${name} is not an ONNX file, or it is damaged or cut short; copy it again, or ${WRITE_ONE}.`);
  }
  return file;
}

const NOTHING = new Uint8Array(0);
const WIRE = { varint: 0, fixed64: 1, bytes: 2, fixed32: 5 };

/** The fields of a protobuf message: number and content, which is empty for numbers. `RangeError` where it is none. */
function* fields(bytes: Uint8Array): Generator<[number, Uint8Array]> {
  let at = 0;
  const varint = (): number => {
    let value = 0;
    for (let scale = 1; ; scale *= 128) {
      const byte = bytes[at++];
      if (byte === undefined || scale > 2 ** 63) throw new RangeError("not a protobuf message");
      value += (byte & 127) * scale;
      if (byte < 128) return value;
    }
  };
  while (at < bytes.length) {
    const tag = varint();
    const [field, wire] = [Math.floor(tag / 8), tag % 8];
    let content: Uint8Array = NOTHING;
    if (wire === WIRE.varint) {
      varint();
    } else {
      const size = wire === WIRE.bytes ? varint() : wire === WIRE.fixed64 ? 8 : wire === WIRE.fixed32 ? 4 : Infinity;
      if (field === 0 || at + size > bytes.length) throw new RangeError("not a protobuf message");
      if (wire === WIRE.bytes) content = bytes.subarray(at, at + size);
      at += size;
    }
    yield [field, content];
  }
}

function textField(bytes: Uint8Array, wanted: number): string {
  for (const [field, content] of fields(bytes)) {
    if (field === wanted) return new TextDecoder().decode(content);
  }
  return "";
}
