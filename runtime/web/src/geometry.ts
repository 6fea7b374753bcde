/** Places on the picture: pixel centres lie at integers, the image reaches from -0.5 to width - 0.5. */

export interface Place {
  readonly x: number;
  readonly y: number;
}

export interface Size {
  readonly width: number;
  readonly height: number;
}

/** Queries are kept to a hundredth of a pixel, so that a file of them says exactly what was asked. */
export const roundPlace = ({ x, y }: Place): Place => ({ x: Math.round(x * 100) / 100, y: Math.round(y * 100) / 100 });

/** The place of the image nearest to one; `margin` 0 keeps to the pixels' centres. */
export const clampPlace = ({ x, y }: Place, { width, height }: Size, margin = 0.5): Place => ({
  x: Math.min(Math.max(x, -margin), width - 1 + margin),
  y: Math.min(Math.max(y, -margin), height - 1 + margin),
});

/** The corners of the box between two opposite ones. */
export function box(a: Place, b: Place): Place[] {
  return [a, { x: b.x, y: a.y }, b, { x: a.x, y: b.y }];
}

/** Even-odd rule. */
export function inside(polygon: readonly Place[], { x, y }: Place): boolean {
  let within = false;
  polygon.forEach((a, index) => {
    const b = polygon[(index + 1) % polygon.length] ?? a;
    if (a.y > y !== b.y > y && x < a.x + ((y - a.y) / (b.y - a.y)) * (b.x - a.x)) within = !within;
  });
  return within;
}

/** Points of a square grid inside `polygon` and the image, `spacing` pixels apart, centred in the polygon's box. */
export function gridInside(polygon: readonly Place[], spacing: number, image: Size): Place[] {
  const corners = polygon.map((corner) => clampPlace(corner, image));
  const { columns, rows } = grid(corners, spacing);
  return rows.flatMap((y) => columns.map((x) => roundPlace({ x, y }))).filter((place) => inside(corners, place));
}

/** How many points the grid of `gridInside` has before those outside the polygon are left out. */
export function gridCells(polygon: readonly Place[], spacing: number, image: Size): number {
  const { columns, rows } = grid(polygon.map((corner) => clampPlace(corner, image)), spacing);
  return columns.length * rows.length;
}

function grid(corners: readonly Place[], spacing: number): { columns: number[]; rows: number[] } {
  const [xs, ys] = [corners.map(({ x }) => x), corners.map(({ y }) => y)];
  return {
    columns: centred(Math.min(...xs), Math.max(...xs), spacing),
    rows: centred(Math.min(...ys), Math.max(...ys), spacing),
  };
}

/** Places between `first` and `last`, neither of them included, as they do not lie inside. */
function centred(first: number, last: number, spacing: number): number[] {
  const count = Math.max(1, Math.ceil((last - first) / spacing));
  const start = (first + last - (count - 1) * spacing) / 2;
  return Array.from({ length: count }, (_, index) => start + index * spacing);
}
