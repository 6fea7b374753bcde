import { expect, test } from "vitest";
import { LastUsed } from "../src/last_used";

const picture = (width: number, height: number) => ({ width, height });

function kept(most: number) {
  const gone: { width: number; height: number }[] = [];
  return { gone, pictures: new LastUsed<{ width: number; height: number }>(most, (each) => gone.push(each)) };
}

test("what was used last stays, as far as there is room", () => {
  const { gone, pictures } = kept(100);
  const [a, b, c] = [picture(10, 4), picture(4, 10), picture(5, 8)];
  pictures.set("a", a);
  pictures.set("b", b);
  expect(pictures.get("a")).toBe(a);
  pictures.set("c", c);
  expect(gone).toEqual([b]);
  expect([pictures.get("a"), pictures.get("b"), pictures.get("c")]).toEqual([a, undefined, c]);
});

test("of many pictures, few stay", () => {
  const { gone, pictures } = kept(1000);
  for (let number = 0; number < 500; number++) pictures.set(String(number), picture(20, 10));
  expect(gone).toHaveLength(495);
});

test("pictures that are wanted together stay together, and one that is larger than the room", () => {
  const { gone, pictures } = kept(100);
  const together = new Set(["a", "b"]);
  pictures.set("z", picture(9, 9));
  pictures.set("a", picture(10, 10), together);
  pictures.set("b", picture(20, 10), together);
  expect(gone).toEqual([picture(9, 9)]);
  pictures.set("c", picture(30, 10));
  expect(gone).toHaveLength(3);
  expect(pictures.get("c")).toEqual(picture(30, 10));
});

test("the same picture once more takes no room, another of the name takes its place", () => {
  const { gone, pictures } = kept(100);
  const [a, other] = [picture(6, 10), picture(5, 8)];
  pictures.set("a", a);
  pictures.set("a", a);
  expect(gone).toEqual([]);
  pictures.set("a", other);
  expect(gone).toEqual([a]);
  pictures.set("b", a);
  expect(pictures.get("a")).toBe(other);
});
