/** The pictures of frames: the clip's own, what the model renders, two of these side by side, and where it is unsure. */

import { Clip, type ClipRecord, LostError } from "./clip";
import type { Scene } from "./draw";
import { HeatMaps, paintHeat } from "./heat";
import { type Layer, LayerRenderer, type Raster, type Rendered } from "./layers";
import type { Model } from "./model/client";
import { unit } from "./model/errors";
import { InputError, type ModelFacts } from "./model/facts";

const MOST_CANVASES = 8;

/** What of a scene is pictures. */
export type Shown = Pick<Scene, "left" | "right" | "split">;

export class Pictures {
  layer: Layer = "fused";
  /** What is shown right of the split, which is at a fraction of the width. */
  split: Layer | undefined;
  splitAt = 0.5;
  private clip: Clip | undefined;
  /** Of the clips that were asked for. */
  private opening = 0;
  private facts: ModelFacts | undefined;
  private renderer: LayerRenderer | undefined;
  private heatMaps: HeatMaps | undefined;
  /** The last canvases that were painted with parts of rasters. */
  private readonly rasterCanvases = new Map<ImageData, OffscreenCanvas>();

  /** `onPicture` hears of a frame of which there is more to show; undefined: of any. */
  constructor(
    private readonly onPicture: (frame?: number) => void,
    private readonly onError: (error: unknown) => void,
  ) {}

  get hasClip(): boolean {
    return this.clip !== undefined;
  }

  /** Renders by a model from now on. */
  use(model: Model): void {
    this.renderer?.close();
    this.heatMaps?.cancel();
    this.facts = model.facts;
    this.renderer = new LayerRenderer(model.facts, (queries) => model.render(queries), this.onPicture, this.onError);
    this.heatMaps = new HeatMaps(model.facts, (queries, frames) => model.glance(queries, frames), this.onPicture, this.onError);
  }

  /** Begins as another model of another clip does: the clip goes where it is not that model's. */
  begin(): void {
    this.split = undefined;
    if (this.clip !== undefined && this.facts !== undefined) {
      try {
        this.clip.check(this.facts);
      } catch (error) {
        this.clip.close();
        this.clip = undefined;
        this.onError(error);
      }
    }
    this.layer = this.clip ? "clip" : "fused";
  }

  /** Shows the clip that `site.json` beside the page names. */
  openServed(record: ClipRecord): void {
    if (this.facts === undefined) return;
    const load = async (frame: number): Promise<Blob> => {
      const response = await fetch(record.frames[frame] ?? "").catch(() => undefined);
      if (!response?.ok) throw new LostError(`Frame ${frame} of the clip cannot be loaded from where the page lies; start 'decomo-view' again.`);
      return response.blob();
    };
    this.setClip(new Clip(record.frames.length, this.facts, load, () => this.onPicture(), this.onError));
  }

  /** Shows image files as the clip, unless another was asked for meanwhile; `InputError` where they are not the model's. */
  async openFiles(files: readonly File[]): Promise<void> {
    if (this.facts === undefined) throw new InputError("Open a model before the frames of its clip.");
    const turn = ++this.opening;
    const clip = await Clip.fromFiles(files, this.facts, () => this.onPicture(), this.onError);
    if (turn !== this.opening) return clip.close();
    clip.check(this.facts); // another model may be open by now
    this.setClip(clip);
  }

  available(layer: Layer): boolean {
    return layer !== "clip" || this.hasClip;
  }

  /** True where there is something to show of a frame in each layer that is shown. */
  has(frame: number): boolean {
    return this.layers.every((layer) => this.source(layer)?.peek(frame) !== undefined);
  }

  /** The same; asks for it. */
  ask(frame: number): boolean {
    return this.layers.map((layer) => this.source(layer)?.get(frame)).every((picture) => picture !== undefined);
  }

  /** The frame, or while its pictures are still to come the nearest that has them: nothing is black where something is. */
  nearest(frame: number): number {
    const { numFrames } = this.facts ?? { numFrames: 0 };
    for (let apart = 0; apart < numFrames; apart++) {
      for (const near of [frame - apart, frame + apart]) if (this.has(near)) return near;
    }
    return frame;
  }

  /** What there is of a frame; the clip's own stands in for a layer of which nothing is rendered yet. */
  shown(frame: number): Shown {
    const picture = (layer: Layer): CanvasImageSource | undefined =>
      (layer === "clip" ? undefined : this.canvasOf(this.renderer?.peek(frame), layer)) ?? this.clip?.peek(frame);
    return this.sides(picture);
  }

  /** The same, waited for: what is shown now, whatever is chosen meanwhile. */
  finished(): (frame: number) => Promise<Shown> {
    const { layer, split, splitAt, layers, clip, renderer } = this;
    return async (frame) => {
      const raster = layers.every((each) => each === "clip") ? undefined : await renderer?.wait(frame);
      const own = layers.includes("clip") ? await clip?.wait(frame) : undefined; // last: it is closed when others need its room
      const picture = (each: Layer): CanvasImageSource | undefined => (each === "clip" ? own : this.canvasOf(raster, each));
      return { left: picture(layer), right: split && picture(split), split: splitAt };
    };
  }

  /** Where the model is unsure of a frame, as far as is known; asks for more. */
  heat(frame: number): OffscreenCanvas | undefined {
    const map = this.heatMaps?.get(frame);
    return map && this.facts && paintHeat(map, unit(this.facts));
  }

  cancelHeat(): void {
    this.heatMaps?.cancel();
  }

  private get layers(): Layer[] {
    return this.split === undefined ? [this.layer] : [this.layer, this.split];
  }

  private source(layer: Layer): Clip | LayerRenderer | undefined {
    return layer === "clip" ? this.clip : this.renderer;
  }

  private sides(picture: (layer: Layer) => CanvasImageSource | undefined): Shown {
    return { left: picture(this.layer), right: this.split && picture(this.split), split: this.splitAt };
  }

  private setClip(clip: Clip): void {
    this.clip?.close();
    this.clip = clip;
    this.layer = "clip";
  }

  private canvasOf(raster: Raster | undefined, layer: Rendered): OffscreenCanvas | undefined {
    const pixels = raster?.pixels[layer];
    if (pixels === undefined) return undefined;
    const had = this.rasterCanvases.get(pixels);
    if (had !== undefined) return had;
    const canvas = new OffscreenCanvas(pixels.width, pixels.height);
    canvas.getContext("2d")?.putImageData(pixels, 0, 0);
    this.rasterCanvases.set(pixels, canvas);
    for (const oldest of this.rasterCanvases.keys()) {
      if (this.rasterCanvases.size <= MOST_CANVASES) break;
      this.rasterCanvases.delete(oldest);
    }
    return canvas;
  }
}
