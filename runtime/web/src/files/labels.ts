/** Label images, in and out: the value of a pixel is its object's number, 0 is none, as `decomo-propagate` has them. */

import { type DecodedPng, decode, encode } from "fast-png";
import type { Size } from "../geometry";
import { MOST_LABEL } from "../drawings";
import { InputError } from "../model/facts";
import { orientationOf, upright } from "./orientation";

/**
 * The labels of a PNG of grey values, also saved as RGB, or with a palette, [height * width]; what is transparent is no
 * object's. `InputError` where it is none of this size. Held to the same table as `png.py` of
 * `decomo_runtime/propagation/formats`.
 */
export function readLabels(name: string, bytes: Uint8Array, { width, height }: Size): Uint8Array | Uint16Array {
  let png: DecodedPng;
  try {
    png = decode(bytes);
  } catch {
    throw new InputError(`${name} does not decode as a PNG; give a label image, whose values are numbers of objects.`);
  }
  const orientation = orientationOf(bytes);
  const shown = orientation > 4 ? { width: png.height, height: png.width } : png;
  if (shown.width !== width || shown.height !== height) {
    throw new InputError(`${name} is ${shown.width}x${shown.height} but the clip is ${width}x${height}; give one that was drawn on this clip.`);
  }
  const stored = greys(png);
  if (stored === undefined) {
    throw new InputError(`${name} has colours; give a label image: grey values or a palette, whose values are numbers of objects.`);
  }
  const labels = upright(stored, png, orientation);
  if (labels.every((label) => label === 0)) throw new InputError(`${name} is black: no pixel of it is an object's.`);
  if (labels.some((label) => label > MOST_LABEL)) throw new InputError(`${name} has an object above ${MOST_LABEL}; number them from 1 on.`);
  return labels;
}

/** The frame that a file's name tells: `sure` by `@T` before its ending, as for the commands behind it; else a number may be one. */
export interface NamedFrame {
  readonly t: number;
  readonly sure: boolean;
}

/** `InputError` where `@T` is no frame of the clip. */
export function frameInName(name: string, numFrames: number): NamedFrame | undefined {
  const [, at, digits] = /(@?)(\d+)\.[^.]*$/.exec(name) ?? [];
  if (digits === undefined) return undefined;
  const [t, sure] = [Number(digits), at === "@"];
  if (t < numFrames) return { t, sure };
  if (!sure) return undefined;
  throw new InputError(`${name} is of frame ${t}, as its name says, but the clip has frames 0 to ${numFrames - 1}; give one of this clip, or rename it.`);
}

/** Grey, 8 bits. */
export const labelPng = ({ width, height }: Size, labels: Uint8Array): Uint8Array => encode({ width, height, data: labels, channels: 1, depth: 8 });

/** One value for each pixel, 0 where it is transparent; undefined where one that is not has a colour. */
function greys({ data, depth, channels, width, height, palette, transparency = new Uint16Array() }: DecodedPng): Uint8Array | Uint16Array | undefined {
  const values = depth < 8 ? unpacked(data, depth, { width, height }) : data;
  const labels = data instanceof Uint16Array ? new Uint16Array(width * height) : new Uint8Array(width * height);
  const scale = depth < 8 && !palette ? 255 / (2 ** depth - 1) : 1;
  const [hasColours, hasAlpha] = [channels > 2, channels % 2 === 0];
  for (let pixel = 0; pixel < labels.length; pixel++) {
    const at = channels * pixel;
    const value = values[at] ?? 0;
    if (hasAlpha && values[at + channels - 1] === 0) continue;
    if (transparency.length > 0 && transparency.every((each, channel) => each === values[at + channel])) continue;
    if (palette?.[value]?.[3] === 0) continue;
    if (hasColours && (values[at + 1] !== value || values[at + 2] !== value)) return undefined;
    labels[pixel] = scale * value;
  }
  return labels;
}

/** Values of less than 8 bits, several in a byte; rows begin with a byte. */
function unpacked(data: DecodedPng["data"], depth: number, { width, height }: Size): Uint8Array {
  const [perByte, stride] = [8 / depth, Math.ceil((width * depth) / 8)];
  return Uint8Array.from({ length: width * height }, (_, index) => {
    const [row, column] = [Math.floor(index / width), index % width];
    const byte = data[row * stride + Math.floor(column / perByte)] ?? 0;
    return (byte >> (8 - depth * (1 + (column % perByte)))) & (2 ** depth - 1);
  });
}
