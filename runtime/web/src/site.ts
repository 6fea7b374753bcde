/** What lies beside the page: `site.json`, written by `decomo-view`; paths are relative to the page. */

import type { ClipRecord } from "./clip";
import { InputError } from "./model/facts";

export interface Site {
  /** Of the model file, or of the `windows.json` of a clip of several windows, their model files beside it. */
  readonly model: string;
  readonly clip: ClipRecord | null;
  /** Whether `decomo-view` refits the model. */
  readonly refit: boolean;
}

/** Reads the text of `site.json`; `InputError` where it is not what `decomo-view` writes. */
export function readSite(text: string): Site {
  let site: Partial<Site> | null = null;
  try {
    site = JSON.parse(text);
  } catch {
    // as what is no site
  }
  const { model, clip, refit = false } = site ?? {};
  if (typeof model !== "string" || !(clip === null || isRecord(clip)) || typeof refit !== "boolean") {
    throw new InputError("site.json beside the page is damaged; write the folder again with 'decomo-view --export'.");
  }
  return { model, clip, refit };
}

function isRecord(clip: Partial<ClipRecord> | undefined): clip is ClipRecord {
  const { name, frames } = clip ?? {};
  return typeof name === "string" && Array.isArray(frames) && frames.every((path) => typeof path === "string");
}
