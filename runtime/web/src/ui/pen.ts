/** What a press, a drag or keys on the picture draw, with the tool that is chosen. */

import type { Ink, Mark, Picture } from "../drawings";
import { type Place, type Size, box, roundPlace } from "../geometry";

export const TOOLS = ["points", "brush", "eraser", "polygon", "box", "text", "picture"] as const;
export type Tool = (typeof TOOLS)[number];

/** Of an image's longer side: a picture that is put down by a click. */
const PICTURE_SHARE = 0.3;
/** Of it too: less is a click. */
const DRAG_SHARE = 0.01;

export interface PenEvents {
  /** Whether one may draw in frame t with what is chosen; throws where not. */
  onBegin(tool: Tool, t: number): void;
  /** What is drawn so far; undefined: it is given up. */
  onDraft(mark: Mark | undefined): void;
  onMark(mark: Mark): void;
}

export class Pen {
  tool: Tool = "points";
  colour = "#ff3355";
  /** Of lines their width, of letters their height, in pixels of the clip. */
  size = 8;
  text = "";
  picture: (Size & { readonly source: string }) | undefined;
  /** The longer side of the clip's frames. */
  longer = 100;
  private t = 0;
  private path: [number, number, number][] = [];
  /** Corners of a polygon that were clicked; the rest of the path is being dragged. */
  private corners = 0;
  /** Whether the button, or Enter, holds the pen down. */
  private down = false;

  constructor(private readonly events: PenEvents) {}

  /** Whether the picture is drawn on. */
  get isOut(): boolean {
    return this.tool !== "points";
  }

  get isDown(): boolean {
    return this.down;
  }

  /** Whether a press and its end are one click for it. */
  get isOfClicks(): boolean {
    return this.tool === "polygon" || this.tool === "text";
  }

  /** Whether something is begun. */
  get isBusy(): boolean {
    return this.path.length > 0;
  }

  /** Puts the pen down at a place of frame t. */
  press(place: Place, pressure: number, t: number): void {
    if (!this.isBusy || t !== this.t) {
      this.cancel();
      this.events.onBegin(this.tool, t);
      this.t = t;
    }
    this.down = true;
    this.add(place, pressure);
  }

  /** Moves it: what has corners follows as an outline. */
  go(place: Place, pressure: number): void {
    if (this.down) this.add(place, pressure);
    else if (this.isBusy) this.show([...this.path, [place.x, place.y, pressure]]);
  }

  /** Lifts it, by which all but a polygon of clicks is done; `same`: within so many pixels a corner is one that was there. */
  lift(place: Place, same: number): void {
    if (!this.down) return;
    this.down = false;
    if (this.tool === "polygon") this.corner(place, same);
    else this.finish();
  }

  /** Ends a polygon with the corners that it has. */
  finish(): void {
    if (!this.isBusy) return;
    const mark = this.mark(this.path);
    this.path = [];
    this.down = false;
    if (mark === undefined) this.events.onDraft(undefined);
    else this.events.onMark(mark);
  }

  cancel(): void {
    if (!this.isBusy) return;
    this.path = [];
    this.down = false;
    this.events.onDraft(undefined);
  }

  /** After a press: a drag was the outline, a click is one more corner, or closes the polygon. */
  private corner(place: Place, same: number): void {
    const near = ([x, y]: readonly [number, number, number]): boolean => Math.hypot(x - place.x, y - place.y) <= same;
    const begun = this.path.findIndex((_, index) => index >= this.corners);
    const dragged = this.path.slice(begun).some((each) => !near(each));
    if (dragged) return this.finish();
    this.path.length = begun;
    const [first, last] = [this.path[0], this.path.at(-1)];
    if (this.path.length > 2 && first && last && (near(first) || near(last))) return this.finish();
    if (!last || !near(last)) this.path.push([place.x, place.y, 0.5]);
    this.corners = this.path.length;
    this.show(this.path);
  }

  private add({ x, y }: Place, pressure: number): void {
    if (this.path.length === 0) this.corners = 0;
    const last = this.path.at(-1);
    if (last?.[0] === x && last[1] === y && this.path.length > this.corners) return;
    this.path.push([x, y, Math.round(100 * pressure) / 100]);
    this.show(this.path);
  }

  private show(path: readonly (readonly [number, number, number])[]): void {
    this.events.onDraft(this.mark(path));
  }

  private mark(path: readonly (readonly [number, number, number])[]): Mark | undefined {
    const { t, size } = this;
    const ink: Ink = this.tool === "eraser" ? null : this.colour;
    const places = path.map(([x, y]) => roundPlace({ x, y }));
    const [first, last] = [places[0], places.at(-1)];
    if (first === undefined || last === undefined) return undefined;
    switch (this.tool) {
      case "brush":
      case "eraser":
        return { kind: "stroke", t, ink, size, path: path.map(([x, y, pressure]) => [...pair(roundPlace({ x, y })), pressure] as const) };
      case "polygon":
        return places.length < 2 ? undefined : { kind: "area", t, ink, corners: places };
      case "box":
        return first.x === last.x || first.y === last.y ? undefined : { kind: "area", t, ink, corners: box(first, last) };
      case "text":
        return this.text.trim() === "" ? undefined : { kind: "text", t, ink, size, at: last, text: this.text };
      case "picture":
        return this.placed(first, last);
      case "points":
        return undefined;
    }
  }

  /** A click puts a picture's middle there; a drag says how wide or high it is. */
  private placed(first: Place, last: Place): Picture | undefined {
    const { picture } = this;
    if (picture === undefined) return undefined;
    const [width, height] = [Math.abs(last.x - first.x), Math.abs(last.y - first.y)];
    const fitted = Math.max(width / picture.width, height / picture.height);
    const dragged = Math.max(width, height) > DRAG_SHARE * this.longer;
    const factor = dragged ? fitted : (PICTURE_SHARE * this.longer) / Math.max(picture.width, picture.height);
    const size = { width: picture.width * factor, height: picture.height * factor };
    const [right, down] = [last.x < first.x ? -1 : 1, last.y < first.y ? -1 : 1];
    const at = dragged ? { x: first.x + (right * size.width) / 2, y: first.y + (down * size.height) / 2 } : last;
    return { kind: "picture", t: this.t, at: roundPlace(at), size, source: picture.source };
  }
}

const pair = ({ x, y }: Place): readonly [number, number] => [x, y];
