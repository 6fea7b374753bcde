/** Specks of a carried mask: held to the same table as `without_specks` of `decomo_runtime/propagation/regions.py`. */

/** Parts of a mask that are smaller than this share of its largest are left out. */
const SPECK = 1 / 200;
/** Of alpha: more is the mask, what is less is its soft rim. */
const SOLID = 127;

/** Makes transparent, with their rims, the parts of a picture that are tiny beside its largest. */
export function removeSpecks({ data, width, height }: ImageData): void {
  const parts = partsOf(data, width, height);
  const solid = parts.map((pixels) => pixels.reduce((count, pixel) => count + Number((data[4 * pixel + 3] ?? 0) > SOLID), 0));
  const least = SPECK * solid.reduce((most, count) => Math.max(most, count), 1);
  parts.forEach((pixels, part) => {
    if ((solid[part] ?? 0) < least) for (const pixel of pixels) data[4 * pixel + 3] = 0;
  });
}

/** The pixels of each part that is not transparent; corners that touch join two. */
function partsOf(data: Uint8ClampedArray, width: number, height: number): number[][] {
  const seen = new Uint8Array(width * height);
  const parts: number[][] = [];
  for (let first = 0; first < width * height; first++) {
    if (seen[first] === 1 || data[4 * first + 3] === 0) continue;
    const part = [first];
    seen[first] = 1;
    for (const pixel of part) { // grows while it is gone through
      const [column, row] = [pixel % width, Math.floor(pixel / width)];
      for (let y = Math.max(0, row - 1); y <= Math.min(height - 1, row + 1); y++) {
        for (let x = Math.max(0, column - 1); x <= Math.min(width - 1, column + 1); x++) {
          const next = y * width + x;
          if (seen[next] === 1 || data[4 * next + 3] === 0) continue;
          seen[next] = 1;
          part.push(next);
        }
      }
    }
    parts.push(part);
  }
  return parts;
}
