/** The clip's own frames, decoded one by one and kept as long as there is room. */

import { checkDepth } from "./depth";
import { OPEN_AGAIN, contentOf } from "./files/content";
import { InputError, type ModelFacts } from "./model/facts";
import { frameOrder } from "./order";

const CACHE_BYTES = 128 * 2 ** 20;
const LEAST_ROOM = 4;
const AHEAD = 6;
const AT_ONCE = 3;
/** After which a frame that did not come is asked for again, if it is still wanted. */
const LOST_MILLISECONDS = 2000;

/** A frame that did not come now, but may come later. */
export class LostError extends InputError {}

/** What `site.json` beside the page says: `frames` are paths relative to the page. */
export interface ClipRecord {
  readonly name: string;
  readonly frames: readonly string[];
}

export class Clip {
  /** By frame, the last used last. */
  private readonly decoded = new Map<number, ImageBitmap>();
  private readonly underway = new Set<number>();
  private readonly failed = new Set<number>();
  private readonly room: number;
  /** Frames from the one wanted on that drop others. */
  private readonly ahead: number;
  private wanted = 0;
  private closed = false;

  /** `load` fetches one encoded frame; `onFrame` hears that one is decoded. */
  constructor(
    readonly length: number,
    private readonly facts: ModelFacts,
    private readonly load: (frame: number) => Promise<Blob>,
    private readonly onFrame: () => void,
    private readonly onError: (error: Error) => void,
  ) {
    this.room = Math.max(LEAST_ROOM, Math.floor(CACHE_BYTES / (4 * facts.width * facts.height)));
    this.ahead = Math.min(AHEAD, this.room - 1);
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
    const picture = first && (await createImageBitmap(await blobOf(first)).catch(() => undefined));
    if (first === undefined || picture === undefined) {
      throw new InputError(`${first?.name ?? "the clip"} does not decode as an image; give the frames of the clip.`);
    }
    checkClip(`the clip of ${first.name}`, ordered.length, picture, facts);
    picture.close();
    await checkDepth(ordered);
    return new Clip(ordered.length, facts, (frame) => blobOf(ordered[frame] ?? first), onFrame, onError);
  }

  /** The frame if it is decoded; if not, it will be, those after it next, and then the others that there is room for. */
  get(frame: number): ImageBitmap | undefined {
    this.wanted = frame;
    this.goOn();
    return this.peek(frame);
  }

  /** The frame if it is decoded. */
  peek(frame: number): ImageBitmap | undefined {
    const picture = this.decoded.get(frame);
    if (picture !== undefined) this.keep(frame, picture);
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

  /** Decodes what is wanted most, few frames at once, so that one that is wanted later need not wait for many. */
  private goOn(): void {
    while (!this.closed && this.underway.size < AT_ONCE) {
      const next = this.next();
      if (next === undefined) return;
      void this.decode(next);
    }
  }

  /** The first after the one wanted that is not decoded; undefined where another, nearer one would have to be dropped for it. */
  private next(): number | undefined {
    const isFull = this.decoded.size + this.underway.size >= this.room;
    for (let ahead = 0; ahead < (isFull ? Math.min(this.ahead, this.length) : this.length); ahead++) {
      const frame = (this.wanted + ahead) % this.length;
      if (!this.decoded.has(frame) && !this.underway.has(frame) && !this.failed.has(frame)) return frame;
    }
    return undefined;
  }

  private async decode(frame: number): Promise<void> {
    this.underway.add(frame);
    try {
      this.keep(frame, await this.read(frame));
      if (!this.closed) this.onFrame();
    } catch (error) {
      this.failed.add(frame); // said once
      if (error instanceof LostError) setTimeout(() => this.failed.delete(frame), LOST_MILLISECONDS);
      this.onError(error instanceof Error ? error : new Error(String(error)));
    } finally {
      this.underway.delete(frame);
      this.goOn();
    }
  }

  private async read(frame: number): Promise<ImageBitmap> {
    const picture = await createImageBitmap(await this.load(frame)).catch(() => {
      throw new InputError(`Frame ${frame} of the clip does not decode as an image; replace it.`);
    });
    checkClip("the clip", this.length, picture, this.facts);
    return picture;
  }

  /** Keeps a frame as the last used one; what has to leave gives its memory back at once. */
  private keep(frame: number, picture: ImageBitmap): void {
    if (this.closed) return picture.close();
    const former = this.decoded.get(frame);
    if (former !== picture) former?.close();
    this.decoded.delete(frame);
    this.decoded.set(frame, picture);
    for (const [oldest, dropped] of this.decoded) {
      if (this.decoded.size <= this.room) break;
      this.decoded.delete(oldest);
      dropped.close();
    }
  }
}

/** What a file holds now, so that one that has changed is told from one that is no image. */
const blobOf = async (file: File): Promise<Blob> => new File([await contentOf(file, file.name, OPEN_AGAIN)], file.name);

/** `InputError` where a clip has not the length or size of the one that the model was fitted to. */
export function checkClip(name: string, length: number, size: { width: number; height: number }, facts: ModelFacts): void {
  if (length !== facts.numFrames || size.width !== facts.width || size.height !== facts.height) {
    throw new InputError(
      `${name[0]?.toUpperCase()}${name.slice(1)} has ${length} frames of ${size.width}x${size.height} but the model was ` +
        `fitted to ${facts.clipName} with ${facts.numFrames} frames of ${facts.width}x${facts.height}; give that clip.`,
    );
  }
}
