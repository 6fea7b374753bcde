/** The picture that one points at: click, drag an area or a point, or move a cross with the keys. */

import { type Scene, drawDiamond, drawScene, markRadius } from "../draw";
import { type Place, type Size, box, clampPlace, roundPlace } from "../geometry";
import { onOtherResolution } from "./dom";
import type { Pen } from "./pen";

/** Pixels of the screen: by which a press becomes a drag of an area, or of a point, and within which a point is meant. */
const NEAR = { area: 6, point: 2, select: 9 };
/** The same for a finger, which hides what it points at and is never still. */
const NEAR_FINGER = { area: 12, point: 9, select: 20 };
/** How hard a mouse presses, and the keys. */
const PRESSURE = 0.5;

export interface StageEvents {
  /** A place on the image of frame t; `id` is the point's that lies there. */
  onClick(place: Place, t: number, id: number | undefined): void;
  /** The corners of an area of frame t. */
  onArea(polygon: readonly Place[], t: number): void;
  /** A point is taken hold of; `placing`: by `place`, and the next click or Enter puts it down. */
  onHold(id: number, placing: boolean): void;
  /** A point that was to be placed is placed, or given up. */
  onPlaced(): void;
  /** It belongs to `place` in frame t. */
  onCorrect(id: number, place: Place, t: number): void;
  /** The pen is put down. */
  onPress(place: Place, pressure: number, t: number): void;
}

export class Stage {
  /** What a drag draws. */
  shape: "box" | "lasso" = "box";
  private image: Size = { width: 16, height: 9 };
  private scene: Scene | undefined;
  private path: Place[] = [];
  /** What was shown when the path began: playing goes on. */
  private seen: Scene | undefined;
  private cross: Place | undefined;
  private corner: Place | undefined;
  /** The point that is dragged, or that a click or the cross places. */
  private held: number | undefined;
  private placing = false;
  private near = NEAR;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly frame: HTMLElement,
    private readonly events: StageEvents,
    private readonly pen: Pen,
  ) {
    new ResizeObserver(() => this.fit()).observe(canvas);
    onOtherResolution(() => this.fit());
    canvas.addEventListener("pointerdown", (event) => this.onDown(event));
    canvas.addEventListener("pointermove", (event) => this.onMove(event));
    canvas.addEventListener("pointerup", (event) => this.onUp(event));
    canvas.addEventListener("pointercancel", (event) => event.isPrimary && this.abandon());
    canvas.addEventListener("keydown", (event) => this.onKey(event));
    canvas.addEventListener("focus", () => this.showCross(canvas.matches(":focus-visible")));
    canvas.addEventListener("blur", () => this.showCross(false));
    canvas.addEventListener("dblclick", () => this.pen.finish());
  }

  /** Takes the shape of another clip's images, and forgets what it showed. */
  setImage({ width, height }: Size): void {
    this.image = { width, height };
    this.frame.style.aspectRatio = `${width} / ${height}`;
    this.frame.style.maxWidth = `max(16rem, calc((100vh - 15rem) * ${width / height}))`;
    this.pen.longer = Math.max(width, height);
    this.cross = undefined;
    this.scene = undefined;
    this.abandon();
    this.fit();
  }

  show(scene: Scene): void {
    this.scene = scene;
    this.draw();
  }

  /** Takes hold of the selected point, wherever it is: the next click, or Enter at the cross, says where it belongs. */
  place(): void {
    this.canvas.focus({ preventScroll: true });
    const { points = [], selected, frame = 0 } = this.scene ?? {};
    const point = points.find(({ id }) => id === selected);
    if (point === undefined) return;
    const [x = Number.NaN, y = Number.NaN] = point.track.xy.subarray(2 * frame, 2 * frame + 2);
    this.cross = Number.isNaN(x) ? this.centre() : roundPlace(clampPlace({ x, y }, this.image)); // it may not be followed there yet
    this.corner = undefined;
    this.hold(point.id, true);
    this.draw();
  }

  private fit(): void {
    const { clientWidth, clientHeight } = this.canvas;
    const [width, height] = [clientWidth, clientHeight].map((side) => Math.max(1, Math.round(side * devicePixelRatio)));
    if (width === this.canvas.width && height === this.canvas.height) return;
    Object.assign(this.canvas, { width, height });
    this.draw();
  }

  private draw(): void {
    const context = this.canvas.getContext("2d");
    if (context === null || this.scene === undefined) return;
    drawScene(context, this.scene);
    const outline = this.corner && this.cross ? box(this.corner, this.cross) : this.outline();
    const target = this.held === undefined ? undefined : (this.cross ?? (this.isDrag() ? this.path.at(-1) : undefined));
    if (outline.length > 1) this.stroke(context, outline.map((place) => this.onCanvas(place)));
    if (this.cross) this.drawCross(context, this.onCanvas(this.cross));
    if (target) {
      const { x, y } = this.onCanvas(target);
      drawDiamond(context, x, y, 2.1 * markRadius(Math.max(this.canvas.width, this.canvas.height)));
    }
  }

  private stroke(context: CanvasRenderingContext2D, places: readonly Place[]): void {
    const path = new Path2D();
    for (const { x, y } of places) path.lineTo(x, y);
    path.closePath();
    context.fillStyle = "rgb(255 255 255 / 14%)";
    context.fill(path);
    for (const [ink, dash] of [["#000", []], ["#fff", [6, 6]]] as const) {
      context.strokeStyle = ink;
      context.lineWidth = 2;
      context.setLineDash([...dash]);
      context.stroke(path);
    }
    context.setLineDash([]);
  }

  private drawCross(context: CanvasRenderingContext2D, { x, y }: Place): void {
    const arm = 3 * markRadius(Math.max(this.canvas.width, this.canvas.height));
    for (const [ink, width] of [["#000", 4], ["#fff", 1.5]] as const) {
      context.strokeStyle = ink;
      context.lineWidth = width;
      context.beginPath();
      context.moveTo(x - arm, y);
      context.lineTo(x + arm, y);
      context.moveTo(x, y - arm);
      context.lineTo(x, y + arm);
      context.stroke();
    }
  }

  private outline(): Place[] {
    const [first, last] = [this.path[0], this.path.at(-1)];
    if (first === undefined || last === undefined || this.held !== undefined || !this.isDrag()) return [];
    return this.shape === "box" ? box(first, last) : this.path;
  }

  private isDrag(): boolean {
    const first = this.path[0];
    const scale = this.canvas.clientWidth / this.image.width;
    const least = this.held === undefined ? this.near.area : this.near.point;
    return first !== undefined && this.path.some(({ x, y }) => Math.hypot(x - first.x, y - first.y) * scale > least);
  }

  private onCanvas({ x, y }: Place): Place {
    const { width, height } = this.canvas;
    return { x: ((x + 0.5) * width) / this.image.width, y: ((y + 0.5) * height) / this.image.height };
  }

  private placeOf(event: PointerEvent): Place {
    const area = this.canvas.getBoundingClientRect();
    const x = ((event.clientX - area.left) / area.width) * this.image.width - 0.5;
    const y = ((event.clientY - area.top) / area.height) * this.image.height - 0.5;
    return roundPlace(clampPlace({ x, y }, this.image));
  }

  private onDown(event: PointerEvent): void {
    if (event.button !== 0 || !event.isPrimary) return; // of two fingers the first
    this.near = event.pointerType === "touch" ? NEAR_FINGER : NEAR;
    this.canvas.setPointerCapture(event.pointerId);
    if (this.pen.isOut) {
      this.showCross(false);
      if (this.scene) this.events.onPress(this.placeOf(event), event.pressure || PRESSURE, this.scene.frame);
      return;
    }
    this.path = [this.placeOf(event)];
    this.seen = this.scene;
    this.showCross(false);
    if (this.placing) return;
    const id = event.shiftKey || this.seen === undefined ? undefined : this.pointAt(this.placeOf(event), this.seen);
    if (id === undefined) this.letGo();
    else this.hold(id, false);
  }

  private onMove(event: PointerEvent): void {
    if (!event.isPrimary) return;
    if (this.pen.isOut) {
      this.canvas.style.cursor = "";
      const all = event.getCoalescedEvents?.() ?? [];
      for (const each of all.length > 0 ? all : [event]) this.pen.go(this.placeOf(each), each.pressure || PRESSURE);
      return;
    }
    if (this.path.length === 0) {
      const over = !event.shiftKey && this.scene !== undefined && this.pointAt(this.placeOf(event), this.scene) !== undefined;
      this.canvas.style.cursor = over ? "grab" : "";
      return;
    }
    this.path.push(this.placeOf(event));
    this.draw();
  }

  private onUp(event: PointerEvent): void {
    if (!event.isPrimary) return;
    if (this.pen.isOut) {
      this.pen.lift(this.placeOf(event), this.near.select / this.zoom());
      return;
    }
    const [first, last, area, seen, held] = [this.path[0], this.placeOf(event), this.outline(), this.seen, this.held];
    const puts = this.placing || this.isDrag();
    this.abandon();
    if (first === undefined || seen === undefined) return;
    if (held !== undefined && puts) this.events.onCorrect(held, last, seen.frame);
    else if (area.length > 0) this.events.onArea(area, seen.frame);
    else this.events.onClick(first, seen.frame, held);
  }

  private hold(id: number, placing: boolean): void {
    [this.held, this.placing] = [id, placing];
    this.events.onHold(id, placing);
  }

  private letGo(): void {
    const { placing } = this;
    [this.held, this.placing] = [undefined, false];
    if (placing) this.events.onPlaced();
  }

  private zoom(): number {
    return this.canvas.clientWidth / this.image.width;
  }

  private abandon(): void {
    this.pen.cancel();
    this.path = [];
    this.corner = undefined;
    this.letGo();
    this.draw();
  }

  /** The point nearest to `place` among those whose mark is there. */
  private pointAt(place: Place, { frame, points }: Scene): number | undefined {
    const scale = this.canvas.clientWidth / this.image.width;
    const near = points
      .map(({ id, track }) => {
        const [dx, dy] = [(track.xy[2 * frame] ?? 0) - place.x, (track.xy[2 * frame + 1] ?? 0) - place.y];
        return { id, distance: Math.hypot(dx, dy) * scale };
      })
      .filter(({ distance }) => distance < this.near.select)
      .sort((a, b) => a.distance - b.distance);
    return near[0]?.id;
  }

  private centre(): Place {
    return { x: Math.floor(this.image.width / 2), y: Math.floor(this.image.height / 2) };
  }

  private showCross(shown: boolean): void {
    this.cross = shown ? (this.cross ?? this.centre()) : undefined;
    if (!shown) this.corner = undefined;
    if (!shown && this.path.length === 0) this.letGo(); // a drag goes on: its first press moves the focus here
    this.draw();
  }

  /** Enter puts the pen down and lifts it; of what takes one press, it does both. */
  private penKey(key: string, cross: Place, frame: number): boolean {
    if (key === "Escape") this.pen.cancel();
    else if (key !== "Enter") return false;
    else if (this.pen.isDown) this.pen.lift(cross, 0);
    else {
      this.events.onPress(cross, PRESSURE, frame);
      if (this.pen.isOfClicks) this.pen.lift(cross, 0);
    }
    return true;
  }

  private onKey(event: KeyboardEvent): void {
    const step = event.shiftKey ? 10 : 1;
    const moves: Record<string, readonly [number, number]> = {
      ArrowLeft: [-step, 0],
      ArrowRight: [step, 0],
      ArrowUp: [0, -step],
      ArrowDown: [0, step],
    };
    const move = moves[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    this.showCross(true);
    if (this.cross === undefined || this.scene === undefined) return;
    if (move !== undefined) {
      this.cross = clampPlace({ x: this.cross.x + move[0], y: this.cross.y + move[1] }, this.image, 0);
      this.pen.go(this.cross, PRESSURE);
    } else if (this.pen.isOut) {
      if (!this.penKey(event.key, this.cross, this.scene.frame)) return;
    } else if (event.key === "Enter") {
      if (this.held !== undefined) this.events.onCorrect(this.held, this.cross, this.scene.frame);
      else if (this.corner) this.events.onArea(box(this.corner, this.cross), this.scene.frame);
      else this.events.onClick(this.cross, this.scene.frame, undefined);
      this.abandon();
    } else if (event.key === "b" || event.key === "B") {
      this.letGo();
      this.corner = this.cross;
    } else if (event.key === "m" || event.key === "M") {
      this.place();
    } else if (event.key === "Escape") {
      this.abandon();
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
    this.draw();
  }
}
