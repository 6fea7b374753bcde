/** Specks of a carried mask: held to the same table as `without_specks` of `decomo_runtime/propagation/regions.py`. */

/** Parts of a mask that are smaller than this share of its largest are left out. */
const SPECK = 1 / 100;
/** Of alpha: more is the mask, what is less and next to it is its soft rim. */
const SOLID = 127;

/** Makes transparent what of a picture is neither a part of a mask, of those that are not tiny beside its largest, nor its rim. */
export function removeSpecks({ data, width, height }: ImageData): void {
  const parts = partsOf(data, width, height);
  const least = SPECK * parts.reduce((most, { length }) => Math.max(most, length), 0);
  const kept = new Uint8Array(width * height);
  for (const part of parts) {
    if (part.length < least) continue;
    for (const pixel of part) {
      kept[pixel] = 1;
      around(pixel, width, height, (rim) => {
        if ((data[4 * rim + 3] ?? 0) <= SOLID) kept[rim] = 1;
      });
    }
  }
  for (let pixel = 0; pixel < kept.length; pixel++) if (kept[pixel] === 0) data[4 * pixel + 3] = 0;
}

/** The pixels of each part that is solid; corners that touch join two. */
function partsOf(data: Uint8ClampedArray, width: number, height: number): number[][] {
  const open = Uint8Array.from({ length: width * height }, (_, pixel) => Number((data[4 * pixel + 3] ?? 0) > SOLID));
  const parts: number[][] = [];
  for (let first = 0; first < open.length; first++) {
    if (open[first] === 0) continue;
    const part = [first];
    open[first] = 0;
    const grow = (next: number): void => {
      if (open[next] === 0) return;
      open[next] = 0;
      part.push(next);
    };
    for (const pixel of part) around(pixel, width, height, grow); // it grows while it is gone through
    parts.push(part);
  }
  return parts;
}

/** Goes to a pixel and its eight neighbours, those that are there. */
function around(pixel: number, width: number, height: number, act: (pixel: number) => void): void {
  const [column, row] = [pixel % width, Math.floor(pixel / width)];
  for (let y = Math.max(0, row - 1); y <= Math.min(height - 1, row + 1); y++) {
    for (let x = Math.max(0, column - 1); x <= Math.min(width - 1, column + 1); x++) act(y * width + x);
  }
}
