/**
 * Saves frames as WebM with alpha: VP8, whose alpha is a second stream, that of its luma.
 *
 * mediabunny, which writes the file, splits colours and alpha in a worker that it makes itself; the page's policy forbids
 * such workers, so they are split here.
 */

import { BufferTarget, EncodedPacket, EncodedVideoPacketSource, Output, WebMOutputFormat } from "mediabunny";
import type { Size } from "./geometry";
import { InputError, type ModelFacts } from "./model/facts";
import { duration } from "./times";
import { type Draw, type Saved, rateOf, videoSize } from "./video";

const CODEC = "vp8";
const BITS_PER_PIXEL = 0.25;
/** From one frame that is coded by itself to the next. */
const KEY_FRAMES = 48;
/** Frames that wait to be encoded. */
const MOST_WAITING = 4;

/** Encodes what is drawn of all frames on transparent ground; `InputError` where the browser cannot. */
export async function encodeAlphaVideo(facts: ModelFacts, draw: Draw, onProgress: (frame: number) => void): Promise<Saved> {
  const size = videoSize(facts);
  const bitrate = Math.round(BITS_PER_PIXEL * size.width * size.height * facts.fps);
  const config = { codec: CODEC, ...size, bitrate, framerate: facts.fps };
  const can = "VideoEncoder" in window && (await VideoEncoder.isConfigSupported(config)).supported;
  const context = new OffscreenCanvas(size.width, size.height).getContext("2d", { willReadFrequently: true });
  if (!can || context === null) {
    throw new InputError("This browser cannot encode video with alpha (WebCodecs, VP8); save the drawings as frames, or use 'decomo-render --edit --alone'.");
  }
  const [colours, alphas] = [new Stream(config), new Stream(config)];
  for (let frame = 0; frame < facts.numFrames; frame++) {
    context.clearRect(0, 0, size.width, size.height);
    await draw(context, frame);
    const { data } = context.getImageData(0, 0, size.width, size.height);
    const at = { timestamp: microseconds(facts.times[frame] ?? 0), duration: microseconds(duration(facts, frame)) };
    await alphas.add(new VideoFrame(lumaOf(data, size), { format: "I420", codedWidth: size.width, codedHeight: size.height, ...at }), frame);
    await colours.add(new VideoFrame(data, { format: "RGBX", codedWidth: size.width, codedHeight: size.height, ...at }), frame);
    onProgress(frame);
  }
  const [seen, alpha] = [await colours.end(), await alphas.end()];
  const target = new BufferTarget();
  const output = new Output({ format: new WebMOutputFormat(), target });
  const source = new EncodedVideoPacketSource(CODEC);
  output.addVideoTrack(source, { ...rateOf(facts), canBeTransparent: true });
  await output.start();
  for (const [index, chunk] of seen.entries()) {
    const side = alpha[index];
    if (side === undefined) throw new Error("the encoder has lost a frame");
    const bytes = new Uint8Array(side.byteLength);
    side.copyTo(bytes);
    const decoderConfig = { codec: CODEC, codedWidth: size.width, codedHeight: size.height };
    await source.add(EncodedPacket.fromEncodedChunk(chunk, { alpha: bytes }), { decoderConfig });
  }
  await output.finalize();
  if (target.buffer === null) throw new Error("no file was written");
  return { content: target.buffer, suffix: "webm", type: "video/webm" };
}

const microseconds = (seconds: number): number => Math.round(1e6 * seconds);

/** One of the two streams on its way. */
class Stream {
  private readonly chunks: EncodedVideoChunk[] = [];
  private error: Error | undefined;
  private readonly encoder: VideoEncoder;

  constructor(config: VideoEncoderConfig) {
    this.encoder = new VideoEncoder({ output: (chunk) => this.chunks.push(chunk), error: (error) => (this.error = error) });
    this.encoder.configure(config);
  }

  /** Encodes a frame and closes it. */
  async add(frame: VideoFrame, number: number): Promise<void> {
    while (this.error === undefined && this.encoder.encodeQueueSize >= MOST_WAITING) await new Promise((done) => setTimeout(done, 5));
    if (this.error !== undefined) throw this.error;
    this.encoder.encode(frame, { keyFrame: number % KEY_FRAMES === 0 });
    frame.close();
  }

  async end(): Promise<readonly EncodedVideoChunk[]> {
    await this.encoder.flush();
    this.encoder.close();
    if (this.error !== undefined) throw this.error;
    return this.chunks;
  }
}

/** A picture's alpha as the luma of a grey one, I420. */
function lumaOf(data: Uint8ClampedArray, { width, height }: Size): Uint8Array<ArrayBuffer> {
  const luma = new Uint8Array((3 * width * height) / 2).fill(128);
  for (let pixel = 0; pixel < width * height; pixel++) luma[pixel] = data[4 * pixel + 3] ?? 0;
  return luma;
}
