/** numpy's .npy: reading numbers and bools, writing what `decomo-track` writes. */

import { InputError } from "../model/facts";

export interface NumberArray {
  readonly shape: readonly number[];
  readonly values: readonly number[];
}

const MAGIC = [0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59];
const ALIGNMENT = 64;

type Dtype = "<f4" | "<f8" | "|b1" | "<i8";

/** An array of `values` as the bytes of a .npy file of version 1.0, C order. */
export function writeNpy(dtype: Dtype, shape: readonly number[], values: ArrayLike<number>): Uint8Array {
  const dimensions = shape.length === 1 ? `${shape[0]},` : shape.join(", ");
  const described = `{'descr': '${dtype}', 'fortran_order': False, 'shape': (${dimensions}), }`;
  const length = Math.ceil((10 + described.length + 1) / ALIGNMENT) * ALIGNMENT;
  const header = `${described.padEnd(length - 11)}\n`;
  const size = Number(dtype[2]);
  const bytes = new Uint8Array(length + values.length * size);
  const view = new DataView(bytes.buffer);
  bytes.set([...MAGIC, 1, 0]);
  view.setUint16(8, header.length, true);
  bytes.set(new TextEncoder().encode(header), 10);
  for (let index = 0; index < values.length; index++) {
    const at = length + index * size;
    const value = values[index] ?? 0;
    if (dtype === "<f4") view.setFloat32(at, value, true);
    else if (dtype === "<f8") view.setFloat64(at, value, true);
    else if (dtype === "<i8") view.setBigInt64(at, BigInt(value), true);
    else view.setUint8(at, value);
  }
  return bytes;
}

/** Reads numbers of the little-endian types that numpy writes by default; `InputError` names `name` where it is none. */
export function readNpy(bytes: Uint8Array, name: string): NumberArray {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes.length < 12 || MAGIC.some((byte, index) => bytes[index] !== byte)) {
    throw new InputError(`${name} is not an array of numpy; write the file with 'decomo-track'.`);
  }
  const [start, size] = bytes[6] === 1 ? [10, view.getUint16(8, true)] : [12, view.getUint32(8, true)];
  const header = new TextDecoder("latin1").decode(bytes.subarray(start, start + size));
  const dtype = /'descr':\s*'([^']*)'/.exec(header)?.[1] ?? "";
  const shape = (/'shape':\s*\(([^)]*)\)/.exec(header)?.[1] ?? "")
    .split(",")
    .filter((part) => part.trim() !== "")
    .map(Number);
  const read = READERS.get(dtype);
  const count = shape.reduce((product, length) => product * length, 1);
  const width = Number(dtype.slice(2));
  if (shape.some((length) => !Number.isInteger(length) || length < 0)) {
    throw new InputError(`${name} is an array of no shape; write the file with 'decomo-track'.`);
  }
  if (read === undefined || /'fortran_order':\s*True/.test(header) || bytes.length < start + size + count * width) {
    throw new InputError(`${name} holds ${dtype || "unknown values"} that this page does not read; use float32 rows.`);
  }
  return { shape, values: Array.from({ length: count }, (_, index) => read(view, start + size + index * width)) };
}

const READERS = new Map<string, (view: DataView, at: number) => number>(Object.entries({
  "<f4": (view: DataView, at: number) => view.getFloat32(at, true),
  "<f8": (view: DataView, at: number) => view.getFloat64(at, true),
  "<i8": (view: DataView, at: number) => Number(view.getBigInt64(at, true)),
  "<i4": (view: DataView, at: number) => view.getInt32(at, true),
  "|b1": (view: DataView, at: number) => view.getUint8(at),
  "|u1": (view: DataView, at: number) => view.getUint8(at),
}));
