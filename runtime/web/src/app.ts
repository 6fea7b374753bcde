/** The page: one model, the points and drawings of the user, and what is shown of them. */

import type { ClipRecord } from "./clip";
import { Comparison, type Side } from "./comparison";
import { type Draft, Document, type Point, withoutPoint } from "./document";
import type { Scene } from "./draw";
import type { Drawing } from "./drawings";
import { Following } from "./following";
import type { Place } from "./geometry";
import { LAYERS, type Layer } from "./layers";
import { type Files, Model } from "./model/client";
import { unit } from "./model/errors";
import { Pictures } from "./pictures";
import { Sketch } from "./sketch";
import { inPixels, leastSure, neighbour } from "./sureness";
import { Answers, type Followed } from "./tracks";
import { CorrectionRows } from "./ui/corrections";
import { DrawingRows } from "./ui/drawings";
import { PointRows } from "./ui/list";
import { Player } from "./ui/player";
import type { View } from "./ui/view";

const DEFAULT_TRAIL = 12;

export class App {
  readonly document = new Document(() => this.onDocument());
  /** The points of the document, with the tracks that the open model gives them. */
  followed: readonly Followed[] = [];
  readonly player: Player;
  readonly pictures = new Pictures(
    (frame) => (frame === undefined ? this.show() : this.onPicture(frame)),
    (error) => this.view.alert(error),
  );
  /** What is drawn over the picture. */
  readonly sketch = new Sketch(
    this.document,
    (frame) => (frame === undefined ? this.show() : this.onPicture(frame)),
    (error) => this.view.alert(error),
  );
  readonly comparison = new Comparison(this.document, () => this.onDocument());
  selected: number | undefined;
  trail = DEFAULT_TRAIL;
  /** Whether tracks have the colours of their expected errors, and whether these are shown over the picture. */
  byError = false;
  heatShown = false;
  /** Where the open model is from. */
  files: Files | undefined;
  /** Hears when the document, or a model's answers, have changed. */
  onContent: () => void = () => {};
  private path = "";
  private readonly following = new Following(this.document, {
    onAnswers: () => this.onDocument(),
    onAdded: (id) => this.select(id),
    onProgress: (text) => this.view.status(text),
  });
  private readonly rows: PointRows;
  private readonly correctionRows: CorrectionRows;
  private readonly drawingRows: DrawingRows;
  private redraw = 0;
  private opening = 0;

  constructor(private readonly view: View) {
    this.player = new Player(
      () => this.show(),
      (frame) => this.isReady(frame),
    );
    const events = { onSelect: (id: number) => this.select(id), onSeek: (frame: number) => this.player.seek(frame) };
    this.rows = new PointRows(view.list, this.document, events);
    this.correctionRows = new CorrectionRows(view.corrections, this.document, events);
    const seek = (frame: number): void => this.player.seek(frame);
    this.drawingRows = new DrawingRows(view.drawings, this.document, this.sketch, seek, () => view.drawOn(this));
  }

  get model(): Model | undefined {
    return this.following.model;
  }

  /**
   * Opens a model, or the `windows.json` of several; the former one and its points go, and the clip where it is not the
   * new model's. False where they stay: another model was asked for meanwhile, or they may not go when it comes to it.
   */
  async openModel(path: string, files: Files, mayGo: () => boolean = () => true): Promise<boolean> {
    const turn = ++this.opening;
    this.view.loading(`Opening ${path} …`);
    try {
      const model = await Model.open(path, files);
      if (turn !== this.opening || !mayGo()) {
        model.close();
        return false;
      }
      this.comparison.drop();
      this.files = files;
      this.use(model, path, new Answers());
      this.document.reset();
      this.selected = this.sketch.selected = undefined;
      this.player.load(model.facts);
      this.trail = Math.min(DEFAULT_TRAIL, model.facts.numFrames - 1);
      this.pictures.begin();
      this.view.opened(model, this.pictures.hasClip);
    } finally {
      if (turn === this.opening) this.view.loading(undefined);
    }
    this.show();
    return true;
  }

  /** Opens a refitted model of the same clip beside the one that is open. */
  async openCandidate(path: string, files: Files): Promise<void> {
    if (path !== this.path) await this.comparison.open(path, files, () => this.model);
  }

  /** Goes on with the refitted model in place of the old one; the document stays. */
  async takeCandidate(): Promise<void> {
    const candidate = await this.comparison.take();
    if (candidate === undefined) return;
    this.use(candidate.model, candidate.path, candidate.answers);
    this.view.facts(candidate.model, this.pictures.hasClip);
    this.onDocument();
  }

  showSide(side: Side): void {
    this.comparison.side = side;
    this.show();
  }

  /** Shows the clip that `site.json` beside the page names. */
  openServedClip(record: ClipRecord): void {
    this.pictures.openServed(record);
    this.onClip();
  }

  /** Shows image files as the clip; `InputError` where they are not the model's. */
  async openFrames(files: readonly File[]): Promise<void> {
    await this.pictures.openFiles(files);
    this.onClip();
  }

  /** Puts on top what a file holds of points and drawings, as one step: the points as soon as the model follows them. */
  async addContent(drafts: readonly Draft[], drawings: readonly Omit<Drawing, "id">[]): Promise<void> {
    const layers = (): Drawing[] => this.sketch.layersOf(drawings);
    if (drafts.length > 0) await this.addPoints(drafts, layers);
    else this.document.add([], layers());
  }

  /** Asks the model for the tracks of `drafts` and puts the points on the list, with `layers` if there are, as one step. */
  async addPoints(drafts: readonly Draft[], layers?: () => readonly Drawing[]): Promise<void> {
    const added = await this.following.add(drafts, layers);
    await this.comparison.complete();
    if (added) this.view.answered(`${added.found}; answered in ${Math.round(added.milliseconds)} ms.`, added.milliseconds);
  }

  addAt(place: Place, t: number): Promise<void> {
    return this.addPoints([{ t, ...place }]);
  }

  /** Whether points are asked for that are not there yet. */
  get isAsking(): boolean {
    return this.following.isAsking;
  }

  /** Waits for them. */
  settled(): Promise<void> {
    return this.following.settled();
  }

  /** A grid of points in `polygon` of frame t, `spacing` pixels apart. */
  async addArea(polygon: readonly Place[], t: number, spacing: number): Promise<void> {
    await this.addPoints(this.following.grid(polygon, t, spacing));
  }

  /** Says that a point is at `place` in frame t; in the frame in which it was placed, it is placed there instead. */
  async correct(id: number, place: Place, t: number): Promise<void> {
    const point = this.pointOf(id);
    if (point === undefined) return;
    this.select(id);
    if (!(await this.following.correct(point, place, t))) return;
    this.view.status(`${point.name} is at (${place.x}, ${place.y}) in frame ${t}.`);
    await this.comparison.complete();
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

  /** Says that the selected point is hidden, or in sight where it is shown, in the frame that is seen, which stays. */
  mark(hidden: boolean): void {
    const point = this.followed.find(({ id }) => id === this.selected);
    if (point === undefined) return;
    this.pauseAt(this.pictures.nearest(this.player.frame)); // it may stand in for another
    this.following.mark(point, this.player.frame, hidden);
    this.view.status(`${point.name} is ${hidden ? "hidden" : "in sight"} in frame ${this.player.frame}.`);
  }

  /** Marks the selected point as what it is not shown as. */
  markOther(): void {
    const point = this.followed.find(({ id }) => id === this.selected);
    if (point !== undefined) this.mark(point.track.occluded[this.pictures.nearest(this.player.frame)] !== true);
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
      const shown = this.pictures.nearest(frame);
      const heat = this.heatShown ? this.pictures.heat(shown) : undefined;
      this.view.stage.show({ ...this.scene(shown), ...this.pictures.shown(shown), drawings: this.sketch.shown(shown), heat });
      this.view.showFrame(this, this.model.facts.numFrames, shown);
      this.rows.showFrame(frame, this.model.facts.numFrames);
    });
  }

  /** The scenes of a video, their pictures waited for: what is shown now, whatever is clicked meanwhile. */
  finishedScenes(): (frame: number) => Promise<Scene> {
    const [drawings, pictures] = [this.sketch.finished(), this.pictures.finished()];
    const now = { ...this.scene(0), selected: undefined };
    return async (frame) => {
      const painted = await drawings(frame);
      return { ...now, ...(await pictures(frame)), frame, drawings: painted };
    };
  }

  showLayer(layer: Layer | undefined): void {
    if (layer === undefined || !this.pictures.available(layer) || this.model === undefined) return;
    this.pictures.layer = layer;
    this.view.layers(LAYERS, this.pictures);
    this.show();
  }

  /** Shows a layer right of the split; undefined: none. */
  showSplit(layer: Layer | undefined): void {
    this.pictures.split = layer;
    this.view.layers(LAYERS, this.pictures);
    this.show();
  }

  colourByError(on: boolean): void {
    this.byError = on;
    this.onDocument();
  }

  showHeat(on: boolean): void {
    this.heatShown = on;
    if (!on) this.pictures.cancelHeat();
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

  private use(model: Model, path: string, answers: Answers): void {
    this.model?.close();
    this.path = path;
    this.following.use(model, answers);
    this.pictures.use(model);
    this.sketch.use(model);
    void model.tryWebgpu().then(() => {
      if (model === this.model) this.view.facts(model, this.pictures.hasClip);
    });
  }

  /** Another clip is there. */
  private onClip(): void {
    if (this.model) this.view.facts(this.model, this.pictures.hasClip);
    this.view.layers(LAYERS, this.pictures);
    this.show();
  }

  /** A frame's points, without its pictures. */
  private scene(frame: number): Scene {
    const { model } = this;
    if (model === undefined) throw new Error("no model is open");
    return {
      image: model.facts,
      frame,
      left: undefined,
      split: this.pictures.splitAt,
      drawings: [],
      ...this.comparison.shown(this.followed),
      selected: this.selected,
      trail: this.trail,
      errorUnit: this.errorUnit,
    };
  }

  /** The length of a unit in pixels of the clip, where tracks are coloured by their errors. */
  private get errorUnit(): number | undefined {
    return this.byError && this.model ? unit(this.model.facts) : undefined;
  }

  /** True where playing need not wait for a frame; asks for its pictures. */
  private isReady(frame: number): boolean {
    return this.pictures.ask(frame) && this.sketch.isReady(frame);
  }

  private onPicture(frame: number): void {
    if (frame === this.player.frame || !this.pictures.has(this.player.frame)) this.show();
  }

  private pointOf(id: number): Point | undefined {
    return this.document.points.find((point) => point.id === id);
  }

  private onDocument(): void {
    if (!this.document.points.some(({ id }) => id === this.selected)) this.selected = this.document.points.at(-1)?.id;
    this.followed = this.following.followed();
    this.rows.update(this.followed, this.selected, this.errorUnit);
    this.drawingRows.update();
    this.correctionRows.update();
    this.view.content(this, this.following.isUnfinished);
    this.onContent();
    this.show();
  }
}
