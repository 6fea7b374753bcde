/** The homography that most of some pairs of places agree on. */

/** Row by row, the last of its nine numbers being 1. */
export type Homography = readonly number[];

const UNKNOWNS = 8;
/** Times the noise that residuals are forgiven in the first round; each round forgives half of that before. */
const FIRST_SCALE = 32;
const LAST_ROUNDS = 4;

/** Where a homography takes a place. */
export function moved([a = 1, b = 0, c = 0, d = 0, e = 1, f = 0, g = 0, h = 0]: Homography, x: number, y: number): [number, number] {
  const depth = g * x + h * y + 1;
  return [(a * x + b * y + c) / depth, (d * x + e * y + f) / depth];
}

/**
 * From places `from` [N, 2] to `to` [N, 2], which err by about `noise`, and some wholly; undefined where they do not tell.
 *
 * Least squares, reweighted: what a pair misses by counts the less the larger it is, more strictly from round to round
 * (graduated non-convexity with Geman and McClure's kernel). Places are to be of about one size, as in units of the image.
 */
export function fitHomography(from: Float32Array, to: Float32Array, noise: number): Homography | undefined {
  let found: Homography | undefined;
  let scale = FIRST_SCALE * noise;
  for (let last = 0; last < LAST_ROUNDS; scale = Math.max(noise, scale / 2)) {
    if (scale === noise) last++;
    found = fit(from, to, scale, found);
    if (found === undefined) return undefined;
  }
  return found;
}

function fit(from: Float32Array, to: Float32Array, scale: number, former: Homography | undefined): Homography | undefined {
  const products = Array.from({ length: UNKNOWNS }, () => new Float64Array(UNKNOWNS + 1));
  for (let at = 0; at < from.length; at += 2) {
    const [x = 0, y = 0, toX = 0, toY = 0] = [from[at], from[at + 1], to[at], to[at + 1]];
    let weight = 1;
    if (former !== undefined) {
      const [hasX, hasY] = moved(former, x, y);
      const squared = (hasX - toX) ** 2 + (hasY - toY) ** 2;
      const depth = (former[6] ?? 0) * x + (former[7] ?? 0) * y + 1;
      weight = (scale ** 2 / (scale ** 2 + squared)) ** 2 / depth ** 2;
    }
    addEquation(products, [x, y, 1, 0, 0, 0, -x * toX, -y * toX, toX], weight);
    addEquation(products, [0, 0, 0, x, y, 1, -x * toY, -y * toY, toY], weight);
  }
  const solution = solved(products);
  return solution && [...solution, 1];
}

function addEquation(products: readonly Float64Array[], equation: readonly number[], weight: number): void {
  products.forEach((row, index) => {
    const factor = weight * (equation[index] ?? 0);
    if (factor !== 0) equation.forEach((value, column) => (row[column] = (row[column] ?? 0) + factor * value));
  });
}

/** Of rows of coefficients, each with its right side last: Gauss and Jordan's elimination; undefined where they are singular. */
function solved(rows: Float64Array[]): number[] | undefined {
  const largest = Math.max(...rows.map((row, index) => Math.abs(row[index] ?? 0)));
  for (let column = 0; column < rows.length; column++) {
    const below = rows.slice(column);
    const pivot = below.reduce((best, row) => (Math.abs(row[column] ?? 0) > Math.abs(best[column] ?? 0) ? row : best));
    const head = pivot[column] ?? 0;
    if (!(Math.abs(head) > 1e-12 * largest)) return undefined;
    const place = rows.indexOf(pivot);
    [rows[column], rows[place]] = [pivot, rows[column] ?? pivot];
    for (const row of rows) {
      if (row === pivot) continue;
      const factor = (row[column] ?? 0) / head;
      if (factor !== 0) pivot.forEach((value, index) => (row[index] = (row[index] ?? 0) - factor * value));
    }
  }
  return rows.map((row, index) => (row[rows.length] ?? 0) / (row[index] ?? 1));
}
