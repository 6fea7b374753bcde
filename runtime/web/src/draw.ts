/** Draws one frame: the picture, or two side by side, and the points on it. The page and the saved video share this. */

import type { Place, Size } from "./geometry";
import type { Painted } from "./painter";
import { errorColour } from "./sureness";
import { type Followed, type Track, isBent } from "./tracks";

export interface Scene {
  readonly image: Size;
  readonly frame: number;
  readonly left: CanvasImageSource | undefined;
  /** What is shown right of the split. */
  readonly right?: CanvasImageSource | undefined;
  /** Where the split is, as a fraction of the width. */
  readonly split: number;
  /** What is drawn over the picture, the last on top. */
  readonly drawings: readonly Painted[];
  readonly points: readonly Followed[];
  /** Tracks to compare with, drawn thin and below. */
  readonly ghosts: readonly Followed[];
  readonly selected: number | undefined;
  /** Frames of the past that a trail shows. */
  readonly trail: number;
  /** Where the model is unsure, over the picture. */
  readonly heat?: CanvasImageSource | undefined;
  /** Where tracks are coloured by their expected errors, the length of a unit in pixels of the clip. */
  readonly errorUnit?: number | undefined;
}

const TAU = 2 * Math.PI;
const HIDDEN_INK = 0.4;
const HEAT_INK = 0.55;
const RIM = "rgb(0 0 0 / 60%)";

/** Radius of a mark for a canvas with this longer side, both in canvas pixels. */
export const markRadius = (longer: number): number => Math.min(14, Math.max(4.5, longer / 120));

/** Fills the canvas, whose whole area is the image's. */
export function drawScene(context: CanvasRenderingContext2D | OffscreenCanvasRenderingContext2D, scene: Scene): void {
  const { width, height } = context.canvas;
  const [scaleX, scaleY] = [width / scene.image.width, height / scene.image.height];
  const on = (x: number, y: number): Place => ({ x: (x + 0.5) * scaleX, y: (y + 0.5) * scaleY });
  context.imageSmoothingEnabled = true;
  context.imageSmoothingQuality = "high";
  context.fillStyle = "#000";
  context.fillRect(0, 0, width, height);
  if (scene.left) drawPicture(context, scene.left);
  if (scene.right) drawRight(context, scene.right, scene.split);
  if (scene.heat) drawHeat(context, scene.heat);
  drawPainted(context, scene.drawings, scaleX, scaleY);
  const radius = markRadius(Math.max(width, height));
  for (const ghost of scene.ghosts) drawGhost(context, ghost, scene, on, radius);
  for (const point of scene.points) drawTrail(context, point, scene, on, radius);
  for (const point of scene.points) drawGiven(context, point, scene, on, radius);
  for (const hidden of [true, false]) {
    for (const point of scene.points) {
      if (point.track.occluded[scene.frame] === hidden) drawMark(context, point, scene, on, radius);
    }
  }
}

type Context = CanvasRenderingContext2D | OffscreenCanvasRenderingContext2D;

/** Layers on a canvas with so many pixels for each of the image's. */
export function drawPainted(context: Context, drawings: readonly Painted[], scaleX: number, scaleY: number): void {
  for (const { canvas, left, top, scale, alpha } of drawings) {
    context.globalAlpha = alpha;
    const [across, down] = [scaleX / scale, scaleY / scale];
    context.drawImage(canvas, left * across, top * down, canvas.width * across, canvas.height * down);
  }
  context.globalAlpha = 1;
}

/** Grey chequers, and the picture on them: they show where it is transparent. */
function drawPicture(context: Context, picture: CanvasImageSource): void {
  if (picture instanceof ImageBitmap && picture.width === 0) return; // it has left the memory; another will be shown
  const { width, height } = context.canvas;
  ground ??= chequers();
  context.fillStyle = context.createPattern(ground, "repeat") ?? "#999";
  context.fillRect(0, 0, width, height);
  context.drawImage(picture, 0, 0, width, height);
}

const CELL = 8;
let ground: OffscreenCanvas | undefined;

function chequers(): OffscreenCanvas {
  const tile = new OffscreenCanvas(2 * CELL, 2 * CELL);
  const context = tile.getContext("2d");
  if (context === null) return tile;
  context.fillStyle = "#999";
  context.fillRect(0, 0, 2 * CELL, 2 * CELL);
  context.fillStyle = "#ccc";
  context.fillRect(CELL, 0, CELL, CELL);
  context.fillRect(0, CELL, CELL, CELL);
  return tile;
}

function drawRight(context: Context, picture: CanvasImageSource, split: number): void {
  const { width, height } = context.canvas;
  const x = Math.round(split * width);
  context.save();
  context.beginPath();
  context.rect(x, 0, width - x, height);
  context.clip();
  drawPicture(context, picture);
  context.restore();
  context.fillStyle = "#fff";
  context.fillRect(x - 1, 0, 2, height);
}

function drawHeat(context: Context, heat: CanvasImageSource): void {
  const { width, height } = context.canvas;
  context.globalAlpha = HEAT_INK;
  context.drawImage(heat, 0, 0, width, height);
  context.globalAlpha = 1;
}

type ToCanvas = (x: number, y: number) => Place;

/** A line through the last frames, fading into the past, faint where the point is hidden, dashed where it is bent. */
function drawTrail(context: Context, point: Followed, scene: Scene, on: ToCanvas, radius: number): void {
  const { track } = point;
  context.lineWidth = Math.max(1.5, 0.5 * radius);
  context.lineCap = "round";
  const first = Math.max(0, scene.frame - scene.trail);
  let travelled = 0;
  for (let frame = first; frame < scene.frame; frame++) {
    const hidden = track.occluded[frame] === true || track.occluded[frame + 1] === true;
    context.globalAlpha = (1 - (scene.frame - 1 - frame) / Math.max(1, scene.trail)) * (hidden ? HIDDEN_INK : 0.9);
    context.strokeStyle = inkOf(point, frame + 1, scene);
    const bent = isBent(point, frame) || isBent(point, frame + 1);
    context.setLineDash(bent ? [1.2 * radius, 1.2 * radius] : []);
    context.lineCap = bent ? "butt" : "round";
    context.lineDashOffset = travelled; // dashes run on from step to step
    travelled += strokeStep(context, track, frame, on);
  }
  context.setLineDash([]);
  context.globalAlpha = 1;
}

/** Strokes the way to the next frame, and returns how long it is. */
function strokeStep(context: Context, { xy }: Track, frame: number, on: ToCanvas): number {
  const [a, b] = [placeOf(xy, frame, on), placeOf(xy, frame + 1, on)];
  context.beginPath();
  context.moveTo(a.x, a.y);
  context.lineTo(b.x, b.y);
  context.stroke();
  const length = Math.hypot(b.x - a.x, b.y - a.y);
  return Number.isFinite(length) ? length : 0; // of frames that are not answered yet
}

/** A thin white line and a small white ring. */
function drawGhost(context: Context, { track }: Followed, scene: Scene, on: ToCanvas, radius: number): void {
  const { x, y } = placeOf(track.xy, scene.frame, on);
  for (const [ink, width] of [["#000", 0.35], ["#fff", 0.2]] as const) {
    context.strokeStyle = ink;
    context.lineWidth = Math.max(1, width * radius);
    for (let frame = Math.max(0, scene.frame - scene.trail); frame < scene.frame; frame++) strokeStep(context, track, frame, on);
    context.beginPath();
    context.arc(x, y, 0.8 * radius, 0, TAU);
    context.stroke();
  }
}

/** Diamonds where the user has placed the point in the frames of the trail: white, the one of this frame larger. */
function drawGiven(context: Context, { given }: Followed, scene: Scene, on: ToCanvas, radius: number): void {
  for (const { t, place } of given) {
    if (place === null || t > scene.frame || t < scene.frame - scene.trail) continue;
    const { x, y } = on(place.x, place.y);
    drawDiamond(context, x, y, t === scene.frame ? 2.1 * radius : 0.9 * radius);
  }
}

/** The outline of a diamond, seen on any ground. */
export function drawDiamond(context: Context, x: number, y: number, size: number): void {
  const path = new Path2D();
  for (const [across, down] of [[0, -size], [size, 0], [0, size], [-size, 0]] as const) path.lineTo(x + across, y + down);
  path.closePath();
  for (const [ink, width] of [["#000", 4], ["#fff", 2]] as const) {
    context.strokeStyle = ink;
    context.lineWidth = width;
    context.stroke(path);
  }
}

/** A disc where the point is in sight, a ring where it is hidden. */
function drawMark(context: Context, point: Followed, scene: Scene, on: ToCanvas, radius: number): void {
  const { id, track } = point;
  const colour = inkOf(point, scene.frame, scene);
  const { x, y } = placeOf(track.xy, scene.frame, on);
  const hidden = track.occluded[scene.frame] === true;
  const circle = (size: number): void => {
    context.beginPath();
    context.arc(x, y, size, 0, TAU);
  };
  if (scene.selected === id) {
    circle(radius + 4);
    context.strokeStyle = "#fff";
    context.lineWidth = 2;
    context.stroke();
  }
  if (hidden) {
    for (const [ink, width] of [[RIM, 0.9], [colour, 0.45]] as const) {
      circle(1.15 * radius);
      context.strokeStyle = ink;
      context.lineWidth = radius * width;
      context.stroke();
    }
  } else {
    circle(radius + Math.max(1, 0.25 * radius));
    context.fillStyle = RIM;
    context.fill();
    circle(radius);
    context.fillStyle = colour;
    context.fill();
  }
}

/** The colour of a track in a frame: its own, or its error's. */
const inkOf = ({ colour, track }: Followed, frame: number, { errorUnit }: Scene): string =>
  errorUnit === undefined ? colour : errorColour(track.error[frame] ?? 0, errorUnit);

function placeOf(xy: Float32Array, frame: number, on: ToCanvas): Place {
  return on(xy[2 * frame] ?? 0, xy[2 * frame + 1] ?? 0);
}
