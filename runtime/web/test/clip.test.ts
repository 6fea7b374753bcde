import { afterEach, describe, expect, it, vi } from "vitest";

import { Clip, LostError } from "../src/clip";
import type { ModelFacts } from "../src/model/facts";

const SIDE = 4096;
const ROOM = 4;

afterEach(() => vi.unstubAllGlobals());

const made: object[] = [];

/** A clip of so many frames of which each but the `broken` one decodes at once, and the numbers of those asked for, in order. */
function opened(length: number, side: number, broken?: number) {
  const closes: object[] = [];
  made.length = 0;
  vi.stubGlobal("createImageBitmap", async ({ size }: Blob) => {
    if (size > 0) throw new Error("broken");
    const picture: object = { width: side, height: side, close: () => closes.push(picture) };
    made.push(picture);
    return picture;
  });
  const asked: number[] = [];
  const said: string[] = [];
  const facts = { clipName: "slide", numFrames: length, width: side, height: side } as ModelFacts;
  const load = async (frame: number): Promise<Blob> => {
    asked.push(frame);
    return new Blob(frame === broken ? ["no image"] : []);
  };
  const clip = new Clip(length, facts, load, () => undefined, ({ message }) => said.push(message));
  return { clip, asked, said, closed: () => closes };
}

const settled = (): Promise<void> => new Promise((done) => setTimeout(done, 20));

describe("frames of a clip", () => {
  it("come from files in the order in which the model's were read, not in the browser's", async () => {
    const names = ["shot (10).png", "shot.png", "Shot (2).png", "shot (1).png"];
    vi.stubGlobal("createImageBitmap", async ({ name }: File) => ({ name, width: 8, height: 4, close: () => undefined }));
    const facts = { clipName: "slide", numFrames: 4, width: 8, height: 4 } as ModelFacts;
    const files = names.map((name) => new File([], name));
    const clip = await Clip.fromFiles(files, facts, () => undefined, () => undefined);
    const shown = await Promise.all([0, 1, 2, 3].map((frame) => clip.wait(frame) as Promise<unknown>));
    expect(shown).toMatchObject(["shot.png", "shot (1).png", "Shot (2).png", "shot (10).png"].map((name) => ({ name })));
    const mixed = Clip.fromFiles([...files, new File([], "shot.jpg")], facts, () => undefined, () => undefined);
    await expect(mixed).rejects.toThrow("shot.jpg and shot.png differ in their ending alone");
  });

  it("that have changed since they were chosen are told from what is no image", async () => {
    vi.stubGlobal("createImageBitmap", async () => ({ width: 8, height: 4, close: () => undefined }));
    const facts = { clipName: "slide", numFrames: 2, width: 8, height: 4 } as ModelFacts;
    const files = ["0.png", "1.png"].map((name) => new File([], name));
    const clip = await Clip.fromFiles(files, facts, () => undefined, () => undefined);
    const refuse = async (): Promise<never> => {
      throw new DOMException("The requested file could not be read", "NotReadableError");
    };
    for (const file of files) Object.assign(file, { arrayBuffer: refuse });
    const sentence = "cannot be read, or has changed; open the frames of the clip again.";
    await expect(clip.wait(1)).rejects.toThrow(`1.png ${sentence}`);
    await expect(Clip.fromFiles(files, facts, () => undefined, () => undefined)).rejects.toThrow(`0.png ${sentence}`);
  });

  it("come all, once, with the first that is shown, it and those after it before the others", async () => {
    const { clip, asked } = opened(40, 16);
    expect(clip.get(30)).toBeUndefined();
    await settled();
    expect(asked.slice(0, 6)).toEqual([30, 31, 32, 33, 34, 35]);
    expect([...asked].sort((a, b) => a - b)).toEqual([...Array(40).keys()]);
    expect(clip.get(3)).toBeDefined();
  });

  it("are read ahead no farther than there is room", async () => {
    const { clip, asked } = opened(40, SIDE);
    clip.get(0);
    await settled();
    expect(asked).toHaveLength(ROOM);
  });

  it("are kept no more than there is room for, however many are passed by", async () => {
    const { clip } = opened(3600, SIDE);
    for (let frame = 0; frame < 3600; frame += 90) {
      clip.get(frame);
      await new Promise((done) => setTimeout(done));
      await clip.wait(frame);
    }
    expect(Reflect.get(clip, "decoded").size).toBe(ROOM);
    expect(Reflect.get(clip, "underway").size).toBe(0);
  });

  it("are read no more once it is closed", async () => {
    const { clip, asked } = opened(40, 16);
    clip.get(0);
    clip.close();
    await settled();
    expect(asked).toHaveLength(3);
  });

  it("are decoded few at a time, what is wanted last before what was passed by", async () => {
    const { clip, asked } = opened(300, 1024);
    for (const frame of [0, 100, 200]) clip.get(frame);
    await settled();
    expect(asked.slice(0, 6)).toEqual([0, 1, 2, 200, 201, 202]);
    expect(asked).toHaveLength(32); // of 4 MiB each
  });

  it("give their memory back when they leave, once each, and all when the clip is closed", async () => {
    const { clip, closed } = opened(40, SIDE);
    for (let frame = 0; frame < 40; frame += 2) {
      clip.get(frame);
      await settled();
      expect(clip.peek(frame)).toBeDefined();
      expect(closed()).not.toContain(clip.peek(frame));
    }
    clip.close();
    expect(closed().length).toBe(new Set(closed()).size);
    expect(closed().length).toBe(made.length);
  });

  it("that do not decode are said once, and not tried again", async () => {
    const { clip, asked, said } = opened(3, 16, 1);
    for (let time = 0; time < 3; time++) {
      clip.get(0);
      await settled();
    }
    expect([...asked].sort()).toEqual([0, 1, 2]);
    expect(said).toEqual(["Frame 1 of the clip does not decode as an image; replace it."]);
  });

  it("are asked for again where they did not come, and said to be lost", async () => {
    vi.useFakeTimers();
    vi.stubGlobal("createImageBitmap", async () => ({ width: 8, height: 4, close: () => undefined }));
    const facts = { clipName: "slide", numFrames: 1, width: 8, height: 4 } as ModelFacts;
    const said: string[] = [];
    let isThere = false;
    const load = async (): Promise<Blob> => {
      if (!isThere) throw new LostError("Frame 0 cannot be loaded.");
      return new Blob();
    };
    const clip = new Clip(1, facts, load, () => undefined, ({ message }) => said.push(message));
    clip.get(0);
    await vi.advanceTimersByTimeAsync(100);
    clip.get(0);
    await vi.advanceTimersByTimeAsync(100);
    expect(said).toEqual(["Frame 0 cannot be loaded."]); // once
    isThere = true;
    await vi.advanceTimersByTimeAsync(3000);
    clip.get(0);
    await vi.advanceTimersByTimeAsync(100);
    expect(clip.peek(0)).toBeDefined();
    vi.useRealTimers();
  });
});
