/** The frame that is shown, and playing: one frame after the other at their times, round and round. */

import { type Times, duration } from "../times";

export class Player {
  frame = 0;
  playing = false;
  private numFrames = 1;
  private times: Times = { times: [0], fps: 24 };
  private due = 0;
  private request = 0;

  /** `onFrame` hears of every change; a frame that is not `isReady` is waited for. */
  constructor(
    private readonly onFrame: () => void,
    private readonly isReady: (frame: number) => boolean,
  ) {}

  load(times: Times): void {
    Object.assign(this, { times, numFrames: times.times.length, frame: 0, playing: false });
    this.onFrame();
  }

  /** Shows a frame; numbers beyond the ends mean the ends. */
  seek(frame: number): void {
    this.frame = Math.min(Math.max(Math.round(frame), 0), this.numFrames - 1);
    this.onFrame();
  }

  /** Pauses and goes `by` frames on. */
  step(by: number): void {
    this.playing = false;
    this.seek(this.frame + by);
  }

  toggle(): void {
    this.playing = !this.playing && this.numFrames > 1;
    this.due = performance.now() + this.milliseconds(this.frame);
    cancelAnimationFrame(this.request);
    if (this.playing) this.request = requestAnimationFrame((now) => this.tick(now));
    this.onFrame();
  }

  private milliseconds(frame: number): number {
    return 1000 * duration(this.times, frame);
  }

  private tick(now: number): void {
    if (!this.playing) return;
    const next = (this.frame + 1) % this.numFrames;
    if (now >= this.due && this.isReady(next)) {
      this.due = Math.max(this.due + this.milliseconds(next), now);
      this.frame = next;
      this.onFrame();
    }
    this.request = requestAnimationFrame((later) => this.tick(later));
  }
}
