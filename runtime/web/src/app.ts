/** The page: one model, its clip, the points and what is shown of them. */

import { Clip, type ClipRecord } from "./clip";
import { type Draft, Document, type Point, changed, corrected, withoutPoint } from "./document";
import type { Scene } from "./draw";
import { type Place, clampPlace, gridCells, gridInside, roundPlace } from "./geometry";
import { HeatMaps, paintHeat } from "./heat";
import { LAYERS, type Layer, LayerRenderer, type Raster, type Rendered } from "./layers";
import { type Files, Model } from "./model/client";
import { unit } from "./model/errors";
import { InputError } from "./model/facts";
import type { Tracked } from "./model/protocol";
import { Sketch } from "./sketch";
import { inPixels, leastSure, neighbour } from "./sureness";
import { Answers, type Followed, splitTracks } from "./tracks";
import { CorrectionRows } from "./ui/corrections";
import { DrawingRows } from "./ui/drawings";
import { PointRows } from "./ui/list";
import { Player } from "./ui/player";
import type { View } from "./ui/view";

const MOST_POINTS_AT_ONCE = 400;
/** Of a grid's box, most of which a lasso may leave out. */
const MOST_CELLS = 100 * MOST_POINTS_AT_ONCE;
const DEFAULT_TRAIL = 12;
const MOST_CANVASES = 8;

/** What is shown while a refitted model waits for a verdict. */
export const SIDES = ["old", "both", "new"] as const;
export type Side = (typeof SIDES)[number];

/** A refitted model beside the one that is open. */
interface Candidate {
  readonly path: string;
  readonly model: Model;
  readonly answers: Answers;
}

export class App {
  readonly document = new Document(() => this.onDocument());
  /** The points of the document, with the tracks that the open model gives them. */
  followed: readonly Followed[] = [];
  readonly player: Player;
  /** What is drawn over the picture. */
  readonly sketch = new Sketch(
    this.document,
    (frame) => (frame === undefined ? this.show() : this.onPicture(frame)),
    (error) => this.view.alert(error),
  );
  selected: number | undefined;
  layer: Layer = "fused";
  split: Layer | undefined;
  splitAt = 0.5;
  trail = DEFAULT_TRAIL;
  /** Whether tracks have the colours of their expected errors, and whether these are shown over the picture. */
  byError = false;
  heatShown = false;
  model: Model | undefined;
  clip: Clip | undefined;
  candidate: Candidate | undefined;
  side: Side = "both";
  /** Hears when the document, or a model's answers, have changed. */
  onContent: () => void = () => {};
  private answers = new Answers();
  /** Where the open model is from. */
  files: Files | undefined;
  private path = "";
  private renderer: LayerRenderer | undefined;
  private heatMaps: HeatMaps | undefined;
  private readonly rows: PointRows;
  private readonly correctionRows: CorrectionRows;
  private readonly drawingRows: DrawingRows;
  /** The last canvases that were painted with parts of rasters. */
  private readonly rasterCanvases = new Map<ImageData, OffscreenCanvas>();
  private redraw = 0;
  private opening = 0;
  /** Askings whose points are on the list while more of their tracks is to come. */
  private unfinished = 0;

  constructor(private readonly view: View) {
    this.player = new Player(
      () => this.show(),
      (frame) => this.isReady(frame),
    );
    const events = { onSelect: (id: number) => this.select(id), onSeek: (frame: number) => this.player.seek(frame) };
    this.rows = new PointRows(view.list, this.document, events);
    this.correctionRows = new CorrectionRows(view.corrections, this.document, events);
    this.drawingRows = new DrawingRows(view.drawings, this.document, this.sketch, (frame) => this.player.seek(frame));
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
      this.dropCandidate();
      this.files = files;
      this.use(model, path, new Answers());
      this.document.reset();
      this.selected = undefined;
      this.player.load(model.facts);
      this.trail = Math.min(DEFAULT_TRAIL, model.facts.numFrames - 1);
      this.split = undefined;
      this.keepClip();
      this.layer = this.clip ? "clip" : "fused";
      this.view.opened(model, this.clip !== undefined);
    } finally {
      if (turn === this.opening) this.view.loading(undefined);
    }
    this.show();
  }

  /** Opens a refitted model of the same clip beside the one that is open, and asks it for all points. */
  async openCandidate(path: string, files: Files): Promise<void> {
    if (path === this.path || path === this.candidate?.path) return;
    const [model, beside] = [await Model.open(path, files), this.model];
    if (beside === undefined || !sameClip(model, beside)) {
      model.close();
      throw new InputError(`${path} is not a model of the clip that is open; start 'decomo-view' again.`);
    }
    this.dropCandidate();
    this.candidate = { path, model, answers: new Answers() };
    this.onDocument();
    await this.completeCandidate();
  }

  /** Goes on with the refitted model in place of the old one; the document stays. */
  async takeCandidate(): Promise<void> {
    await this.completeCandidate();
    const candidate = this.candidate;
    if (candidate === undefined) return;
    this.candidate = undefined;
    this.use(candidate.model, candidate.path, candidate.answers);
    this.view.facts(candidate.model, this.clip !== undefined);
    this.onDocument();
  }

  dropCandidate(): void {
    this.candidate?.model.close();
    this.candidate = undefined;
    this.onDocument();
  }

  showSide(side: Side): void {
    this.side = side;
    this.show();
  }

  /** The points of the document with the tracks that the refitted model gives them. */
  refollowed(): readonly Followed[] {
    return this.candidate?.answers.follow(this.document.content) ?? [];
  }

  private use(model: Model, path: string, answers: Answers): void {
    this.model?.close();
    this.renderer?.close();
    this.heatMaps?.cancel();
    Object.assign(this, { model, path, answers });
    this.renderer = new LayerRenderer(
      model.facts,
      (queries) => model.render(queries),
      (frame) => this.onPicture(frame),
      (error) => this.view.alert(error),
    );
    this.sketch.use(model);
    this.heatMaps = new HeatMaps(
      model.facts,
      (queries, frames) => model.glance(queries, frames),
      (frame) => this.onPicture(frame),
      (error) => this.view.alert(error),
    );
    void model.tryWebgpu().then(() => {
      if (model === this.model) this.view.facts(model, this.clip !== undefined);
    });
  }

  /** Asks the refitted model for what it has not answered yet, of points that undo and redo can bring too. */
  private async completeCandidate(): Promise<void> {
    const { candidate } = this;
    if (candidate === undefined) return;
    const missing = this.document.everyPoint().filter((point) => candidate.answers.get(point) === undefined);
    if (missing.length === 0) return;
    const answer = await candidate.model.track(queriesOf(missing));
    candidate.answers.set(missing, splitTracks(answer, missing, candidate.model.facts));
    this.onDocument();
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
    const what = drafts.length === 1 ? "the point" : `${drafts.length} points`;
    const onProgress = (share: number): void => {
      if (share < 1 && model === this.model) this.view.status(`Following ${what} … ${Math.round(100 * share)} %`);
    };
    let begun = false;
    let added: readonly Point[] = [];
    const onPart = (part: Tracked): void => {
      if (model !== this.model) return;
      this.answers.set(drafts, splitTracks(part, drafts, model.facts));
      if (begun) return this.onDocument();
      begun = true;
      this.unfinished++;
      added = this.document.add(drafts);
      this.select(added[0]?.id ?? this.selected);
    };
    let answer: Tracked;
    try {
      answer = await model.track(queriesOf(drafts), onProgress, onPart);
    } catch (error) {
      if (model !== this.model) return;
      this.document.forget(added);
      throw error;
    } finally {
      if (begun) this.unfinished--;
      this.onDocument();
    }
    await this.completeCandidate();
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

  /** Says that a point is at `place` in frame t; in the frame in which it was placed, it is placed there instead. */
  async correct(id: number, place: Place, t: number): Promise<void> {
    const point = this.pointOf(id);
    if (point === undefined) return;
    this.select(id);
    if (t === point.t) return this.move(point, place);
    this.document.change((content) => corrected(content, { point: id, t, place }));
  }

  /** A point is taken hold of: the picture stands still. */
  hold(id: number): void {
    this.player.step(0);
    this.select(id);
  }

  /** The picture stands still at frame t. */
  pauseAt(t: number): void {
    this.player.step(t - this.player.frame);
  }

  /** Says that the selected point is hidden in the frame shown, or in sight where it is shown. */
  mark(hidden: boolean): void {
    const { frame } = this.player;
    const point = this.followed.find(({ id }) => id === this.selected);
    if (point === undefined || this.model === undefined) return;
    if (point.t === frame) throw new InputError(`${point.name} was placed in frame ${frame}: it is in sight there. Mark it in another frame.`);
    const { xy } = point.track;
    const shown = roundPlace(clampPlace({ x: xy[2 * frame] ?? 0, y: xy[2 * frame + 1] ?? 0 }, this.model.facts));
    this.document.change((content) => corrected(content, { point: point.id, t: frame, place: hidden ? null : shown }));
  }

  /** Marks the selected point as what it is not shown as. */
  markOther(): void {
    const point = this.followed.find(({ id }) => id === this.selected);
    if (point !== undefined) this.mark(point.track.occluded[this.player.frame] !== true);
  }

  select(id: number | undefined): void {
    this.selected = id;
    this.onDocument();
    if (id !== undefined) this.rows.reveal(id);
  }

  removeSelected(): void {
    const id = this.selected;
    if (id !== undefined) this.document.change((content) => withoutPoint(content, id));
  }

  /** Draws what is to be seen, at the next chance that the browser gives. */
  show(): void {
    cancelAnimationFrame(this.redraw);
    this.redraw = requestAnimationFrame(() => {
      if (this.model === undefined) return;
      const { frame } = this.player;
      this.isReady(frame); // asks for its pictures
      const shown = this.frameToShow(frame);
      const heat = this.heatShown ? this.heatOf(shown) : undefined;
      this.view.stage.show({ ...this.scene(shown, (layer) => this.pictureHad(layer, shown)), heat });
      this.view.showFrame(this, this.model.facts.numFrames, shown);
      this.rows.showFrame(frame, this.model.facts.numFrames);
    });
  }

  /** The scenes of a video, their pictures waited for: what is shown now, whatever is clicked meanwhile. */
  finishedScenes(): (frame: number) => Promise<Scene> {
    const { layer, split, clip, renderer } = this;
    const drawings = this.sketch.finished();
    const now = { ...this.scene(0, () => undefined), selected: undefined };
    const layers = this.layersShown;
    return async (frame) => {
      const painted = await drawings(frame);
      const raster = layers.every((of) => of === "clip") ? undefined : await renderer?.wait(frame);
      const own = layers.includes("clip") ? await clip?.wait(frame) : undefined; // last: it is closed when others need its room
      const picture = (of: Layer): CanvasImageSource | undefined => (of === "clip" ? own : this.canvasOf(raster, of));
      return { ...now, frame, left: picture(layer), right: split && picture(split), drawings: painted };
    };
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

  colourByError(on: boolean): void {
    this.byError = on;
    this.onDocument();
  }

  showHeat(on: boolean): void {
    this.heatShown = on;
    if (!on) this.heatMaps?.cancel();
    this.onDocument();
  }

  /** Goes to the next or the former moment at which the model is least sure of a point. */
  jump(step: 1 | -1): void {
    const moment = neighbour(leastSure(this.followed), this.player.frame, this.selected, step);
    if (moment === undefined) return;
    this.pauseAt(moment.frame);
    this.select(moment.id);
    this.view.status(`${this.pointOf(moment.id)?.name ?? ""} in frame ${moment.frame}: expected within ${inPixels(moment.error)} px.`);
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
      drawings: this.sketch.shown(frame),
      ...this.pointsShown(),
      selected: this.selected,
      trail: this.trail,
      errorUnit: this.errorUnit,
    };
  }

  /** The length of a unit in pixels of the clip, where tracks are coloured by their errors. */
  private get errorUnit(): number | undefined {
    return this.byError && this.model ? unit(this.model.facts) : undefined;
  }

  private heatOf(frame: number): OffscreenCanvas | undefined {
    const map = this.heatMaps?.get(frame);
    return map && this.model && paintHeat(map, unit(this.model.facts));
  }

  /** The clip's stands in for a layer of which nothing is rendered yet. */
  private pictureHad(layer: Layer, frame: number): CanvasImageSource | undefined {
    return (layer === "clip" ? undefined : this.canvasOf(this.renderer?.peek(frame), layer)) ?? this.clip?.peek(frame);
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

  /** The frame, or while its pictures are still to come the nearest that has them: nothing is black where something is. */
  private frameToShow(frame: number): number {
    const { numFrames } = this.model?.facts ?? { numFrames: 0 };
    for (let apart = 0; apart < numFrames; apart++) {
      for (const near of [frame - apart, frame + apart]) if (this.layersShown.every((layer) => this.has(layer, near))) return near;
    }
    return frame;
  }

  private get layersShown(): Layer[] {
    return this.split === undefined ? [this.layer] : [this.layer, this.split];
  }

  private has(layer: Layer, frame: number): boolean {
    return (layer === "clip" ? this.clip : this.renderer)?.peek(frame) !== undefined;
  }

  /** True where playing need not wait for a frame; asks for its pictures. */
  private isReady(frame: number): boolean {
    const pictures = this.layersShown.map((layer) => (layer === "clip" ? this.clip : this.renderer)?.get(frame));
    return pictures.every((picture) => picture !== undefined) && this.sketch.isReady(frame);
  }

  private onPicture(frame: number): void {
    if (frame === this.player.frame || !this.layersShown.every((layer) => this.has(layer, this.player.frame))) this.show();
  }

  /** While a refitted model waits: what the models answer, the track that is compared with as a ghost. */
  private pointsShown(): Pick<Scene, "points" | "ghosts"> {
    if (this.candidate === undefined) return { points: this.followed, ghosts: [] };
    const plain = (all: readonly Followed[]): readonly Followed[] => all.map((each) => ({ ...each, track: each.answer }));
    if (this.side === "old") return { points: plain(this.followed), ghosts: [] };
    return { points: plain(this.refollowed()), ghosts: this.side === "both" ? plain(this.followed) : [] };
  }

  private pointOf(id: number): Point | undefined {
    return this.document.points.find((point) => point.id === id);
  }

  /** Places a point elsewhere in its own frame, and follows it from there. */
  private async move({ id, t }: Point, place: Place): Promise<void> {
    const model = this.model;
    if (model === undefined) return;
    const query = { t, ...place };
    if (this.answers.get(query) === undefined) {
      const answer = await model.track(queriesOf([query]));
      if (model !== this.model) return;
      this.answers.set([query], splitTracks(answer, [query], model.facts));
    }
    this.document.change((content) => changed(content, id, place));
    await this.completeCandidate();
  }

  private onDocument(): void {
    if (!this.document.points.some(({ id }) => id === this.selected)) this.selected = this.document.points.at(-1)?.id;
    this.followed = this.answers.follow(this.document.content);
    this.rows.update(this.followed, this.selected, this.errorUnit);
    this.drawingRows.update();
    this.correctionRows.update();
    this.view.content(this, this.unfinished > 0);
    this.onContent();
    this.show();
  }
}

const queriesOf = (queries: readonly Draft[]): Float32Array => Float32Array.from(queries.flatMap(({ t, x, y }) => [t, x, y]));

const sameClip = ({ facts: a }: Model, { facts: b }: Model): boolean =>
  a.numFrames === b.numFrames && a.width === b.width && a.height === b.height;
