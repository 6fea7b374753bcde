/** Smooth continuation of values on a raster to where there are none: push-pull, as `filled` of `decomotion/images.py`. */

/** Values [rows, columns, `step`] where `weight` [rows, columns] is 1, and a smooth continuation of them where it is 0. */
export function filled(values: Float32Array, weight: Float32Array, columns: number, rows: number, step: number): Float32Array {
  if (columns === 1 && rows === 1) return values;
  const [halfColumns, halfRows] = [(columns + 1) >> 1, (rows + 1) >> 1];
  const sums = new Float32Array(halfColumns * halfRows * step);
  const total = new Float32Array(halfColumns * halfRows);
  for (let row = 0, at = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++, at++) {
      const to = (row >> 1) * halfColumns + (column >> 1);
      total[to] = (total[to] ?? 0) + (weight[at] ?? 0);
      for (let part = 0; part < step; part++) {
        sums[to * step + part] = (sums[to * step + part] ?? 0) + (weight[at] ?? 0) * (values[at * step + part] ?? 0);
      }
    }
  }
  const means = sums.map((sum, index) => sum / Math.max(total[Math.floor(index / step)] ?? 0, 1e-6));
  const coarse = filled(means, total.map((sum) => Math.min(1, sum)), halfColumns, halfRows, step);
  return values.map((value, index) => {
    const [at, part] = [Math.floor(index / step), index % step];
    const own = weight[at] ?? 0;
    if (own === 1) return value;
    const around = sampled(coarse, halfColumns, halfRows, ((at % columns) + 0.5) / 2 - 0.5, (Math.floor(at / columns) + 0.5) / 2 - 0.5, step, part);
    return own * value + (1 - own) * around;
  });
}

/** Of values [rows, columns, `step`] the `part`th at a place in columns and rows, centres at integers; the border's beyond it. */
export function sampled(values: Float32Array, columns: number, rows: number, x: number, y: number, step: number, part: number): number {
  const [atX, atY] = [Math.min(columns - 1, Math.max(0, x)), Math.min(rows - 1, Math.max(0, y))];
  const [left, top] = [Math.floor(atX), Math.floor(atY)];
  const [right, bottom] = [Math.min(columns - 1, left + 1), Math.min(rows - 1, top + 1)];
  const [across, down] = [atX - left, atY - top];
  const at = (column: number, row: number): number => values[(row * columns + column) * step + part] ?? 0;
  return (at(left, top) * (1 - across) + at(right, top) * across) * (1 - down) + (at(left, bottom) * (1 - across) + at(right, bottom) * across) * down;
}
