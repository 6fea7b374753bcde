/** What files hold. A browser reads none that has changed since it was chosen. */

import { InputError } from "../model/facts";

/** What to do where it is a frame. */
export const OPEN_AGAIN = "open the frames of the clip again";

/** The bytes of a file or of a part of it; `InputError` where they cannot be read, which says what to do about it. */
export async function contentOf(file: Blob, name: string, again = "open it again"): Promise<Uint8Array<ArrayBuffer>> {
  const content = await file.arrayBuffer().catch(() => undefined);
  if (content === undefined) throw new InputError(`${name} cannot be read, or has changed; ${again}.`);
  return new Uint8Array(content);
}
