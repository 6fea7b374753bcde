/** The panel that shows how sure the model is: colours with their legend, a map over the picture, and jumps. */

import type { App } from "../app";
import { unit } from "../model/errors";
import { inPixels, leastSure, legend } from "../sureness";
import { element, make } from "./dom";

export class ErrorPanel {
  private readonly colours = element("error-colours", HTMLInputElement);
  private readonly heat = element("error-heat", HTMLInputElement);
  private readonly said = element("error-said", HTMLOutputElement);

  /** Wires the controls to what they control. */
  connect(app: App): void {
    this.colours.addEventListener("change", () => app.colourByError(this.colours.checked));
    this.heat.addEventListener("change", () => app.showHeat(this.heat.checked));
    for (const [id, step] of [["error-previous", -1], ["error-next", 1]] as const) {
      element(id, HTMLButtonElement).addEventListener("click", () => app.jump(step));
    }
  }

  /** The scale of another model's clip. */
  opened(app: App): void {
    if (app.model === undefined) return;
    const { colours, ticks } = legend(unit(app.model.facts));
    const bar = element("error-scale", HTMLDivElement);
    bar.style.backgroundImage = `linear-gradient(to right, ${colours.join(", ")})`;
    const labels = ticks.map(({ share, pixels }) => {
      const label = make("span", {}, pixels);
      label.style.left = `${100 * share}%`;
      return label;
    });
    element("error-ticks", HTMLDivElement).replaceChildren(...labels);
  }

  /** What follows from the points, their tracks, and the frame. */
  update({ followed, selected, byError, heatShown, player: { frame } }: App): void {
    this.colours.checked = byError;
    this.heat.checked = heatShown;
    element("error-legend", HTMLDivElement).hidden = !byError && !heatShown;
    const none = leastSure(followed).length === 0;
    for (const id of ["error-previous", "error-next"]) element(id, HTMLButtonElement).disabled = none;
    this.showFrame(followed.find(({ id }) => id === selected), frame);
  }

  showFrame(point: App["followed"][number] | undefined, frame: number): void {
    const error = point?.track.error[frame];
    const hidden = point?.track.occluded[frame] === true ? "hidden; if it is in sight, " : "";
    this.said.value = point === undefined || error === undefined ? "" : `${point.name}, frame ${frame}: ${hidden}within ${inPixels(error)} px`;
  }
}
