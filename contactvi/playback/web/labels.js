// Names of bodies in the picture. No two boxes overlap: one that finds its place taken stands beside it, with a line to
// its body.

const LEADER_COLOR = "#55636f";

// Places of the middles of boxes {x, y, width, height, order} around their anchors x, y [px], such that none overlaps
// another one: each in turn, those of the nearest bodies first, gets the free place that is nearest to its anchor. A box
// for which there is none within the picture is given null. No box overlaps those in `others` either.
function declutter(boxes, width, height, others = []) {
  const taken = [...others], places = boxes.map(() => null);
  const rising = [...boxes.keys()].sort((a, b) => boxes[a].order - boxes[b].order || a - b);
  const free = (x, y, box) => x >= box.width / 2 && x <= width - box.width / 2 && y >= box.height / 2 &&
    y <= height - box.height / 2 && taken.every(other => Math.abs(other.x - x) >= (other.width + box.width) / 2 + 1 ||
      Math.abs(other.y - y) >= (other.height + box.height) / 2 + 1);
  for (const k of rising) {
    const box = boxes[k];
    search: for (let ring = 0; ring < 16; ++ring) {
      for (let turn = 0; turn < Math.max(1, 8 * Math.min(ring, 3)); ++turn) {
        const angle = 2 * Math.PI * turn / (8 * Math.min(ring, 3) || 1);
        const x = box.x + 1.2 * box.height * ring * Math.cos(angle) * 1.5;
        const y = box.y - 1.2 * box.height * ring * Math.sin(angle);
        if (!free(x, y, box)) { continue; }
        places[k] = {x, y, width: box.width, height: box.height, anchor: box};
        taken.push(places[k]);
        break search;
      }
    }
  }
  return places;
}

// Whether a box stands beside its body, so that it has a line to it.
function standsBeside({x, y, width, height, anchor}) {
  return Math.abs(x - anchor.x) > width / 2 || Math.abs(y - anchor.y) > height / 2;
}

class Labels {
  constructor(stage) {
    this.stage = stage;
    this.elements = null;
    stage.afterDraw = () => { if (this.elements) { this.place(); } };
  }

  show(shown) {
    const {stage} = this;
    if (this.elements) {
      this.elements.forEach(label => label.remove());
      this.lines.remove();
    }
    this.elements = null;
    if (shown) {
      this.lines = document.createElementNS("http://www.w3.org/2000/svg", "svg");
      this.lines.classList.add("leaders");
      this.lines.appendChild(document.createElementNS("http://www.w3.org/2000/svg", "path"));
      stage.pane.appendChild(this.lines);
      this.elements = this.bodies().map(k => {
        const label = document.createElement("div");
        label.className = "label";
        label.textContent = stage.bodies[k].name;
        stage.pane.appendChild(label);
        return label;
      });
      this.sizes = this.elements.map(label => [label.offsetWidth, label.offsetHeight]);
    }
    stage.draw();
  }

  // The bodies that have names: all but the world.
  bodies() { return [...this.stage.bodies.keys()].filter(k => !this.stage.source.bodies[k].fixed && this.stage.bodies[k].name); }

  // Where the boxes of these sizes [px] are now, beside the boxes of others.
  places(sizes, others) {
    const {stage} = this, point = new THREE.Vector3(), inside = [];
    const boxes = this.bodies().map((k, place) => {
      stage.center(k, point).project(stage.camera);
      inside.push(Math.abs(point.x) < 1 && Math.abs(point.y) < 1 && Math.abs(point.z) < 1);
      return {x: (0.5 + 0.5 * point.x) * stage.width, y: (0.5 - 0.5 * point.y) * stage.height, order: point.z,
        width: sizes[place][0], height: sizes[place][1]};
    });
    const found = declutter(boxes.filter((_, k) => inside[k]), stage.width, stage.height, others);
    return inside.map(seen => seen ? found.shift() : null);
  }

  place() {
    const lines = [];
    this.places(this.sizes).forEach((box, k) => {
      const {style} = this.elements[k];
      style.visibility = box ? "" : "hidden";
      if (!box) { return; }
      style.transform = `translate(-50%, -50%) translate(${box.x}px, ${box.y}px)`;
      if (standsBeside(box)) { lines.push(`M${box.anchor.x} ${box.anchor.y}L${box.x} ${box.y}`); }
    });
    this.lines.firstChild.setAttribute("d", lines.join(""));
  }

  // Draw the names into a picture of the size of the stage.
  drawInto(pen, others) {
    pen.font = '11px "DejaVu Sans", sans-serif';
    pen.textBaseline = "middle";
    pen.textAlign = "center";
    const names = this.bodies().map(k => this.stage.bodies[k].name);
    const places = this.places(names.map(name => [pen.measureText(name).width + 8, 16]), others);
    pen.lineWidth = 1;
    pen.strokeStyle = LEADER_COLOR;
    for (const box of places) {
      if (!box || !standsBeside(box)) { continue; }
      pen.beginPath();
      pen.moveTo(box.anchor.x, box.anchor.y);
      pen.lineTo(box.x, box.y);
      pen.stroke();
    }
    places.forEach((box, k) => {
      if (!box) { return; }
      pen.fillStyle = "rgba(255, 255, 255, .8)";
      pen.fillRect(box.x - box.width / 2, box.y - box.height / 2, box.width, box.height);
      pen.fillStyle = INK;
      pen.fillText(names[k], box.x, box.y);
    });
    pen.textAlign = "start";
  }
}
