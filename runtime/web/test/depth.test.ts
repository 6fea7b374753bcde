import { afterEach, describe, expect, it, vi } from "vitest";
import { checkDepth } from "../src/depth";

afterEach(() => vi.unstubAllGlobals());

/** A PNG's head, with the highest of its values as a browser has them behind it. */
function png(name: string, bits: number, highest: number): File {
  const head = new Uint8Array(33);
  head.set([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]);
  head[24] = bits;
  return new File([head, Uint8Array.of(highest)], name);
}

/** Browsers' pictures: one pixel, whose green is the highest value. */
function stub(): string[] {
  const decoded: string[] = [];
  vi.stubGlobal("createImageBitmap", async (file: File) => {
    decoded.push(file.name);
    return { width: 1, height: 1, value: new Uint8Array(await file.arrayBuffer())[33], close: () => undefined };
  });
  vi.stubGlobal("OffscreenCanvas", class {
    value = 0;
    getContext = () => this;
    drawImage = (picture: { value: number }) => (this.value = picture.value);
    getImageData = () => ({ data: Uint8ClampedArray.of(0, this.value, 0, 255) });
  });
  return decoded;
}

describe("frames of 16 bits", () => {
  it.each([[0, 8], [1, 8], [4, 10], [15, 12], [16, 12], [63, 14]])("whose highest value a browser shows as %i need %i bits", async (highest, bits) => {
    stub();
    await expect(checkDepth([png("0.png", 16, 0), png("1.png", 16, highest)])).rejects.toThrow(`The values in 0.png and its like need ${bits} of 16 bits`);
  });

  it("that need all of them, and others, are let through, and read no farther than that is known", async () => {
    const decoded = stub();
    await checkDepth([png("0.png", 16, 10), png("1.png", 16, 65), png("2.png", 16, 3)]);
    expect(decoded).toEqual(["0.png", "1.png"]);
    await checkDepth([png("0.png", 8, 10), new File(["\xff\xd8"], "1.jpg"), new File([], "2.png")]);
    expect(decoded).toHaveLength(2);
  });
});
