/** What is kept of what can be made again: that which was used last. */

import type { Size } from "./geometry";

/** Pictures by name, as many as have `most` pixels in all; `drop` hears of those that go. */
export class LastUsed<Picture extends Size> {
  private readonly pictures = new Map<string, Picture>(); // the one used last is last
  private pixels = 0;

  constructor(
    private readonly most: number,
    private readonly drop: (picture: Picture) => void,
  ) {}

  get(name: string): Picture | undefined {
    const picture = this.pictures.get(name);
    if (picture !== undefined) {
      this.pictures.delete(name);
      this.pictures.set(name, picture);
    }
    return picture;
  }

  /** Keeps a picture, and those `besides` it however large they are: they are wanted together. */
  set(name: string, picture: Picture, besides: ReadonlySet<string> = new Set()): void {
    const had = this.pictures.get(name);
    if (had !== undefined && had !== picture) this.remove(name, had);
    else if (had !== undefined) this.pictures.delete(name);
    if (had !== picture) this.pixels += area(picture);
    this.pictures.set(name, picture);
    for (const [other, oldest] of this.pictures) {
      if (this.pixels <= this.most) break;
      if (other !== name && !besides.has(other)) this.remove(other, oldest);
    }
  }

  private remove(name: string, picture: Picture): void {
    this.pictures.delete(name);
    this.pixels -= area(picture);
    this.drop(picture);
  }
}

const area = ({ width, height }: Size): number => width * height;
