/** Files in and out: opened by the button or dropped on the page, saved by the buttons. */

import type { App } from "../app";
import { contentOf } from "../files/content";
import { drawingsZip, masksZip, over, readDrawings } from "../files/drawings";
import { readPoints } from "../files/read";
import { correctionsCsv, pointsCsv, projectJson, tracksCsv, tracksNpz } from "../files/write";
import { drawScene } from "../draw";
import type { Files } from "../model/client";
import { InputError } from "../model/facts";
import { WINDOWS_FILE } from "../model/windows";
import type { Draw, encodeVideo } from "../video";
import { busy, download, element } from "./dom";
import type { View } from "./view";

/** Frames, as `decomo-train` takes them of a folder: macOS adds ._name.jpg to copies. */
const FRAME = /^[^.].*\.(jpe?g|png)$/is;
const MODEL = /\.onnx$/i;
const VIDEOS = /\.(mp4|mov|mkv|webm|avi|m4v)$/i;

const UNSAVED = "Your points, corrections and drawings go with the model that is open. Open another one all the same? (Project, under Save, keeps them.)";

export function listenToFiles(app: App, view: View): void {
  const input = element("files", HTMLInputElement);
  element("open", HTMLButtonElement).addEventListener("click", () => input.click());
  input.addEventListener("change", () => {
    view.attempt(openFiles([...(input.files ?? [])], app, view));
    input.value = "";
  });
  document.addEventListener("dragover", (event) => {
    event.preventDefault();
    document.body.classList.add("dropping");
  });
  for (const end of ["dragleave", "drop"]) document.addEventListener(end, () => document.body.classList.remove("dropping"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    const entries = [...(event.dataTransfer?.items ?? [])].map((item) => item.webkitGetAsEntry());
    view.attempt(filesOf(entries).then((files) => openFiles(files, app, view)));
  });
  window.addEventListener("beforeunload", (event) => {
    if (app.document.isUnsaved) event.preventDefault(); // the browser asks
  });
  for (const button of document.querySelectorAll<HTMLButtonElement>("[data-save]")) {
    button.addEventListener("click", () => view.attempt(save(button, app, view)));
  }
}

/** The files among what was dropped, and of its folders the models with their `windows.json`, or else the images. */
async function filesOf(entries: readonly (FileSystemEntry | null)[]): Promise<File[]> {
  const files = entries.map(async (entry) => {
    if (entry === null) return [];
    if (!entry.isDirectory) return [await fileOf(entry)];
    const inside = (await entriesIn(entry)).filter(({ isFile }) => isFile);
    const ofModel = inside.some(({ name }) => name === WINDOWS_FILE);
    const wanted = inside.filter(({ name }) => (ofModel ? name === WINDOWS_FILE || MODEL.test(name) : FRAME.test(name)));
    if (wanted.length === 0) {
      throw new InputError(`${entry.name} holds no images and no ${WINDOWS_FILE}; drop the folder with the frames of the clip, or that of its model.`);
    }
    return Promise.all(wanted.map(fileOf));
  });
  return (await Promise.all(files)).flat();
}

const fileOf = (entry: FileSystemEntry): Promise<File> =>
  new Promise((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, () => reject(gone(entry))));

const gone = ({ name }: FileSystemEntry): InputError => new InputError(`${name} cannot be read, or is gone; drop it again.`);

async function entriesIn(folder: FileSystemEntry): Promise<FileSystemEntry[]> {
  const reader = (folder as FileSystemDirectoryEntry).createReader();
  const found: FileSystemEntry[] = [];
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, () => reject(gone(folder))));
    if (some.length === 0) return found;
    found.push(...some);
  }
}

/** A model first, so that frames or points opened with it meet it. */
async function openFiles(files: readonly File[], app: App, view: View): Promise<void> {
  view.dismiss();
  const images = files.filter(({ name }) => FRAME.test(name));
  const models = files.filter(({ name }) => MODEL.test(name));
  const windows = files.find(({ name }) => name === WINDOWS_FILE);
  const others = files.filter((file) => file !== windows && !models.includes(file) && !images.includes(file));
  if (windows === undefined && models.length > 1) {
    throw new InputError(`These are ${models.length} models without their ${WINDOWS_FILE}; give one, or a whole model folder.`);
  }
  const model = windows ?? models[0];
  const { content } = app.document;
  if (model && app.document.isUnsaved && !confirm(UNSAVED)) return;
  const mayGo = (): boolean => app.document.content === content || !app.document.isUnsaved || confirm(UNSAVED); // what was done since
  if (model && !(await app.openModel(model.name, named([model, ...models]), mayGo))) return;
  const [image] = images;
  if (image && images.length === 1 && (app.model?.facts.numFrames ?? 1) > 1) {
    throw new InputError(`${image.name} is one image, and a clip is all its frames; open them at once, or a mask with 'Load mask…'.`);
  }
  if (image) await app.openFrames(images);
  for (const file of others) {
    if (VIDEOS.test(file.name)) {
      throw new InputError(`${file.name} is a video; give its frames as images, or start 'decomo-view' with --clip ${file.name}.`);
    }
    const facts = app.model?.facts;
    if (facts === undefined) throw new InputError(`Open a model before ${file.name}.`);
    const coming = app.document.expect();
    try {
      const bytes = await contentOf(file, file.name);
      if (!app.document.isExpected(coming)) return;
      const points = readPoints(file.name, bytes, facts);
      const drawings = /\.json$/i.test(file.name) ? readDrawings(file.name, bytes, facts) : [];
      if (points.length + drawings.length === 0) throw new InputError(`${file.name} holds no points, and nothing that is drawn.`);
      app.document.arrive(coming);
      await app.addContent(points, drawings);
    } finally {
      app.document.giveUp(coming);
    }
  }
}

/** Files by their names. */
function named(files: readonly File[]): Files {
  const byName = new Map(files.map((file) => [file.name, file]));
  return {
    has: (path) => byName.has(path),
    read: async (path) => {
      const file = byName.get(path);
      if (file === undefined) throw new InputError(`${path} is not among the files that were opened; open it again.`);
      return (await contentOf(file, path)).buffer;
    },
  };
}

async function save(button: HTMLButtonElement, app: App, view: View): Promise<void> {
  if (app.isAsking) {
    await app.settled(); // what was asked for before is saved too
    if (button.matches(":disabled")) return;
  }
  const facts = app.model?.facts;
  if (facts === undefined) return;
  const points = app.followed;
  const { drawings } = app.document;
  const kind = button.dataset.save ?? "";
  const name = `${facts.clipName}-${kind}`;
  if (kind === "points.csv") download(name, pointsCsv(points), "text/csv");
  else if (kind === "tracks.csv") download(name, tracksCsv(points, facts), "text/csv");
  else if (kind === "tracks.npz") download(name, tracksNpz(points, facts) as Uint8Array<ArrayBuffer>, "application/zip");
  else if (kind === "corrections.csv") {
    download(name, correctionsCsv(app.document.content), "text/csv");
    app.document.keep("corrections");
  } else if (kind === "project.json") {
    download(name, projectJson(points, facts, drawings), "application/json");
    app.document.keep("corrections", "drawings");
  } else if (kind === "masks.zip") download(name, masksZip(drawings, app.sketch, facts) as Uint8Array<ArrayBuffer>, "application/zip");
  else if (kind === "drawings.zip") {
    await busy(button, async () => {
      const zip = await drawingsZip(drawings, app.sketch, facts, (frame) => view.status(`Drawing frame ${frame + 1} of ${facts.numFrames} …`));
      download(name, zip as Uint8Array<ArrayBuffer>, "application/zip");
      view.status(`Saved ${name}.`);
    });
  } else if (kind === "drawings") {
    const finished = app.sketch.finished(drawings.filter((each) => each.kind === "paint"));
    await busy(button, async () =>
      saveVideo(kind, (await import("../alpha_video")).encodeAlphaVideo, async (context, frame) => {
        context.drawImage(over(facts, await finished(frame)), 0, 0, context.canvas.width, context.canvas.height);
      }),
    );
  } else {
    const scenes = app.finishedScenes();
    await busy(button, async () => saveVideo("points", (await import("../video")).encodeVideo, async (context, frame) => drawScene(context, await scenes(frame))));
  }

  /** The encoders come from modules that are large, and seldom wanted. */
  async function saveVideo(what: string, encode: typeof encodeVideo, draw: Draw): Promise<void> {
    if (facts === undefined) return;
    const onProgress = (frame: number): void => view.status(`Encoding frame ${frame + 1} of ${facts.numFrames} …`);
    const video = await encode(facts, draw, onProgress);
    download(`${facts.clipName}-${what}.${video.suffix}`, video.content, video.type);
    view.status(`Saved ${facts.clipName}-${what}.${video.suffix}.`);
  }
}
