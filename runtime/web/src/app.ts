/** The page: one model, its clip, the points and what is shown of them. */

import { Clip, type ClipRecord } from "./clip";
import type { Scene } from "./draw";
import { type Place, gridCells, gridInside } from "./geometry";
import { LAYERS, type Layer, LayerRenderer, type Raster, type Rendered } from "./layers";
import { type Files, Model } from "./model/client";
import { InputError } from "./model/facts";
import type { Tracked } from "./model/protocol";
import { type Draft, type Point, PointList, splitTracks } from "./points";
import { PointRows } from "./ui/list";
import { Player } from "./ui/player";
import type { View } from "./ui/view";

const MOST_POINTS_AT_ONCE = 400;
/** Of a grid's box, most of which a lasso may leave out. */
const MOST_CELLS = 100 * MOST_POINTS_AT_ONCE;
const DEFAULT_TRAIL = 12;

export class App {
  readonly points = new PointList(() => this.onPoints());
  readonly player: Player;
  selected: number | undefined;
  layer: Layer = "fused";
  split: Layer | undefined;
  splitAt = 0.5;
  trail = DEFAULT_TRAIL;
  model: Model | undefined;
  clip: Clip | undefined;
  private renderer: LayerRenderer | undefined;
  private readonly rows: PointRows;
  private readonly rasterCanvases = new WeakMap<ImageData, OffscreenCanvas>();
  private redraw = 0;
  private opening = 0;
  /** Askings whose points are on the list while more of their tracks is to come. */
  private unfinished = 0;

  constructor(private readonly view: View) {
    this.player = new Player(
      () => this.show(),
      (frame) => this.isReady(frame),
    );
    this.rows = new PointRows(view.list, this.points, {
      onSelect: (id) => this.select(id),
      onSeek: (frame) => this.player.seek(frame),
    });
  }

  /**
   * Opens a model, or the `windows.json` of several; the former one and its points go, and the clip where it is not the
   * new model's.
   */
  async openModel(path: string, files: Files): Promise<void> {
    const turn = ++this.opening;
    this.view.loading(`Opening ${path} …`);
    try {
      const model = await Model.open(path, files);
      if (turn !== this.opening) {
        model.close();
        return;
      }
      this.model?.close();
      this.renderer?.close();
      this.model = model;
      this.renderer = new LayerRenderer(
        model.facts,
        (queries) => model.render(queries),
        (frame) => this.onPicture(frame),
        (error) => this.view.alert(error),
      );
      this.points.reset();
      this.selected = undefined;
      this.player.load(model.facts.numFrames, model.facts.fps);
      this.trail = Math.min(DEFAULT_TRAIL, model.facts.numFrames - 1);
      this.split = undefined;
      this.keepClip();
      this.layer = this.clip ? "clip" : "fused";
      this.view.opened(model, this.clip !== undefined);
      void model.tryWebgpu().then(() => {
        if (model === this.model) this.view.facts(model, this.clip !== undefined);
      });
    } finally {
      if (turn === this.opening) this.view.loading(undefined);
    }
    this.show();
  }

  /** Shows the clip that `site.json` beside the page names. */
  openServedClip(record: ClipRecord): void {
    const facts = this.model?.facts;
    if (facts === undefined) return;
    const load = async (frame: number): Promise<Blob> => (await fetch(record.frames[frame] ?? "")).blob();
    this.setClip(new Clip(record.frames.length, facts, load, () => this.show(), (error) => this.view.alert(error)));
  }

  /** Shows image files as the clip; `InputError` where they are not the model's. */
  async openFrames(files: readonly File[]): Promise<void> {
    const facts = this.model?.facts;
    if (facts === undefined) throw new InputError("Open a model before the frames of its clip.");
    this.setClip(await Clip.fromFiles(files, facts, () => this.show(), (error) => this.view.alert(error)));
  }

  /**
   * Asks the model for the tracks of `drafts` and puts the points on the list, as one step: as soon as the first window
   * has answered, and with more of their tracks as the others do.
   */
  async addPoints(drafts: readonly Draft[]): Promise<void> {
    const model = this.model;
    if (model === undefined || drafts.length === 0) return;
    const { numFrames, occlusionThreshold } = model.facts;
    const start = performance.now();
    const queries = Float32Array.from(drafts.flatMap(({ t, x, y }) => [t, x, y]));
    const what = drafts.length === 1 ? "the point" : `${drafts.length} points`;
    const onProgress = (share: number): void => {
      if (share < 1 && model === this.model) this.view.status(`Following ${what} … ${Math.round(100 * share)} %`);
    };
    let added: readonly Point[] = [];
    const onPart = ({ tracks, occlusion }: Tracked): void => {
      if (model !== this.model) return;
      const parts = splitTracks(tracks, occlusion, numFrames, occlusionThreshold);
      if (added.length > 0) return this.points.retrack(added, parts);
      this.unfinished++;
      added = this.points.add(drafts, parts);
      this.select(added[0]?.id);
    };
    let answer: Tracked;
    try {
      answer = await model.track(queries, onProgress, onPart);
    } catch (error) {
      if (model !== this.model) return;
      this.points.forget(added);
      throw error;
    } finally {
      if (added.length > 0) this.unfinished--;
      this.onPoints();
    }
    const [first] = added;
    if (first === undefined || model !== this.model) return;
    const milliseconds = performance.now() - start;
    const seen = answer.occlusion.filter((score) => score <= occlusionThreshold).length;
    const found =
      added.length === 1
        ? `${first.name} at (${first.x}, ${first.y}) of frame ${first.t}: in sight in ${seen} of ${numFrames} frames`
        : `${added.length} points in ${numFrames} frames`;
    this.view.answered(`${found}; answered in ${Math.round(milliseconds)} ms.`, milliseconds);
  }

  addAt(place: Place, t: number): Promise<void> {
    return this.addPoints([{ t, ...place }]);
  }

  /** A grid of points in `polygon` of frame t, `spacing` pixels apart. */
  async addArea(polygon: readonly Place[], t: number, spacing: number): Promise<void> {
    if (this.model === undefined) return;
    if (gridCells(polygon, spacing, this.model.facts) > MOST_CELLS) {
      throw new InputError(`That area holds far more than ${MOST_POINTS_AT_ONCE} points; raise the spacing.`);
    }
    const places = gridInside(polygon, spacing, this.model.facts);
    if (places.length === 0) throw new InputError("No point fits in so small an area; draw a larger one or lessen the spacing.");
    if (places.length > MOST_POINTS_AT_ONCE) {
      throw new InputError(`That area holds ${places.length} points, more than ${MOST_POINTS_AT_ONCE}; raise the spacing.`);
    }
    await this.addPoints(places.map((place) => ({ t, ...place })));
  }

  select(id: number | undefined): void {
    this.selected = id;
    this.onPoints();
    if (id !== undefined) this.rows.reveal(id);
  }

  removeSelected(): void {
    if (this.selected !== undefined) this.points.remove(this.selected);
  }

  /** Draws what is to be seen, at the next chance that the browser gives. */
  show(): void {
    cancelAnimationFrame(this.redraw);
    this.redraw = requestAnimationFrame(() => {
      if (this.model === undefined) return;
      const { frame } = this.player;
      this.view.stage.show(this.scene(frame, (layer) => this.picture(layer, frame)));
      this.view.showFrame(frame, this.model.facts.numFrames, this.player.playing);
      this.rows.showFrame(frame, this.model.facts.numFrames);
    });
  }

  /** The scenes of a video, their pictures waited for: what is shown now, whatever is clicked meanwhile. */
  finishedScenes(): (frame: number) => Promise<Scene> {
    const { layer, split, clip, renderer } = this;
    const now = { ...this.scene(0, () => undefined), selected: undefined };
    const picture = async (of: Layer | undefined, frame: number): Promise<CanvasImageSource | undefined> => {
      if (of === undefined) return undefined;
      return of === "clip" ? clip?.wait(frame) : this.canvasOf(await renderer?.wait(frame), of);
    };
    return async (frame) => ({ ...now, frame, left: await picture(layer, frame), right: await picture(split, frame) });
  }

  available(layer: Layer): boolean {
    return layer !== "clip" || this.clip !== undefined;
  }

  showLayer(layer: Layer | undefined): void {
    if (layer === undefined || !this.available(layer) || this.model === undefined) return;
    this.layer = layer;
    this.view.layers(LAYERS, this);
    this.show();
  }

  private keepClip(): void {
    const facts = this.model?.facts;
    if (this.clip === undefined || facts === undefined) return;
    try {
      this.clip.check(facts);
    } catch (error) {
      this.clip.close();
      this.clip = undefined;
      this.view.alert(error);
    }
  }

  private setClip(clip: Clip): void {
    this.clip?.close();
    this.clip = clip;
    this.layer = "clip";
    if (this.model) this.view.facts(this.model, true);
    this.view.layers(LAYERS, this);
    this.show();
  }

  private scene(frame: number, picture: (layer: Layer) => CanvasImageSource | undefined): Scene {
    if (this.model === undefined) throw new Error("no model is open");
    return {
      image: this.model.facts,
      frame,
      left: picture(this.layer),
      right: this.split && picture(this.split),
      split: this.splitAt,
      points: this.points.all,
      selected: this.selected,
      trail: this.trail,
    };
  }

  private picture(layer: Layer, frame: number): CanvasImageSource | undefined {
    return layer === "clip" ? this.clip?.get(frame) : this.canvasOf(this.renderer?.get(frame), layer);
  }

  private canvasOf(raster: Raster | undefined, layer: Rendered): OffscreenCanvas | undefined {
    const pixels = raster?.pixels[layer];
    if (pixels === undefined) return undefined;
    const had = this.rasterCanvases.get(pixels);
    if (had !== undefined) return had;
    const canvas = new OffscreenCanvas(pixels.width, pixels.height);
    canvas.getContext("2d")?.putImageData(pixels, 0, 0);
    this.rasterCanvases.set(pixels, canvas);
    return canvas;
  }

  /** True where playing need not wait for a frame. */
  private isReady(frame: number): boolean {
    return [this.layer, this.split].every((layer) => layer === undefined || this.picture(layer, frame) !== undefined);
  }

  private onPicture(frame: number): void {
    if (frame === this.player.frame) this.show();
  }

  private onPoints(): void {
    if (!this.points.all.some(({ id }) => id === this.selected)) this.selected = this.points.all.at(-1)?.id;
    this.rows.update(this.selected);
    this.view.points(this.points, this.unfinished > 0);
    this.show();
  }
}
