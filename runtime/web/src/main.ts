/** Starts the page: what the browser lacks is said first, then the model and clip beside the page are opened. */

import { App } from "./app";
import type { Files } from "./model/client";
import { InputError } from "./model/facts";
import { Refits } from "./refit";
import { readSite } from "./site";
import { listenToFiles } from "./ui/files";
import { listenToKeys } from "./ui/keys";
import { RefitPanel } from "./ui/refit";
import { View } from "./ui/view";

const OPEN_ONE = "Open a model, or drop one here: the .onnx file, or the folder, that 'decomo-export' wrote.";
/** A function in WebAssembly that holds an instruction of SIMD. */
const SIMD = [0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11];

async function start(): Promise<void> {
  view.loading("Loading …");
  const lacking = whatIsLacking();
  if (lacking !== undefined) {
    view.loading("");
    throw new InputError(`This browser has no ${lacking}, which the page needs; use a current Chrome, Edge, Firefox or Safari.`);
  }
  await openSite().catch((error: unknown) => {
    view.loading(OPEN_ONE);
    throw error;
  });
}

/** What lies beside the page. */
const beside: Files = {
  has: () => true,
  read: async (path) => {
    const response = await fetch(path).catch(() => undefined);
    if (!response?.ok) throw new InputError(`${path} cannot be loaded from where the page lies; copy it there again, or start 'decomo-view' again.`);
    return (await response.blob()).arrayBuffer(); // of its length; the response's own leaves a larger copy behind
  },
};

/** Opens the model and the clip beside the page, where there are some. */
async function openSite(): Promise<void> {
  const response = await fetch("site.json");
  if (!response.ok) {
    view.loading(OPEN_ONE);
    return;
  }
  const site = readSite(await response.text());
  await app.openModel(site.model, beside);
  if (site.clip && app.files === beside) app.openServedClip(site.clip);
  if (site.refit) new RefitPanel(app, view, new Refits(), beside);
}

function whatIsLacking(): string | undefined {
  if (!("WebAssembly" in window)) return "WebAssembly";
  if (!WebAssembly.validate(new Uint8Array(SIMD))) return "WebAssembly with SIMD";
  if (!("Worker" in window)) return "workers";
  if (!("DecompressionStream" in window)) return "DecompressionStream";
  if (!("OffscreenCanvas" in window)) return "OffscreenCanvas";
  return undefined;
}

const view = new View();
const app = new App(view);
view.connect(app);
listenToFiles(app, view);
listenToKeys(app, view);
view.attempt(start());
