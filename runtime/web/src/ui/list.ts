/** The list of points: colour, name, how long it is seen, and a strip over time. */

import { type Point, type PointList, type Track, spans } from "../points";
import { make } from "./dom";

export interface ListEvents {
  onSelect(id: number): void;
  onSeek(frame: number): void;
}

interface Row {
  readonly item: HTMLLIElement;
  readonly needle: HTMLElement;
  /** Shows the point's name, colour and track. */
  readonly refresh: (point: Point) => void;
}

export class PointRows {
  private readonly rows = new Map<number, Row>();

  constructor(
    private readonly list: HTMLElement,
    private readonly points: PointList,
    private readonly events: ListEvents,
  ) {}

  /** Brings the rows up to date; those of points that stay are kept, with the focus in them. */
  update(selected: number | undefined): void {
    const wanted = new Set(this.points.all.map(({ id }) => id));
    for (const [id, { item }] of this.rows) {
      if (wanted.has(id)) continue;
      item.remove();
      this.rows.delete(id);
    }
    this.points.all.forEach((point, index) => {
      const row = this.rows.get(point.id) ?? this.build(point);
      this.rows.set(point.id, row);
      row.refresh(point);
      if (this.list.children[index] !== row.item) this.list.insertBefore(row.item, this.list.children[index] ?? null);
      row.item.setAttribute("aria-current", String(point.id === selected));
    });
  }

  /** Moves the needles. */
  showFrame(frame: number, numFrames: number): void {
    for (const { needle } of this.rows.values()) needle.style.left = `${((frame + 0.5) / numFrames) * 100}%`;
  }

  /** Scrolls the list where it is too long for its place, and never the page. */
  reveal(id: number): void {
    const row = this.rows.get(id)?.item.getBoundingClientRect();
    if (row === undefined) return;
    const list = this.list.getBoundingClientRect();
    this.list.scrollTop += Math.min(0, row.top - list.top) + Math.max(0, row.bottom - list.bottom);
  }

  private build(point: Point): Row {
    const { id } = point;
    const numFrames = point.track.occluded.length;
    const swatch = make("input", { type: "color" });
    swatch.addEventListener("change", () => this.points.change(id, { colour: swatch.value }));
    const label = make("input", { type: "text", ariaLabel: "Name", spellcheck: false, maxLength: 80 });
    label.addEventListener("change", () => this.points.change(id, { name: label.value.trim() || `Point ${id}` }));
    label.addEventListener("focus", () => this.events.onSelect(id));
    const share = make("small");
    const remove = make("button", { type: "button", title: "Delete" }, "×");
    remove.addEventListener("click", () => {
      const neighbour = item.nextElementSibling ?? item.previousElementSibling;
      this.points.remove(id);
      neighbour?.querySelector("button")?.focus();
    });
    const needle = make("i");
    const strip = make("div", { className: "strip", role: "img" }, needle);
    strip.addEventListener("pointerdown", (event) => {
      const area = strip.getBoundingClientRect();
      this.events.onSelect(id);
      this.events.onSeek(Math.floor(((event.clientX - area.left) / area.width) * numFrames));
    });
    const item = make("li", {}, swatch, label, share, remove, strip);
    let shown: Point | undefined;
    const refresh = (now: Point): void => {
      if (now === shown) return; // what is being typed stays
      const { name, colour, track } = now;
      if (name !== shown?.name) label.value = name;
      shown = now;
      const seen = track.occluded.filter((hidden) => !hidden).length;
      share.title = `in sight in ${seen} of ${numFrames} frames`;
      share.textContent = `${seen}/${numFrames}`;
      swatch.value = colour;
      swatch.ariaLabel = `Colour of ${name}`;
      remove.ariaLabel = `Delete ${name}`;
      strip.ariaLabel = describe(track);
      strip.style.backgroundImage = stripes(track, colour);
    };
    return { item, needle, refresh };
  }
}

/** Solid where the point is in sight, nothing where it is hidden. */
function stripes(track: Track, colour: string): string {
  const percent = (frame: number): string => `${(100 * frame) / track.occluded.length}%`;
  const stops = spans(track.occluded).map(
    ({ begin, end, occluded }) => `${occluded ? "transparent" : colour} ${percent(begin)} ${percent(end)}`,
  );
  return `linear-gradient(to right, ${stops.join(", ")})`;
}

function describe(track: Track): string {
  const hidden = spans(track.occluded).filter(({ occluded }) => occluded);
  if (hidden.length === 0) return "in sight in every frame";
  return `hidden in frames ${hidden.map(({ begin, end }) => (end - begin === 1 ? begin : `${begin} to ${end - 1}`)).join(", ")}`;
}
