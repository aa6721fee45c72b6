// Buttons, keys, the time bar, the legend and the list of events.

const element = id => document.getElementById(id);
const EVENT_COLORS = {impact: "#e0431f", limit: "#8a5fc2", begin: "#2f7d4f", release: "#7c8794", stick: "#0072b2",
  slip: "#e69f00", zeno: "#111111", inconsistent: "#d0006f", overlap: "#b00000"};
const ICONS = {play: "M4 2.5v11l9-5.5z", pause: "M3.5 2.5h3v11h-3zM9.5 2.5h3v11h-3z"};
const NAMED = 4;  // pairs in the legend

function make(tag, text, parent, settings) {
  const made = Object.assign(document.createElement(tag), settings);
  made.textContent = text;
  parent.appendChild(made);
  return made;
}

class Panels {
  constructor(player, words) {
    this.player = player;
    this.words = words;
    this.events = player.source.events;
    this.heading();
    this.cameras();
    this.buttons();
    this.keys();
    this.list = new EventPanel(player, () => this.drawTicks());
    this.legend();
    new ResizeObserver(() => this.drawTicks()).observe(element("track"));
    player.listeners.push(() => this.show());
    if (!(player.length > 0) && !player.source.live) {
      element("track").style.display = "none";
      for (const id of ["before", "back", "play", "forth", "after"]) { element(id).disabled = true; }
    }
    const orbit = player.orbit, covered = id => element(id).offsetHeight ? element(id).offsetHeight + 14 : 0;
    orbit.margins = () => [covered("head"), covered("foot")];
  }

  heading() {
    const {title, facts} = this.words;
    document.querySelector("#head h1").textContent = title;
    element("fact").textContent = facts[0].text;
    for (const fact of facts.slice(1)) { make("div", fact.text, element("facts"), {className: fact.bad ? "bad" : ""}); }
    element("head").open = facts.some(fact => fact.bad);
  }

  cameras() {
    const {orbit, source} = this.player, select = element("camera"), own = this.words.camera;
    const plain = own.preset ? [] : [["scene's", own]];
    const bodies = source.bodies.map((body, k) => [body.name, {follow: k}])
      .filter(([, {follow}]) => source.bodies[follow].moves && this.player.stage.bodies[follow].children.length > 0);
    this.presets = [...["auto", "front", "side", "top"].map(preset => [preset, {preset}]), ...plain];
    this.choices = [...this.presets, ...bodies.map(([name, camera]) => ["follow " + name, camera])];
    this.choices.forEach(([name], k) => make("option", name, select, {value: k}));
    select.value = own.preset ? this.presets.findIndex(([name]) => name === own.preset) : 4;
    select.addEventListener("change", () => orbit.choose(this.choices[select.value][1]));
  }

  chooseCamera(k) {
    if (k >= this.choices.length) { return; }
    element("camera").value = k;
    this.player.orbit.choose(this.choices[k][1]);
  }

  buttons() {
    const {player} = this, {signs} = player;
    element("live").hidden = !player.source.live;
    element("live").addEventListener("click", () => player.follow());
    element("time").addEventListener("input", event => {
      const time = Number(event.target.value);
      player.pause();
      player.seek(time);
    });
    element("play").addEventListener("click", () => player.toggle());
    element("back").addEventListener("click", () => player.step(-1));
    element("forth").addEventListener("click", () => player.step(1));
    element("before").addEventListener("click", () => player.jump(-1));
    element("after").addEventListener("click", () => player.jump(1));
    element("speed").addEventListener("input", event => {
      const speed = Number(event.target.value.replace(",", ".")), good = speed > 0 && speed <= 1000;
      event.target.classList.toggle("wrong", !good);
      if (good) { player.speed = speed; player.show(); }
    });
    this.switches = {};
    this.addSwitch("forces", signs.shown.forces, on => { signs.shown.forces = signs.shown.impacts = on; player.show(); });
    this.addSwitch("points", true, on => { signs.shown.points = on; player.show(); });
    this.addSwitch("labels", false, on => labels.show(on));
    this.addSwitch("listed", false, on => { element("events").hidden = !on; if (on) { this.list.open(); } });
    this.addSwitch("keys", false, on => { element("help").hidden = !on; });
  }

  addSwitch(id, on, set) {
    const button = element(id), turn = value => {
      button.setAttribute("aria-pressed", value);
      set(value);
      if (this.legendShown) { this.legendShown(); }
    };
    button.setAttribute("aria-pressed", on);
    this.switches[id] = () => turn(button.getAttribute("aria-pressed") !== "true");
    button.addEventListener("click", this.switches[id]);
  }

  keys() {
    const {player, switches} = this;
    const actions = {" ": () => player.toggle(), n: () => player.jump(1), p: () => player.jump(-1),
      ArrowLeft: event => player.step(event.shiftKey ? -10 : -1), ArrowRight: event => player.step(event.shiftKey ? 10 : 1),
      Home: () => player.go(player.source.start), End: () => player.go(player.source.end),
      f: switches.forces, c: switches.points, l: switches.labels, e: switches.listed, "?": switches.keys};
    for (let k = 0; k < 5; ++k) { actions[k + 1] = () => this.chooseCamera(k); }
    document.addEventListener("keydown", event => {
      const typing = event.target.id === "speed" || event.target.tagName === "SELECT";
      if (typing || event.ctrlKey || event.metaKey || event.altKey || !actions[event.key]) { return; }
      event.preventDefault();
      actions[event.key](event);
    });
    element("speed").addEventListener("keydown", event => { if (event.key === "Enter") { event.target.blur(); } });
    element("camera").addEventListener("change", event => event.target.blur());
  }

  // What the arrows and the points mean, and how long a newton is.
  legend() {
    const {signs, source} = this.player, box = element("legend");
    box.textContent = "";
    const row = make("div", "", box), pairs = make("div", "", box), points = make("div", "", box);
    if (source.fullForce !== null) {
      const entry = make("span", "", row);
      make("i", "", entry, {className: "arrow"}).style.background = INK;
      this.measure = make("span", "", entry);
      const slider = make("input", "", make("label", "", row), {type: "range", id: "scale", min: -1, max: 1,
        step: "any", value: Math.log10(signs.scale), title: "Length of the arrows"});
      slider.setAttribute("aria-label", "Length of the arrows");
      slider.addEventListener("input", () => {
        signs.scale = 10 ** Number(slider.value);
        this.player.show();
        this.legendShown();
      });
    }
    if (this.events.strongest > 0) {
      const entry = make("span", "impulse", row);
      entry.prepend(make("i", "", entry, {className: "arrow"}));
      entry.firstChild.style.background = css(IMPACT_COLOR);
    }
    for (const {name, color} of source.fullForce === null ? [] : source.pairs.slice(0, NAMED)) {
      const entry = make("span", "", pairs);
      make("i", "", entry, {className: "arrow"}).style.background = color;
      make("span", shortened(name), entry, {className: "pair", title: name});
    }
    if (source.pairs.length > NAMED) { make("span", `${source.pairs.length - NAMED} more pairs`, pairs); }
    const present = source.modes.map(mode => MODES[mode]);
    for (const mode of Object.keys(MODE_COLORS).filter(mode => present.includes(mode))) {
      const entry = make("span", mode, points);
      entry.prepend(make("i", "", entry));
      entry.firstChild.style.background = css(MODE_COLORS[mode]);
    }
    this.legendShown = () => {
      row.style.display = signs.shown.forces && row.children.length ? "" : "none";
      pairs.style.display = signs.shown.forces && pairs.children.length ? "" : "none";
      points.style.display = signs.shown.points && points.children.length ? "" : "none";
      box.style.display = row.style.display && points.style.display ? "none" : "";
      if (this.measure) { this.measure.textContent = "force " + scaleWords(signs.perNewton * signs.scale, this.player.stage.view.arrow); }
    };
    this.legendShown();
    element("now").style.display = this.events.strongest > 0 ? "" : "none";
    this.explained = this.explains();
  }

  // What the legend speaks of.
  explains() {
    const {source} = this.player;
    return [this.events.strongest > 0, source.fullForce !== null, source.pairs.length, ...source.modes].join();
  }

  // Follow a source that has grown.
  refresh() {
    if (this.explains() !== this.explained) { this.legend(); }
    this.legendShown();
    this.impact = undefined;  // places of events may have moved
    this.list.refresh();
    this.drawTicks();
  }

  show() {
    const {player} = this, {start, end} = player.source, slider = element("time");
    [slider.min, slider.max] = [start, end];
    slider.value = player.time;
    if (player.source.live) { element("live").setAttribute("aria-pressed", player.following); }
    const digits = Math.max(2, Math.min(6, 3 - Math.floor(Math.log10(end || 1))));
    element("clock").textContent = player.time.toFixed(digits) + " / " + Number(end.toFixed(digits)) + " s";
    const icon = player.playing ? "pause" : "play";
    if (icon !== this.icon) {
      this.icon = icon;
      element("play").querySelector("path").setAttribute("d", ICONS[icon]);
      element("play").setAttribute("aria-label", icon === "play" ? "Play" : "Pause");
    }
    const line = element("now"), k = player.impact;
    line.style.visibility = k >= 0 ? "visible" : "hidden";
    if (k >= 0 && k !== this.impact) {
      line.textContent = "";
      make("b", this.events.word(k) + " at " + this.events.time[k].toPrecision(7) + " s", line);
      make("span", this.events.label(k) + "  ·  " + this.events.detail(k), line);
    }
    this.impact = k;
    this.list.show();
  }

  // Marks of the chosen events above the time bar, one pixel each: changes below, impacts over them.
  drawTicks() {
    const canvas = element("ticks"), ratio = window.devicePixelRatio || 1, {chosen, length, source} = this.player;
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    Object.assign(canvas, {width, height});
    const pen = canvas.getContext("2d"), wide = Math.max(1, Math.round(1.5 * ratio));
    for (const impacts of [false, true]) {
      for (const k of chosen) {
        if (this.events.isImpact(k) !== impacts || !(length > 0)) { continue; }
        pen.fillStyle = EVENT_COLORS[this.events.kinds[this.events.kind[k]]];
        const x = Math.round((this.events.time[k] - source.start) / length * (width - wide));
        pen.fillRect(x, impacts ? 0 : 0.45 * height, wide, impacts ? height : 0.55 * height);
      }
    }
  }
}

// The list: only the rows in sight are elements of the page. Words are wrapped, and all rows are as high as the longest
// ones need.
class EventPanel {
  constructor(player, changed) {
    Object.assign(this, {player, changed, events: player.source.events});
    this.kinds = new Set(this.events.kinds);
    this.row = 40;  // [px] height of a row
    this.boxes = new Map();  // kind -> the words beside its box
    this.count();
    element("threshold").value = 0.6;  // a hundredth of the strongest
    element("threshold").addEventListener("input", () => this.choose());
    element("list").addEventListener("scroll", () => this.fill());
    new ResizeObserver(() => { this.measure(); this.fill(); }).observe(element("list"));
    this.choose();
  }

  // Count the events of each kind, and give a box to each kind that occurs.
  count() {
    const {events} = this, counts = events.kinds.map(() => 0);
    for (const kind of events.kind) { ++counts[kind]; }
    events.kinds.forEach((kind, number) => {
      if (counts[number] && !this.boxes.has(kind)) { this.addBox(kind); }
      const word = {limit: "at limits", zeno: "Zeno"}[kind] || kind;
      if (this.boxes.has(kind)) { this.boxes.get(kind).textContent = `${word} (${counts[number]})`; }
    });
    this.impacts = counts[events.kinds.indexOf("impact")] + counts[events.kinds.indexOf("limit")];
    element("least").style.display = this.impacts ? "" : "none";
  }

  addBox(kind) {
    const label = make("label", "", element("kinds")), box = make("input", "", label, {type: "checkbox", checked: true});
    make("i", "", label).style.background = EVENT_COLORS[kind];
    this.boxes.set(kind, make("span", "", label));
    box.dataset.kind = kind;
    box.addEventListener("change", () => {
      if (box.checked) { this.kinds.add(kind); } else { this.kinds.delete(kind); }
      this.choose();
    });
  }

  // Follow a list that has grown; while the user presses on it the rows stay, unless they are gone.
  refresh() {
    const {added, dropped} = this.events, [before, gone] = this.seen || [0, 0];
    if (dropped === gone && (added === before || element("list").matches(":active"))) { return; }
    this.seen = [added, dropped];
    this.count();
    this.now = undefined;
    this.choose();
  }

  // The slider goes from all impacts over five powers of ten to the strongest one.
  get least() {
    const at = Number(element("threshold").value);
    return at > 0 ? this.events.strongest * 10 ** (5 * (at - 1)) * (1 - 1e-6) : 0;
  }

  choose() {
    const {player, events, least} = this;
    player.signs.least = least;
    player.chosen = events.chosen(this.kinds, least);
    const above = player.chosen.filter(k => events.isImpact(k)).length;
    element("least").firstChild.textContent = least > 0
      ? `impacts from ${short(least)} N s on: ${above} of ${this.impacts}` : `all ${this.impacts} impacts`;
    this.measure();
    this.changed();
    this.fill();
    player.show();
  }

  // Find the height of the rows, by the longest names with the longest words that an event may have.
  measure() {
    const {events} = this, rows = element("rows"), before = this.row;
    const labels = events.names.map((_, place) => place).sort((a, b) => words(b).length - words(a).length).slice(0, 5);
    function words(place) { return events.names[place].join(" | "); }
    const detail = this.impacts ? "impulse 0.000888 N s, speed -0.000888 to 0.000888 m/s" : "88 points";
    const tallest = Math.max(...labels.map(place => {
      const row = this.add(rows, "", "impact", "0.888888 s", words(place), detail, events.colors[place]);
      const height = row.offsetHeight;
      row.remove();
      return height;
    }), 0);
    if (tallest > 0) { this.row = Math.max(40, tallest); }
    if (this.row !== before) { this.filled = this.now = undefined; }
    rows.style.height = this.row * this.player.chosen.length + "px";
  }

  // Add a row: what happened, when, to which pair, which has its colour in all plots.
  add(rows, color, word, time, label, detail, pair) {
    const row = make("button", "", rows), line = make("span", "", row);
    make("i", "", line).style.background = color;
    make("b", word, line);
    make("em", time, line);
    const small = make("small", [label, detail].filter(text => text).join(" \u00b7 "), row);
    if (pair) {
      small.prepend(Object.assign(document.createElement("i"), {className: "pair"}));
      small.firstChild.style.background = pair;
    }
    return row;
  }

  open() {
    this.measure();
    this.fill();
    this.now = undefined;
    this.show();
  }

  fill() {
    const list = element("list"), rows = element("rows"), {chosen} = this.player, {events} = this;
    const from = Math.max(0, Math.floor(list.scrollTop / this.row) - 4);
    const to = list.clientHeight > 0 ? Math.min(chosen.length, from + Math.ceil(list.clientHeight / this.row) + 8) : from;
    if (this.filled && this.filled[0] === chosen && this.filled[1] === from && this.filled[2] === to) { return; }
    this.filled = [chosen, from, to];
    rows.textContent = "";
    this.shown = new Map();
    for (let place = from; place < to; ++place) {
      const k = chosen[place], row = this.add(rows, EVENT_COLORS[events.kinds[events.kind[k]]], events.word(k),
        events.time[k].toPrecision(6) + " s", events.label(k), events.detail(k), events.color(k));
      row.style.top = this.row * place + "px";
      row.style.height = this.row + "px";
      row.addEventListener("click", () => { this.player.pause(); this.player.seek(events.time[k]); });
      this.shown.set(place, row);
    }
    this.mark();
  }

  // Mark the last event that has happened, and keep it in sight while the run plays.
  show() {
    const now = lastNotAbove(this.times(), this.player.time + 1e-9);
    if (now === this.now) { return; }
    this.now = now;
    const list = element("list"), top = this.row * now;
    if (now >= 0 && list.clientHeight > 0 && (top < list.scrollTop || top > list.scrollTop + list.clientHeight - this.row)) {
      list.scrollTop = top - list.clientHeight / 3;
    }
    this.mark();
  }

  times() {
    if (this.timed !== this.player.chosen) {
      this.timed = this.player.chosen;
      this.chosenTimes = Float64Array.from(this.timed, k => this.events.time[k]);
    }
    return this.chosenTimes;
  }

  mark() {
    for (const [place, row] of this.shown || []) { row.classList.toggle("on", place === this.now); }
  }
}

// The name of a pair, long names without their middles: names often begin alike.
function shortened(pair) {
  const part = name => name.length > 16 ? name.slice(0, 7) + "\u2026" + name.slice(-8) : name;
  return pair.length > 32 ? pair.split(" | ").map(part).join(" | ") : pair;
}

function css(color) { return "#" + color.toString(16).padStart(6, "0"); }

// "5 N = 12 cm" for a scale [m/N]: a round force whose arrow has about the full length [m].
function scaleWords(perNewton, arrow) {
  const newtons = roundNumber(arrow / perNewton), length = newtons * perNewton;
  const [unit, word] = length >= 1 ? [1, "m"] : length >= 0.01 ? [100, "cm"] : [1000, "mm"];
  const force = newtons >= 1e5 || newtons < 1e-3 ? newtons.toExponential(0) : newtons;
  return `${force} N = ${Number((unit * length).toPrecision(2))} ${word}`;
}
