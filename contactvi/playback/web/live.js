// The source of a simulator that runs: frames come from its process by server-sent events, the newest KEPT of them stay.

const KEPT = 3600;  // frames: a minute of viewing at 60 a second
const SLOWEST_ROLL = 0.01;  // of the size of the bodies per second: slower travel is not seen
const MOST_EVENTS = 20000;
const STRENGTHS = 300;  // frames that are looked at for the full force
const ROLL = MODES.indexOf("roll"), STICK = MODES.indexOf("stick");
const EVENT_FIELDS = {time: 1, kind: 1, name: 1, count: 1, impulse: 1, before: 1, after: 1, point: 3, direction: 3, drawn: 1};

// A list of events that grows at its end and forgets at its start.
class GrowingEvents extends EventList {
  constructor(kinds) {
    super(kinds, [], [], Object.fromEntries(Object.keys(EVENT_FIELDS).map(name => [name, []])));
    this.places = new Map();  // of names
    this.added = this.dropped = 0;  // how many there were
  }

  add(data) {
    const places = data.names.map((pair, place) => {
      const key = JSON.stringify(pair);
      if (!this.places.has(key)) {
        this.places.set(key, this.names.push(pair) - 1);
        this.colors.push(data.colors[place]);
      }
      return this.places.get(key);
    });
    for (const name of Object.keys(EVENT_FIELDS)) {
      for (const value of unpack(data[name])) { this[name].push(name === "name" ? places[value] : value); }
    }
    this.added += unpack(data.time).length;
    this.measure();
  }

  // Forget what was before `start` [s], and what is too much; places of events move.
  forget(start) {
    const gone = this.time.findIndex(time => time >= start);
    const count = Math.max(gone < 0 ? this.length : gone, this.length - MOST_EVENTS);
    if (count === 0) { return; }
    this.dropped += count;
    for (const [name, width] of Object.entries(EVENT_FIELDS)) { this[name].splice(0, width * count); }
    this.measure();
  }
}

class LiveSource {
  constructor(run) {
    this.live = true;
    this.size = run.live.size;
    this.bodies = run.bodies;
    this.shapes = run.shapes;
    this.events = new GrowingEvents(run.live.kinds);
    this.fullForce = null;  // until there was a force
    this.modes = [];
    this.pairs = [];  // the legend names none: they come and go
    this.colors = {};
    this.count = 0;  // of all frames that came
    this.run = null;
    this.scratch = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3(), new THREE.Quaternion()];
    this.clear();
    this.keep({t: run.first.t, pose: unpack(run.first.pose), contacts: null});
    this.provisional = true;  // the picture of the start, until frames come
  }

  pair(number) { return {color: this.colors[number]}; }

  get start() { return this.times[0]; }

  get end() { return this.times[this.times.length - 1]; }

  clear() {
    this.times = [];
    this.frames = [];
    this.events.forget(Infinity);
  }

  // Take a frame as it comes, with what has happened since the one before; return whether all before it was forgotten.
  push({frame, happened}) {
    const anew = this.provisional || frame.run !== this.run || frame.t < this.end;
    if (anew) { this.clear(); }
    this.run = frame.run;
    this.provisional = false;
    this.impacts = frame.impacts;
    this.bad = frame.bad;
    if (frame.t === this.end) {  // the same instant again
      this.times.pop();
      this.frames.pop();
    }
    this.keep({t: frame.t, pose: unpack(frame.pose), contacts: frame.contacts && this.unpackContacts(frame.contacts)});
    for (const data of happened) { this.events.add(data); }
    if (this.times.length > KEPT) {
      this.times.shift();
      this.frames.shift();
    }
    return anew;
  }

  keep(frame) {
    const before = this.frames[this.frames.length - 1];
    this.times.push(frame.t);
    this.frames.push(frame);
    ++this.count;
    if (before && before.contacts) { before.contacts.next.fill(-1); }
    if (!frame.contacts) { return; }
    if (before && before.contacts) { this.link(before, frame); }
    for (const mode of frame.contacts.mode) { if (!this.modes.includes(mode)) { this.modes.push(mode); } }
    if (this.fullForce === null) { this.measureForces(); }
  }

  // Points and forces, three numbers each; mode, pair, number of the point and places of its two bodies.
  unpackContacts({vectors, numbers, colors}) {
    Object.assign(this.colors, colors);
    const reals = unpack(vectors), whole = unpack(numbers), count = whole.length / 5;
    const found = {point: new Float32Array(3 * count), force: new Float32Array(3 * count), mode: new Uint8Array(count),
      pair: new Uint32Array(count), number: new Uint32Array(count), carriers: new Int32Array(2 * count),
      next: new Int32Array(count).fill(-1)};
    for (let row = 0; row < count; ++row) {
      found.point.set(reals.subarray(6 * row, 6 * row + 3), 3 * row);
      found.force.set(reals.subarray(6 * row + 3, 6 * row + 6), 3 * row);
      [found.mode[row], found.pair[row], found.number[row]] = whole.subarray(5 * row, 5 * row + 3);
      found.carriers.set(whole.subarray(5 * row + 3, 5 * row + 5), 2 * row);
    }
    return found;
  }

  // Find the points of a frame in the next one; one that sticks there and has travelled over both bodies rolls.
  link(before, frame) {
    const key = ({pair, number}, row) => pair[row] + "/" + number[row], places = new Map();
    frame.contacts.pair.forEach((_, row) => places.set(key(frame.contacts, row), row));
    before.contacts.pair.forEach((_, row) => {
      const next = places.get(key(before.contacts, row));
      if (next === undefined) { return; }
      before.contacts.next[row] = next;
      const slowest = SLOWEST_ROLL * this.size * (frame.t - before.t);
      if (frame.contacts.mode[next] === STICK && this.travel(before, row, frame, next) > slowest) {
        frame.contacts.mode[next] = ROLL;
      }
    });
  }

  // How far [m] a point has gone from one frame to another, seen from that of its bodies on which it has gone less.
  travel(before, row, frame, next) {
    const [here, there, origin, turn] = this.scratch;
    let least = Infinity;
    for (const side of [0, 1]) {
      const body = frame.contacts.carriers[2 * next + side];
      if (body < 0) { continue; }
      for (const [place, {pose, contacts}, at] of [[here, before, row], [there, frame, next]]) {
        place.fromArray(contacts.point, 3 * at).sub(origin.fromArray(pose, 7 * body));
        place.applyQuaternion(turn.fromArray(pose, 7 * body + 3).conjugate());
      }
      least = Math.min(least, here.distanceTo(there));
    }
    return least === Infinity ? 0 : least;
  }

  // The force of a full arrow is that which 98 % of those seen stay below.
  measureForces() {
    const strengths = [], every = Math.max(1, Math.floor(this.frames.length / STRENGTHS));
    for (let k = this.frames.length - 1; k >= 0; k -= every) {
      const {contacts} = this.frames[k];
      for (let at = 0; contacts && at < contacts.force.length; at += 3) {
        const strength = Math.hypot(contacts.force[at], contacts.force[at + 1], contacts.force[at + 2]);
        if (strength > 0) { strengths.push(strength); }
      }
    }
    if (!strengths.length) { return; }
    strengths.sort((a, b) => a - b);
    this.fullForce = strengths[Math.floor(0.98 * (strengths.length - 1))];
  }

  // Frame before t and the share of the way to the next one.
  locate(t) {
    const k = Math.max(0, Math.min(lastNotAbove(this.times, t), this.times.length - 2));
    if (this.times.length < 2) { return [0, 0]; }
    return [k, Math.max(0, Math.min(1, (t - this.times[k]) / (this.times[k + 1] - this.times[k])))];
  }

  pose(body, t, position, quaternion) {
    const [k, share] = this.locate(t), [p, , , q] = this.scratch, {pose} = this.frames[k];
    position.fromArray(pose, 7 * body);
    quaternion.fromArray(pose, 7 * body + 3).normalize();
    if (share > 0) {
      const next = this.frames[k + 1].pose;
      position.lerp(p.fromArray(next, 7 * body), share);
      quaternion.slerp(q.fromArray(next, 7 * body + 3).normalize(), share);
    }
  }

  contacts(t, add) {
    const [k, share] = this.locate(t), {contacts} = this.frames[share === 1 ? k + 1 : k];
    if (!contacts) { return; }
    const [point, force, other] = this.scratch, after = share === 1 ? null : this.frames[k + 1];
    for (let row = 0; row < contacts.mode.length; ++row) {
      const next = after ? contacts.next[row] : -1;
      point.fromArray(contacts.point, 3 * row);
      force.fromArray(contacts.force, 3 * row);
      if (next >= 0) {
        point.lerp(other.fromArray(after.contacts.point, 3 * next), share);
        force.lerp(other.fromArray(after.contacts.force, 3 * next), share);
      }
      add(point, force, contacts.mode[row], contacts.pair[row]);
    }
  }
}

// The clock of a live view: it follows the newest frame until the user pauses or goes elsewhere.
class LivePlayer extends Player {
  constructor(...parts) {
    super(...parts);
    this.shown = 0;  // frames that had come when it was drawn last
    this.follow();
  }

  follow() {
    this.following = this.playing = true;
    this.seek(this.source.end);
  }

  pause() {
    this.following = false;
    super.pause();
  }

  play() { if (this.time >= this.source.end) { this.follow(); } else { super.play(); } }

  finish() { this.follow(); }

  go(time) {
    if (time >= this.source.end) { this.follow(); return; }
    this.following = false;
    this.last = performance.now();
    this.seek(time);
  }

  tick(now) {
    const came = this.source.count !== this.shown;
    this.shown = this.source.count;
    if (this.following) {
      if (came) { this.seek(this.source.end); }
      this.stage.render();
      return;
    }
    if (came && this.time < this.source.start) { this.seek(this.time); }  // what was shown is forgotten
    if (came) { this.tell(); }  // the time bar grows
    super.tick(now);
  }
}

// Take frames from the server, and let the panels follow what they bring.
function connect(player, panels) {
  const {source} = player, stream = new EventSource("frames"), fact = element("fact");
  let state = "waiting for the simulator";
  const tell = () => {
    const impacts = source.impacts === undefined ? "" : `, ${source.impacts} impacts`;
    fact.textContent = state + impacts + (source.bad ? ". " + source.bad : "");
    fact.classList.toggle("bad", Boolean(source.bad));
  };
  const over = words => {
    state = words;
    stream.close();
    refresh();
  };
  stream.onmessage = event => {
    state = "live";
    if (source.push(JSON.parse(event.data))) {
      refresh();
      player.follow();
    }
  };
  stream.addEventListener("end", () => over("ended"));
  stream.onerror = () => over("the process of the simulator is gone");
  let seen = -1;
  function refresh() {
    tell();
    if (seen === source.count) { return; }
    seen = source.count;
    source.measureForces();
    source.events.forget(source.start);
    panels.refresh();
  }
  setInterval(refresh, 250);
}
