/** The list of what the user gave: which point, in which frame, and where; a click goes there. */

import { type Correction, type Document, withoutCorrection } from "../document";
import { make } from "./dom";
import type { ListEvents } from "./list";

export class CorrectionRows {
  private shown: { corrections: readonly Correction[]; points: Document["points"] } | undefined;

  constructor(
    private readonly list: HTMLElement,
    private readonly document: Document,
    private readonly events: ListEvents,
  ) {}

  /** Brings the rows up to date. */
  update(): void {
    const { corrections, points } = this.document;
    if (this.shown?.corrections === corrections && this.shown.points === points) return;
    this.shown = { corrections, points };
    const names = new Map(points.map(({ id, name }) => [id, name]));
    this.list.replaceChildren(...corrections.map((each) => this.build(each, names.get(each.point) ?? "")));
  }

  private build(correction: Correction, name: string): HTMLLIElement {
    const { point, t, place } = correction;
    const where = place === null ? "hidden" : `at (${place.x}, ${place.y})`;
    const go = make("button", { type: "button", className: "go" }, `${name} · frame ${t}: ${where}`);
    go.addEventListener("click", () => {
      this.events.onSelect(point);
      this.events.onSeek(t);
    });
    const remove = make("button", { type: "button", title: "Delete", ariaLabel: `Delete the correction of ${name} in frame ${t}` }, "×");
    remove.addEventListener("click", () => {
      const index = [...this.list.children].indexOf(item);
      this.document.change((content) => withoutCorrection(content, correction));
      (this.list.children[index] ?? this.list.lastElementChild)?.querySelector<HTMLElement>("button:last-child")?.focus();
    });
    const item = make("li", {}, go, remove);
    return item;
  }
}
