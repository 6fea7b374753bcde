/** Frames in files of 16 bits, whose values may need fewer: `decomotion/frame_files.py` scales them, browsers do not. */

import { OPEN_AGAIN, contentOf } from "./files/content";
import { InputError } from "./model/facts";

/** Bits that cameras and renderers give to a value. */
const DEPTHS = [8, 10, 12, 14] as const;
const PNG = [0x89, 0x50, 0x4e, 0x47];
/** Where a PNG says how many bits its values have. */
const BITS_AT = 24;

/**
 * `InputError` where the values of the 16-bit files among `files` need fewer bits, so that a browser shows them dark.
 * They are read only until one needs them all.
 */
export async function checkDepth(files: readonly File[]): Promise<void> {
  let [deep, highest]: [File | undefined, number] = [undefined, 0];
  for (const file of files) {
    if (!(await hasDeepValues(file))) continue;
    deep ??= file;
    highest = Math.max(highest, await highestValue(file));
    if (bitsOf(highest) === undefined) return;
  }
  if (deep === undefined) return;
  throw new InputError(
    `The values in ${deep.name} and its like need ${bitsOf(highest)} of 16 bits, and a browser shows them dark; start 'decomo-view' with --clip and ` +
      "their folder, which scales them, or save them with 8 bits.",
  );
}

/** The fewest bits that hold values whose upper eight, rounded, are at most `highest`; undefined: all 16. */
const bitsOf = (highest: number): number | undefined => DEPTHS.find((bits) => highest <= 2 ** (bits - 8));

async function hasDeepValues(file: File): Promise<boolean> {
  const head = await contentOf(file.slice(0, BITS_AT + 1), file.name, OPEN_AGAIN);
  return PNG.every((byte, at) => head[at] === byte) && head[BITS_AT] === 16;
}

/** Of its picture as the browser has it, with 8 bits; 255 where it does not decode, which is said elsewhere. */
async function highestValue(file: File): Promise<number> {
  const picture = await createImageBitmap(file, { colorSpaceConversion: "none", premultiplyAlpha: "none" }).catch(() => undefined);
  const context = picture && new OffscreenCanvas(picture.width, picture.height).getContext("2d");
  if (picture === undefined || !context) return 255;
  context.drawImage(picture, 0, 0);
  const { data } = context.getImageData(0, 0, picture.width, picture.height);
  picture.close();
  let highest = 0;
  for (let at = 0; at < data.length; at++) if (at % 4 !== 3) highest = Math.max(highest, data[at] ?? 0);
  return highest;
}
