"use strict";
const THREE = MeshCat.THREE;
// The data of a run. A player takes its frames from a source: an object with
//   start, end             [s] the times it can show;
//   times                  [s] of its frames, ascending;
//   bodies                 [{name, moves, fixed}], constant;
//   shapes                 what is drawn on them, constant;
//   pose(body, t, position, quaternion)   writes where a body is;
//   contacts(t, add)       calls add(point, force, mode, pair) for every contact point, with vectors that it uses again;
//   pairs                  [{name, color}] of the forces, the strongest first; pair(number) is that of a contact;
//   fullForce              [N] the force whose arrow has the full length; null without contacts;
//   forceScale             [N/m] the scale of the arrows that is given instead, else null;
//   modes                  the numbers of the modes that occur;
//   events                 an EventList.
// Recording is the source of a run that is over, LiveSource (live.js) that of one that goes on: its frames, modes, events
// and full force grow, and `live` is true.

const NUMBERS = {f4: Float32Array, f8: Float64Array, i2: Int16Array, i4: Int32Array,
  u1: Uint8Array, u2: Uint16Array, u4: Uint32Array};
const MODES = ["stick", "slip", "frictionless", "impact", "roll"];  // at the places of their numbers

function unpack(entry) {
  const text = atob(entry.data), bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; ++k) { bytes[k] = text.charCodeAt(k); }
  return new NUMBERS[entry.type](bytes.buffer);
}

// The last place whose value is at most `value`, -1 where there is none; values ascend.
function lastNotAbove(values, value) {
  let low = -1, high = values.length;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] <= value) { low = middle; } else { high = middle; }
  }
  return low;
}

class EventList {
  // columns: time, kind, name, count, impulse, before, after, point, direction, drawn.
  // colors: of the pairs among the names, else null.
  constructor(kinds, names, colors, columns) {
    Object.assign(this, {kinds, names, colors}, columns);
    this.measure();
  }

  static of(data) {
    const columns = Object.entries(data).filter(([, entry]) => entry.data !== undefined);
    return new EventList(data.kinds, data.names, data.colors, Object.fromEntries(columns.map(([name, entry]) => [name, unpack(entry)])));
  }

  measure() { this.strongest = this.impulse.reduce((most, impulse) => Math.max(most, impulse), 0); }

  get length() { return this.time.length; }

  isImpact(k) { return this.kind[k] <= 1; }

  word(k) {
    const kind = this.kinds[this.kind[k]];
    return {limit: "impact at limit", zeno: "bouncing ended (Zeno)"}[kind] || kind;
  }

  color(k) { return this.colors[this.name[k]]; }

  label(k) { return this.names[this.name[k]].join(" | "); }

  // In words, beside time, kind and names.
  detail(k) {
    if (!this.isImpact(k)) { return this.count[k] > 1 ? this.count[k] + " points" : ""; }
    // A limit may be an angle or a length. No line ends between a number and its unit.
    const [push, speed] = this.kind[k] === 0 ? ["\u00a0N\u00a0s", "\u00a0m/s"] : ["", ""];
    return "impulse " + short(this.impulse[k]) + push + ", speed " + short(this.before[k]) + " to " +
      short(this.after[k]) + speed;
  }

  // The places of what is to be seen: kinds is a Set of words, impacts from `least` [N s] on.
  chosen(kinds, least) {
    const numbers = this.kinds.map(kind => kinds.has(kind)), found = [];
    for (let k = 0; k < this.length; ++k) {
      if (numbers[this.kind[k]] && (!this.isImpact(k) || this.impulse[k] >= least)) { found.push(k); }
    }
    return found;
  }
}

function short(value) {
  return Math.abs(value) < 1e-12 ? "0" : String(Number(value.toPrecision(3)));
}

class Recording {
  constructor(run) {
    this.start = 0;
    this.end = run.duration;
    this.times = unpack(run.times);
    this.bodies = run.bodies;
    this.shapes = run.shapes;
    this.events = EventList.of(run.events);
    this.paths = run.bodies.map(body => ({position: unpack(body.position), quaternion: unpack(body.quaternion)}));
    this.rows = this.fullForce = null;
    this.forceScale = run.force_scale;
    this.modes = [];
    this.pairs = run.contacts ? run.contacts.pairs : [];
    if (run.contacts) {
      this.rows = {};
      this.fullForce = run.contacts.full;
      for (const name of ["times", "first", "point", "force", "mode", "pair", "next"]) {
        this.rows[name] = unpack(run.contacts[name]);
      }
      this.modes = [...new Set(this.rows.mode)];
      this.scratch = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
    }
    this.other = [new THREE.Vector3(), new THREE.Quaternion()];
  }

  pair(number) { return this.pairs[number]; }

  // Frame before t and the share of the way to the next one.
  locate(times, t) {
    const k = Math.max(0, Math.min(lastNotAbove(times, t), times.length - 2));
    if (times.length < 2) { return [0, 0]; }
    return [k, Math.max(0, Math.min(1, (t - times[k]) / (times[k + 1] - times[k])))];
  }

  pose(body, t, position, quaternion) {
    const path = this.paths[body], [p, q] = this.other;
    if (path.position.length <= 3) {
      position.fromArray(path.position);
      quaternion.fromArray(path.quaternion).normalize();
      return;
    }
    const [k, share] = this.locate(this.times, t);
    position.fromArray(path.position, 3 * k).lerp(p.fromArray(path.position, 3 * k + 3), share);
    quaternion.fromArray(path.quaternion, 4 * k).slerp(q.fromArray(path.quaternion, 4 * k + 4), share).normalize();
  }

  // The contacts of the step around t. A point that is there in the next frame too moves to it, others stay.
  contacts(t, add) {
    if (!this.rows) { return; }
    const rows = this.rows, [point, force, other] = this.scratch, last = rows.times.length - 1;
    const k = Math.max(0, Math.min(lastNotAbove(rows.times, t + 1e-12), last));
    const share = k < last ? Math.max(0, (t - rows.times[k]) / (rows.times[k + 1] - rows.times[k])) : 0;
    for (let row = rows.first[k]; row < rows.first[k + 1]; ++row) {
      const next = rows.next[row];
      point.fromArray(rows.point, 3 * row);
      force.fromArray(rows.force, 3 * row);
      if (next >= 0) {
        point.lerp(other.fromArray(rows.point, 3 * next), share);
        force.lerp(other.fromArray(rows.force, 3 * next), share);
      }
      add(point, force, rows.mode[row], rows.pair[row]);
    }
  }
}
