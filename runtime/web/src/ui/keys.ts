/** Keys that work all over the page, except where one types or a control needs them itself. */

import type { App } from "../app";
import { LAYERS } from "../layers";
import { element } from "./dom";
import type { View } from "./view";

/** What the space bar presses, opens or ticks. */
const PRESSED = "button, summary, a, input[type=checkbox], input[type=color], input[type=radio]:not(:checked)";

export function listenToKeys(app: App, view: View): void {
  document.addEventListener("keydown", (event) => {
    const target = event.target instanceof Element ? event.target : document.body;
    if (event.defaultPrevented || target.closest("input[type=text], input[type=number], select, dialog")) return;
    const action = actionOf(event, app, target.closest("input") !== null, target.closest(PRESSED) !== null);
    if (action === undefined) return;
    event.preventDefault();
    view.attempt(Promise.resolve().then(action));
  });
}

function actionOf(event: KeyboardEvent, app: App, onInput: boolean, isPressed: boolean): (() => void) | undefined {
  if (event.altKey) return undefined;
  if (event.ctrlKey || event.metaKey) {
    const key = event.key.toLowerCase();
    if (key === "y" || (key === "z" && event.shiftKey)) return () => app.document.redo();
    return key === "z" ? () => app.document.undo() : undefined;
  }
  const layer = LAYERS[Number(event.key) - 1];
  if (layer !== undefined) return () => app.showLayer(layer);
  if (event.key === " ") return isPressed ? undefined : () => event.repeat || app.player.toggle();
  if (event.key === ",") return () => app.player.step(-1);
  if (event.key === ".") return () => app.player.step(1);
  if (event.key === "?") return () => element("keys", HTMLDialogElement).showModal();
  if (event.key === "h" || event.key === "H") return () => app.markOther();
  if (event.key === "n" || event.key === "N") return () => app.jump(1);
  if (event.key === "p" || event.key === "P") return () => app.jump(-1);
  if (event.key === "Delete") return () => app.removeSelected();
  if (onInput) return undefined;
  const keys: Record<string, () => void> = {
    ArrowLeft: () => app.player.step(-1),
    ArrowRight: () => app.player.step(1),
    Home: () => app.player.seek(0),
    End: () => app.player.seek(Number.MAX_SAFE_INTEGER),
  };
  return keys[event.key];
}
