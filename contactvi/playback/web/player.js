// The clock of the playback: one time, which everything that is shown follows.

class Player {
  constructor(stage, orbit, signs, source) {
    Object.assign(this, {stage, orbit, signs, source});
    this.time = source.start;
    this.playing = false;
    this.speed = 1;
    this.last = 0;
    this.listeners = [];
    this.chosen = [];  // places of the events between which it jumps
  }

  get length() { return this.source.end - this.source.start; }

  seek(time) {
    this.time = Math.max(this.source.start, Math.min(this.source.end, time));
    this.show();
  }

  show() {
    this.stage.place(this.time);
    this.impact = this.signs.show(this.time, this.speed);
    this.orbit.keep();
    this.tell();
  }

  tell() { for (const listener of this.listeners) { listener(this); } }

  play() {
    if (!(this.length > 0)) { return; }
    if (this.time >= this.source.end) { this.time = this.source.start; }
    this.playing = true;
    this.last = performance.now();
    this.show();
  }

  pause() {
    this.playing = false;
    this.stage.draw();
    this.tell();
  }

  toggle() { if (this.playing) { this.pause(); } else { this.play(); } }

  // At the end of what there is to play.
  finish() { this.pause(); }

  // Go to a time and play on from there if it plays.
  go(time) { this.seek(time); }

  // Go by frames.
  step(count) {
    this.pause();
    const times = this.source.times, slack = 1e-9 * Math.max(this.length, 1e-3);
    const now = lastNotAbove(times, this.time + slack), between = this.time - times[now] > slack;
    this.seek(times[Math.max(0, Math.min(times.length - 1, now + count + (between && count < 0 ? 1 : 0)))]);
  }

  // Go to the next of the chosen events, or the one before; those of one time are one stop.
  jump(side) {
    this.pause();
    const events = this.source.events, slack = 1e-9 * Math.max(this.length, 1e-3);
    const later = side > 0 ? this.chosen.find(k => events.time[k] > this.time + slack)
      : [...this.chosen].reverse().find(k => events.time[k] < this.time - slack);
    if (later !== undefined) { this.seek(events.time[later]); }
  }

  tick(now) {
    if (this.playing) {
      // A browser that is late (first picture, hidden tab) plays slower instead of jumping.
      const time = this.time + this.speed * Math.min(now - this.last, 100) / 1000;
      this.last = now;
      this.seek(time);
      if (time >= this.source.end) { this.finish(); }
    }
    this.stage.render();
  }
}
