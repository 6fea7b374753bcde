import { expect, test, vi } from "vitest";
import { busy, enable, onOtherResolution } from "../src/ui/dom";

/** As much of a button as is asked of it. */
const button = (): HTMLButtonElement => ({ disabled: false }) as HTMLButtonElement;

test("a button that works is not enabled by a change meanwhile", async () => {
  const save = button();
  let finish = (): void => undefined;
  const done = busy(save, () => new Promise((resolve) => (finish = resolve)));
  expect(save.disabled).toBe(true);
  enable(save, true);
  expect(save.disabled).toBe(true);
  finish();
  await done;
  expect(save.disabled).toBe(false);
});

test("nor enabled when it is done, where there is nothing left for it", async () => {
  const save = button();
  await busy(save, async () => enable(save, false));
  expect(save.disabled).toBe(true);
  enable(save, true);
  expect(save.disabled).toBe(false);
});

test("a button whose work fails can be pressed again", async () => {
  const save = button();
  await expect(busy(save, () => Promise.reject(new Error("full")))).rejects.toThrow("full");
  expect(save.disabled).toBe(false);
});

test("each screen with other pixels is noticed", () => {
  const screens = new EventTarget();
  const asked: string[] = [];
  vi.stubGlobal("matchMedia", (query: string) => {
    asked.push(query);
    return screens;
  });
  const seen: number[] = [];
  vi.stubGlobal("devicePixelRatio", 1);
  onOtherResolution(() => seen.push(devicePixelRatio));
  for (const ratio of [2, 1.5]) {
    vi.stubGlobal("devicePixelRatio", ratio);
    screens.dispatchEvent(new Event("change"));
  }
  vi.unstubAllGlobals();
  expect(seen).toEqual([2, 1.5]);
  expect(asked).toEqual(["(resolution: 1dppx)", "(resolution: 2dppx)", "(resolution: 1.5dppx)"]);
});
