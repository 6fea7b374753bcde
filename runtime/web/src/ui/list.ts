/** The list of points: colour, name, how long it is seen, and a strip over time. */

import { type Document, changed, withoutPoint } from "../document";
import { errorColour } from "../sureness";
import { type Followed, type Track, spans } from "../tracks";
import { make } from "./dom";

export interface ListEvents {
  onSelect(id: number): void;
  onSeek(frame: number): void;
}

interface Row {
  readonly item: HTMLLIElement;
  readonly strip: HTMLElement;
  readonly needle: HTMLElement;
  /** Shows the point's name, colour and track, and what is given of it. */
  readonly refresh: (point: Followed, errorUnit: number | undefined) => void;
}

export class PointRows {
  private readonly rows = new Map<number, Row>();

  constructor(
    private readonly list: HTMLElement,
    private readonly document: Document,
    private readonly events: ListEvents,
  ) {}

  /**
   * Brings the rows up to date; those of points that stay are kept, with the focus in them. Strips are coloured by
   * expected errors where `errorUnit`, the length of a unit in pixels of the clip, is given.
   */
  update(points: readonly Followed[], selected: number | undefined, errorUnit?: number): void {
    const wanted = new Set(points.map(({ id }) => id));
    for (const [id, { item }] of this.rows) {
      if (wanted.has(id)) continue;
      item.remove();
      this.rows.delete(id);
    }
    points.forEach((point, index) => {
      const row = this.rows.get(point.id) ?? this.build(point);
      this.rows.set(point.id, row);
      row.refresh(point, errorUnit);
      if (this.list.children[index] !== row.item) this.list.insertBefore(row.item, this.list.children[index] ?? null);
      row.item.setAttribute("aria-current", String(point.id === selected));
    });
  }

  /** Moves the needles. */
  showFrame(frame: number, numFrames: number): void {
    for (const { needle, strip } of this.rows.values()) {
      needle.style.left = middleOf(frame, numFrames);
      strip.ariaValueNow = String(frame);
    }
  }

  /** Scrolls the list where it is too long for its place, and never the page. */
  reveal(id: number): void {
    const row = this.rows.get(id)?.item.getBoundingClientRect();
    if (row === undefined) return;
    const list = this.list.getBoundingClientRect();
    this.list.scrollTop += Math.min(0, row.top - list.top) + Math.max(0, row.bottom - list.bottom);
  }

  private build(point: Followed): Row {
    const { id } = point;
    const numFrames = point.track.occluded.length;
    const swatch = make("input", { type: "color" });
    swatch.addEventListener("change", () => this.document.change((content) => changed(content, id, { colour: swatch.value })));
    const label = make("input", { type: "text", ariaLabel: "Name", spellcheck: false, maxLength: 80 });
    label.addEventListener("change", () => {
      const name = label.value.trim() || `Point ${id}`;
      this.document.change((content) => changed(content, id, { name }));
    });
    label.addEventListener("focus", () => this.events.onSelect(id));
    const share = make("small");
    const remove = make("button", { type: "button", title: "Delete" }, "×");
    remove.addEventListener("click", () => {
      const neighbour = item.nextElementSibling ?? item.previousElementSibling;
      this.document.change((content) => withoutPoint(content, id));
      neighbour?.querySelector("button")?.focus();
    });
    const needle = make("i");
    const strip = make("div", { className: "strip", role: "slider", tabIndex: 0, ariaValueMin: "0", ariaValueMax: String(numFrames - 1) });
    strip.addEventListener("focus", () => this.events.onSelect(id)); // the arrows step through frames, as everywhere
    strip.addEventListener("pointerdown", (event) => {
      const area = strip.getBoundingClientRect();
      this.events.onSelect(id);
      this.events.onSeek(Math.floor(((event.clientX - area.left) / area.width) * numFrames));
    });
    const item = make("li", {}, swatch, label, share, remove, strip);
    let shown: Followed | undefined;
    let colouredBy: number | undefined;
    const refresh = (now: Followed, errorUnit: number | undefined): void => {
      if (now === shown && errorUnit === colouredBy) return; // what is being typed stays
      colouredBy = errorUnit;
      strip.style.backgroundImage = stripes(now, errorUnit);
      const { name, colour, track, given } = now;
      if (name !== shown?.name) label.value = name;
      shown = now;
      const seen = track.occluded.filter((hidden) => !hidden).length;
      share.title = `in sight in ${seen} of ${numFrames} frames`;
      share.textContent = `${seen}/${numFrames}`;
      swatch.value = colour;
      swatch.ariaLabel = `Colour of ${name}`;
      remove.ariaLabel = `Delete ${name}`;
      strip.ariaLabel = `${name}: ${[describe(track), ...given.map(({ t }) => `given in frame ${t}`)].join(", ")}`;
      strip.replaceChildren(...given.map(({ t }) => mark(t, numFrames)), needle);
    };
    return { item, strip, needle, refresh };
  }
}

/** A diamond in the strip: something is given there. */
function mark(frame: number, numFrames: number): HTMLElement {
  const made = make("b");
  made.style.left = middleOf(frame, numFrames);
  return made;
}

const middleOf = (frame: number, numFrames: number): string => `${((frame + 0.5) / numFrames) * 100}%`;

/** Solid, or coloured by expected errors, where the point is in sight, nothing where it is hidden. */
function stripes({ track, colour }: Followed, errorUnit: number | undefined): string {
  const percent = (frame: number): string => `${(100 * frame) / track.occluded.length}%`;
  const inSight = (begin: number, end: number): string[] =>
    errorUnit === undefined
      ? [`${colour} ${percent(begin)} ${percent(end)}`]
      : [...track.error.subarray(begin, end)].map((error, index) => `${errorColour(error, errorUnit)} ${percent(begin + index)} ${percent(begin + index + 1)}`);
  const stops = spans(track.occluded).flatMap(({ begin, end, occluded }) =>
    occluded ? [`transparent ${percent(begin)} ${percent(end)}`] : inSight(begin, end),
  );
  return `linear-gradient(to right, ${stops.join(", ")})`;
}

function describe(track: Track): string {
  const hidden = spans(track.occluded).filter(({ occluded }) => occluded);
  if (hidden.length === 0) return "in sight in every frame";
  return `hidden in frames ${hidden.map(({ begin, end }) => (end - begin === 1 ? begin : `${begin} to ${end - 1}`)).join(", ")}`;
}
