/** The list of layers, the topmost first: shown or not, name, what it belongs to, order; a click goes where it was drawn. */

import type { Document } from "../document";
import { type Drawing, OWNERS, drawnFrames, redrawn, reordered, withoutDrawing } from "../drawings";
import type { Sketch } from "../sketch";
import { make } from "./dom";

/** Names a control of a row, so that the focus finds it again in a new row. */
type Keyed = <T extends HTMLElement>(control: T, what: string) => T;

const OWNER_NAMES = { seen: "what is seen", static: "the scene", dynamic: "the objects" } as const;

export class DrawingRows {
  private shown: { drawings: readonly Drawing[]; selected: number | undefined } | undefined;

  constructor(
    private readonly list: HTMLElement,
    private readonly document: Document,
    private readonly sketch: Sketch,
    private readonly onSeek: (frame: number) => void,
    private readonly onSelect: () => void,
  ) {}

  /** Brings the rows up to date; the control that has the focus keeps it. */
  update(): void {
    const { drawings } = this.document;
    const { selected } = this.sketch;
    if (this.shown?.drawings === drawings && this.shown.selected === selected) return;
    this.shown = { drawings, selected };
    const focused = this.list.contains(document.activeElement) ? document.activeElement : null;
    const key = focused instanceof HTMLElement ? focused.dataset.key : undefined;
    this.list.replaceChildren(...[...drawings].reverse().map((each) => this.build(each)));
    if (key !== undefined) this.list.querySelector<HTMLElement>(`[data-key="${key}"]`)?.focus();
  }

  private build(drawing: Drawing): HTMLLIElement {
    const { id, name, shown } = drawing;
    const change = (part: Partial<Omit<Drawing, "id">>): void => this.document.change((content) => redrawn(content, id, part));
    const keyed: Keyed = (control, what) => {
      control.dataset.key = `${id} ${what}`;
      return control;
    };
    const eye = make("input", { type: "checkbox", checked: shown, ariaLabel: `Show ${name}`, title: "Shown" });
    eye.addEventListener("change", () => change({ shown: eye.checked }));
    const label = make("input", { type: "text", value: name, ariaLabel: "Name of the layer", spellcheck: false, maxLength: 80 });
    label.addEventListener("focus", () => this.select(id));
    label.addEventListener("change", () => change({ name: label.value.trim() || name }));
    const frames = drawnFrames(drawing);
    const go = frames.map((t) => {
      const button = make("button", { type: "button", className: "go" }, `frame ${t}`);
      button.ariaLabel = `${name}: go to frame ${t}, over which it was drawn`;
      button.addEventListener("click", () => {
        this.select(id);
        this.onSeek(t);
      });
      return keyed(button, `go ${t}`);
    });
    const buttons = (
      [
        ["↑", "Up", () => this.document.change((content) => reordered(content, id, 1))],
        ["↓", "Down", () => this.document.change((content) => reordered(content, id, -1))],
        ["×", "Delete", () => this.document.change((content) => withoutDrawing(content, id))],
      ] as const
    ).map(([sign, title, action]) => {
      const button = make("button", { type: "button", title, ariaLabel: `${title}: ${name}` }, sign);
      button.addEventListener("click", action);
      return keyed(button, title);
    });
    const item = make("li", {}, keyed(eye, "shown"), keyed(label, "name"), ...buttons, make("p", {}, this.kind(drawing, change, keyed), ...go));
    item.setAttribute("aria-current", String(id === this.sketch.selected));
    item.addEventListener("pointerdown", () => this.select(id));
    return item;
  }

  /** The colour of a mask, or what a layer of paint belongs to. */
  private kind({ name, kind, on, colour }: Drawing, change: (part: Partial<Drawing>) => void, keyed: Keyed): HTMLElement {
    if (kind === "mask") {
      const swatch = make("input", { type: "color", value: colour, ariaLabel: `Colour of ${name}` });
      swatch.addEventListener("change", () => change({ colour: swatch.value }));
      return keyed(swatch, "colour");
    }
    const owners = make("select", { ariaLabel: `${name} is on` }, ...OWNERS.map((owner) => make("option", { value: owner, selected: owner === on }, OWNER_NAMES[owner])));
    owners.addEventListener("change", () => {
      const chosen = OWNERS.find((owner) => owner === owners.value);
      if (chosen !== undefined) change({ on: chosen });
    });
    return keyed(owners, "on");
  }

  private select(id: number): void {
    if (this.sketch.selected === id) return;
    this.sketch.selected = id;
    for (const [index, item] of [...this.list.children].reverse().entries()) {
      item.setAttribute("aria-current", String(this.document.drawings[index]?.id === id));
    }
    if (this.shown) this.shown = { ...this.shown, selected: id };
    this.onSelect();
  }
}
