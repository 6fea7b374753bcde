/** The page's elements by their id, with the type that the markup gives them. */
export function element<T extends HTMLElement>(id: string, type: new () => T): T {
  const found = document.getElementById(id);
  if (!(found instanceof type)) throw new TypeError(`the page has no ${type.name} #${id}`);
  return found;
}

/** A new element with properties and children. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Partial<HTMLElementTagNameMap[K]> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

/** Hands `content` to the user as the file `name`. */
export function download(name: string, content: BlobPart, type: string): void {
  const url = URL.createObjectURL(new Blob([content], { type }));
  make("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}

/** Hears when the page comes to a screen with other pixels, or is zoomed, at which nothing of it need change its size. */
export function onOtherResolution(changed: () => void): void {
  const heard = (): void => {
    onOtherResolution(changed);
    changed();
  };
  matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener("change", heard, { once: true });
}

const unable = new WeakSet<HTMLButtonElement>();
const working = new WeakSet<HTMLButtonElement>();

/** A button that there is something for; while it works it stays disabled all the same. */
export function enable(button: HTMLButtonElement, able: boolean): void {
  if (able) unable.delete(button);
  else unable.add(button);
  button.disabled = !able || working.has(button);
}

/** The button waits until it is done. */
export async function busy(button: HTMLButtonElement, work: () => Promise<void>): Promise<void> {
  working.add(button);
  button.disabled = true;
  try {
    await work();
  } finally {
    working.delete(button);
    button.disabled = unable.has(button);
  }
}
