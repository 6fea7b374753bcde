/** How a PNG's picture lies, by its EXIF, as `decomotion/images.py` reads it. */

import type { Size } from "../geometry";

const ORIENTATION = 0x112;
const SHORT = 3;
const LAST = 8;

/** 1 to 8, as EXIF has it; 1 where the file does not say, or is damaged. */
export function orientationOf(png: Uint8Array): number {
  const file = new DataView(png.buffer, png.byteOffset, png.byteLength);
  try {
    for (let place = 8; ; place += 12 + file.getUint32(place)) {
      const kind = String.fromCharCode(...png.subarray(place + 4, place + 8));
      if (kind === "IEND") return 1;
      if (kind === "eXIf") return inDirectory(new DataView(file.buffer, file.byteOffset + place + 8, file.getUint32(place)));
    }
  } catch (error) {
    if (error instanceof RangeError) return 1; // a part that ends behind the file
    throw error;
  }
}

/** The picture of so many stored columns and rows as it is to be shown, [height * width]. */
export function upright<Labels extends Uint8Array | Uint16Array>(stored: Labels, { width, height }: Size, orientation: number): Labels {
  if (orientation === 1) return stored;
  const turned = orientation > 4;
  const [rows, columns] = turned ? [width, height] : [height, width];
  const [upsideDown, mirrored] = [[3, 4, 7, 8].includes(orientation), [2, 3, 6, 7].includes(orientation)];
  const shown = stored.slice() as Labels;
  for (let y = 0; y < rows; y++) {
    for (let x = 0; x < columns; x++) {
      const [down, across] = [upsideDown ? rows - 1 - y : y, mirrored ? columns - 1 - x : x];
      shown[y * columns + x] = stored[turned ? across * width + down : down * width + across] ?? 0;
    }
  }
  return shown;
}

/** What the first directory says of it. */
function inDirectory(exif: DataView): number {
  const order = exif.getUint16(0);
  if (order !== 0x4949 && order !== 0x4d4d) return 1; // II, MM
  const little = order === 0x4949;
  const place = exif.getUint32(4, little);
  const entries = exif.getUint16(place, little);
  for (let entry = place + 2; entry < place + 2 + 12 * entries; entry += 12) {
    if (exif.getUint16(entry, little) !== ORIENTATION) continue;
    const [kind, value] = [exif.getUint16(entry + 2, little), exif.getUint16(entry + 8, little)];
    return kind === SHORT && value >= 1 && value <= LAST ? value : 1;
  }
  return 1;
}
