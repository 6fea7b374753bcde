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

export const clampPlace = ({ x, y }: Place, { width, height }: Size): Place => ({
  x: Math.min(Math.max(x, -0.5), width - 0.5),
  y: Math.min(Math.max(y, -0.5), height - 0.5),
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
  const [xs, ys] = [corners.map(({ x }) => x), corners.map(({ y }) => y)];
  const columns = centred(Math.min(...xs), Math.max(...xs), spacing);
  const rows = centred(Math.min(...ys), Math.max(...ys), spacing);
  return rows.flatMap((y) => columns.map((x) => roundPlace({ x, y }))).filter((place) => inside(corners, place));
}

function centred(first: number, last: number, spacing: number): number[] {
  const gaps = Math.floor((last - first) / spacing);
  const start = (first + last - gaps * spacing) / 2;
  return Array.from({ length: gaps + 1 }, (_, index) => start + index * spacing);
}
