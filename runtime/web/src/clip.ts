/** The clip's own frames, decoded one by one and kept as long as there is room. */

import { InputError, type ModelFacts } from "./model/facts";
import { frameOrder } from "./order";

const CACHE_BYTES = 512 * 2 ** 20;
const AHEAD = 6;

/** What `site.json` beside the page says: `frames` are paths relative to the page. */
export interface ClipRecord {
  readonly name: string;
  readonly frames: readonly string[];
}

export class Clip {
  private readonly decoded = new Map<number, ImageBitmap>();
  private readonly underway = new Set<number>();
  private readonly room: number;
  private closed = false;

  /** `load` fetches one encoded frame; `onFrame` hears that one is decoded. */
  constructor(
    readonly length: number,
    private readonly facts: ModelFacts,
    private readonly load: (frame: number) => Promise<Blob>,
    private readonly onFrame: () => void,
    private readonly onError: (error: Error) => void,
  ) {
    this.room = Math.max(2 * AHEAD, Math.floor(CACHE_BYTES / (4 * facts.width * facts.height)));
  }

  /** `InputError` where it is not the clip of another model. */
  check(facts: ModelFacts): void {
    checkClip("the clip", this.length, this.facts, facts);
  }

  /** Opens image files as a clip, in the order of frames; `InputError` where they are not the clip of the model. */
  static async fromFiles(
    files: readonly File[],
    facts: ModelFacts,
    onFrame: () => void,
    onError: (error: Error) => void,
  ): Promise<Clip> {
    const named = new Map(files.map((file) => [file.name, file]));
    const ordered = frameOrder(files.map(({ name }) => name)).flatMap((name) => named.get(name) ?? []);
    const [first] = ordered;
    const picture = first && (await createImageBitmap(first).catch(() => undefined));
    if (first === undefined || picture === undefined) {
      throw new InputError(`${first?.name ?? "the clip"} does not decode as an image; give the frames of the clip.`);
    }
    checkClip(`the clip of ${first.name}`, ordered.length, picture, facts);
    return new Clip(ordered.length, facts, async (frame) => ordered[frame] ?? first, onFrame, onError);
  }

  /** The frame if it is decoded; if not, it will be, those after it next, and then the others that there is room for. */
  get(frame: number): ImageBitmap | undefined {
    for (let ahead = 0; ahead < Math.min(AHEAD, this.length); ahead++) void this.decode((frame + ahead) % this.length);
    const picture = this.decoded.get(frame);
    if (picture !== undefined) {
      this.decoded.delete(frame); // to the end of the order in which frames are dropped
      this.decoded.set(frame, picture);
    }
    return picture;
  }

  /** The frame, waited for. */
  async wait(frame: number): Promise<ImageBitmap> {
    const picture = this.decoded.get(frame) ?? (await this.read(frame));
    this.keep(frame, picture);
    return picture;
  }

  close(): void {
    this.closed = true;
    for (const picture of this.decoded.values()) picture.close();
    this.decoded.clear();
  }

  private async decode(frame: number): Promise<void> {
    if (this.decoded.has(frame) || this.underway.has(frame)) return;
    this.underway.add(frame);
    try {
      this.keep(frame, await this.read(frame));
      this.underway.delete(frame);
      this.onFrame();
      this.readAhead(frame);
    } catch (error) {
      this.onError(error instanceof Error ? error : new Error(String(error))); // stays underway: said once
    }
  }

  /** Decodes one more, the next after `frame` that is not, while none has to be dropped for it. */
  private readAhead(frame: number): void {
    if (this.closed || this.decoded.size + this.underway.size >= Math.min(this.room, this.length)) return;
    for (let ahead = 1; ahead < this.length; ahead++) {
      const next = (frame + ahead) % this.length;
      if (!this.decoded.has(next) && !this.underway.has(next)) return void this.decode(next);
    }
  }

  private async read(frame: number): Promise<ImageBitmap> {
    const picture = await createImageBitmap(await this.load(frame)).catch(() => {
      throw new InputError(`Frame ${frame} of the clip does not decode as an image; replace it.`);
    });
    checkClip("the clip", this.length, picture, this.facts);
    return picture;
  }

  private keep(frame: number, picture: ImageBitmap): void {
    this.decoded.set(frame, picture);
    for (const oldest of this.decoded.keys()) {
      if (this.decoded.size <= this.room) break;
      this.decoded.delete(oldest); // not closed: it may still be on the stage
    }
  }
}

/** `InputError` where a clip has not the length or size of the one that the model was fitted to. */
export function checkClip(name: string, length: number, size: { width: number; height: number }, facts: ModelFacts): void {
  if (length !== facts.numFrames || size.width !== facts.width || size.height !== facts.height) {
    throw new InputError(
      `${name[0]?.toUpperCase()}${name.slice(1)} has ${length} frames of ${size.width}x${size.height} but the model was ` +
        `fitted to ${facts.clipName} with ${facts.numFrames} frames of ${facts.width}x${facts.height}; give that clip.`,
    );
  }
}
