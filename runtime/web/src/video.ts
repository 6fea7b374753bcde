/** Saves frames as a video, one by one, with the browser's own encoder. */

import { BufferTarget, CanvasSource, Mp4OutputFormat, Output, QUALITY_HIGH, WebMOutputFormat, getFirstEncodableVideoCodec } from "mediabunny";
import type { Size } from "./geometry";
import { InputError, type ModelFacts } from "./model/facts";
import { type Times, duration, isEven } from "./times";

const LONG_SIDE = 720;

/** An even size that shows the clip at least as large as `LONG_SIDE` where it is enlarged by a whole factor. */
export function videoSize({ width, height }: Size): Size {
  const factor = Math.max(1, Math.ceil(LONG_SIDE / Math.max(width, height)));
  return { width: 2 * Math.ceil((width * factor) / 2), height: 2 * Math.ceil((height * factor) / 2) };
}

/** What the file is told of the rate: nothing where it varies, since times would be moved to it. */
export const rateOf = (times: Times): { frameRate?: number } => (isEven(times) ? { frameRate: times.fps } : {});

export interface Saved {
  readonly content: ArrayBuffer;
  readonly suffix: "mp4" | "webm";
  readonly type: string;
}

/** Draws one frame. */
export type Draw = (context: OffscreenCanvasRenderingContext2D, frame: number) => Promise<void>;

const FORMATS = [
  ["mp4", () => new Mp4OutputFormat({ fastStart: "in-memory" }), ["avc"]],
  ["webm", () => new WebMOutputFormat(), ["vp9", "vp8"]],
] as const;

/** Encodes what is drawn of all frames; mp4 where the browser can, else webm. */
export async function encodeVideo(facts: ModelFacts, draw: Draw, onProgress: (frame: number) => void): Promise<Saved> {
  if (!("VideoEncoder" in window)) {
    throw new InputError("This browser cannot encode video (it has no WebCodecs); use 'decomo-track --overlay' instead.");
  }
  const size = videoSize(facts);
  for (const [suffix, format, codecs] of FORMATS) {
    const codec = await getFirstEncodableVideoCodec([...codecs], size);
    if (codec === null) continue;
    const canvas = new OffscreenCanvas(size.width, size.height);
    const context = canvas.getContext("2d");
    if (context === null) break;
    const target = new BufferTarget();
    const output = new Output({ format: format(), target });
    const source = new CanvasSource(canvas, { codec, bitrate: QUALITY_HIGH });
    output.addVideoTrack(source, rateOf(facts));
    await output.start();
    for (let frame = 0; frame < facts.numFrames; frame++) {
      await draw(context, frame);
      await source.add(facts.times[frame] ?? 0, duration(facts, frame));
      onProgress(frame);
    }
    await output.finalize();
    if (target.buffer === null) break;
    return { content: target.buffer, suffix, type: `video/${suffix}` };
  }
  throw new InputError("This browser has no encoder for H.264, VP9 or VP8; use 'decomo-track --overlay' instead.");
}
