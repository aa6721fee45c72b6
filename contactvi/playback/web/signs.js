// Signs of contact: arrows of forces in the colours of their pairs, of impulses, and points by what they do. What bodies
// hide of an arrow is faint; they never hide points. However many there are, they take a dozen drawing calls. Impulses
// that would lie over each other in a picture that stands still are drawn beside each other, with lines to their points.

const IMPACT_COLOR = 0xe0431f, INK = "#1d2733";
const MODE_COLORS = {stick: 0x0072b2, slip: 0xe69f00, roll: 0x009e73, frictionless: 0x8c8c8c};
const FAINT = 0.45;  // opacity of what is behind bodies
const APART = 11;  // [px] between impulses in a picture that stands still

// Arrows with a light seam, which sets them off against dark bodies: faint without regard to what is before them, and
// over that as far as they are seen.
class Arrows {
  constructor(scene, thick, order) {
    this.scene = scene;
    this.thick = thick;  // [m] radius of a shaft
    this.count = 0;
    this.meshes = [];
    this.kinds = [[false, FAINT, 1.7], [false, FAINT, 1], [true, 1, 1.7], [true, 1, 1]]
      .map(([behind, opacity, wide], k) => ({behind, opacity, wide, order: order + k}));
    this.parts = {
      shaft: new THREE.CylinderGeometry(1, 1, 1, 12).rotateX(Math.PI / 2).translate(0, 0, 0.5),
      head: new THREE.CylinderGeometry(0, 1, 1, 16).rotateX(Math.PI / 2).translate(0, 0, 0.5)};
    this.grow(32);
    this.made = [new THREE.Matrix4(), new THREE.Vector3(), new THREE.Quaternion(), new THREE.Vector3()];
    this.places = [];
  }

  grow(capacity) {
    for (const {mesh} of this.meshes) {
      this.scene.remove(mesh);
      mesh.material.dispose();
      mesh.dispose();
    }
    this.capacity = capacity;
    const kinds = this.kinds.flatMap(kind => Object.entries(this.parts).map(part => [kind, part]));
    this.meshes = kinds.map(([{behind, opacity, wide, order}, [part, geometry]]) => {
      const material = new THREE.MeshBasicMaterial({transparent: true, opacity, depthTest: behind, depthWrite: false});
      const mesh = new THREE.InstancedMesh(geometry, material, capacity);
      mesh.frustumCulled = false;
      mesh.renderOrder = order;
      mesh.setColorAt(0, new THREE.Color(0xffffff));  // three.js asks for colours when it draws for the first time
      this.scene.add(mesh);
      return {mesh, part, wide};
    });
  }

  begin() { this.places = []; }

  add(point, direction, length, color) { this.places.push([point.clone(), direction.clone(), length, color]); }

  end() {
    this.count = this.places.length;
    if (this.count > this.capacity) { this.grow(2 * this.count); }
    const [matrix, at, turn, size] = this.made, z = new THREE.Vector3(0, 0, 1);
    const white = new THREE.Color(0xffffff), own = new THREE.Color();
    this.places.forEach(([point, direction, length, color], k) => {
      own.set(color).convertSRGBToLinear();
      turn.setFromUnitVectors(z, direction);
      const radius = Math.min(this.thick, 0.06 * length), head = 8 * radius;
      for (const {mesh, part, wide} of this.meshes) {
        const seam = (wide - 1) * radius, start = part === "head" ? length - head - seam : -seam;
        at.copy(point).addScaledVector(direction, start);
        if (part === "head") {
          size.set(3 * radius + 1.6 * seam, 3 * radius + 1.6 * seam, head + 4 * seam);
        } else {
          size.set(radius + seam, radius + seam, Math.max(length - head + 2 * seam, 1e-9));
        }
        mesh.setMatrixAt(k, matrix.compose(at, turn, size));
        mesh.setColorAt(k, wide > 1 ? white : own);
      }
    });
    for (const {mesh} of this.meshes) {
      mesh.count = this.count;
      mesh.instanceMatrix.needsUpdate = mesh.instanceColor.needsUpdate = true;
    }
  }
}

// Discs of one size on the screen, each in a colour with a light seam.
class Dots {
  constructor(stage, order) {
    this.stage = stage;
    const disc = discTexture();
    this.layers = [false, true].map((colored, k) => {
      const points = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({map: disc, color: 0xffffff,
        vertexColors: colored, sizeAttenuation: false, transparent: true, depthTest: false, depthWrite: false}));
      points.frustumCulled = false;
      points.renderOrder = order + k;
      stage.scene.add(points);
      return points;
    });
    this.begin();
  }

  begin() { this.places = []; this.colors = []; }

  add(point, color) {
    this.places.push(point.x, point.y, point.z);
    this.colors.push(...new THREE.Color(color).convertSRGBToLinear().toArray());
  }

  end() {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(this.places, 3));
    geometry.setAttribute("color", new THREE.Float32BufferAttribute(this.colors, 3));
    this.layers[0].geometry.dispose();
    for (const points of this.layers) { points.geometry = geometry; }
  }

  get count() { return this.places.length / 3; }

  // A third of an ordinary body, but neither lost nor in the way.
  size() {
    const {stage} = this, {camera, view} = stage, away = camera.position.distanceTo(new THREE.Vector3(...view.center));
    const pixels = stage.height * stage.ordinary / (2 * away * Math.tan(camera.fov * Math.PI / 360));
    const size = Math.max(3.5, Math.min(9, 0.35 * pixels, stage.height / 75)) * stage.renderer.getPixelRatio();
    this.layers[0].material.size = 1.45 * size;
    this.layers[1].material.size = size;
  }
}

function discTexture() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const pen = canvas.getContext("2d");
  pen.fillStyle = "#fff";
  pen.arc(32, 32, 30, 0, 2 * Math.PI);
  pen.fill();
  return new THREE.CanvasTexture(canvas);
}

class Signs {
  constructor(stage, source) {
    this.stage = stage;
    this.source = source;
    const size = stage.view.size;
    this.scale = 1;
    // [m] at the scale 1: peaks are cut, unless the scale is given.
    this.longest = source.forceScale ? Infinity : stage.view.longest * stage.view.arrow;
    this.forces = new Arrows(stage.scene, 0.007 * size, 20);
    this.impacts = new Arrows(stage.scene, 0.007 * size, 30);
    this.dots = new Dots(stage, 40);
    this.leaders = new THREE.LineSegments(new THREE.BufferGeometry(),
      new THREE.LineBasicMaterial({color: IMPACT_COLOR, depthTest: false, depthWrite: false, transparent: true}));
    this.leaders.frustumCulled = false;
    this.leaders.renderOrder = 29;
    stage.scene.add(this.leaders);
    this.struck = [];  // the impulses that are shown, in the order of time
    this.apart = () => false;  // whether they are drawn beside each other
    stage.beforeDraw = () => { this.dots.size(); this.placeImpacts(); };
    this.shown = {forces: true, points: true, impacts: true};
    this.least = 0;  // [N s] impacts below are not shown
  }

  // [m/N] at the scale 1.
  get perNewton() {
    return this.source.forceScale ? 1 / this.source.forceScale : this.stage.view.arrow / (this.source.fullForce || 1);
  }

  // [m/(N s)] of impulses.
  get perNewtonSecond() { return this.stage.view.arrow / (this.source.events.strongest || 1); }

  // Show what happens at t; impacts for a while of viewing time. Returns the strongest impact shown, -1 without one.
  show(t, speed) {
    const {forces, dots, source} = this, direction = new THREE.Vector3(), cut = this.longest * this.scale;
    for (const part of [forces, dots]) { part.begin(); }
    source.contacts(t, (point, force, mode, pair) => {
      if (this.shown.points) { dots.add(point, MODE_COLORS[MODES[mode]]); }
      const strength = force.length();
      if (this.shown.forces && strength > 0) {
        const length = Math.min(strength * this.perNewton * this.scale, cut);
        forces.add(point, direction.copy(force).divideScalar(strength), length, source.pair(pair).color);
      }
    });
    const latest = this.showImpacts(t, speed);
    for (const part of [forces, dots]) { part.end(); }
    this.placed = null;
    this.placeImpacts();
    this.stage.draw();
    return latest;
  }

  showImpacts(t, speed) {
    const {events, start, end} = this.source, {afterglow, arrow} = this.stage.view;
    const window = Math.min(afterglow * speed, (end - start) / 12);
    let strongest = -1;
    this.struck = [];
    for (let k = lastNotAbove(events.time, t + 1e-9); k >= 0 && events.time[k] > t - window - 1e-9; --k) {
      if (!events.isImpact(k) || events.impulse[k] < this.least) { continue; }
      if (strongest < 0 || events.impulse[k] > events.impulse[strongest]) { strongest = k; }
      if (!this.shown.impacts || !events.drawn[k]) { continue; }
      const share = events.strongest > 0 ? events.impulse[k] / events.strongest : 1;
      this.struck.unshift({point: new THREE.Vector3().fromArray(events.point, 3 * k),
        direction: new THREE.Vector3().fromArray(events.direction, 3 * k), length: arrow * Math.max(share, 0.15)});
    }
    return strongest;
  }

  // Draw the impulses: at their points, or beside each other as the camera sees them.
  placeImpacts() {
    const {stage, struck, impacts} = this, {camera} = stage, apart = this.apart() && struck.length > 1;
    const seen = apart ? [...camera.position.toArray(), ...camera.quaternion.toArray(), stage.width, stage.height].join() : "";
    if (seen === this.placed) { return; }
    this.placed = seen;
    const ends = [];
    impacts.begin();
    this.starts = apart ? this.besides() : struck.map(({point}) => point);
    struck.forEach(({point, direction, length}, k) => {
      impacts.add(this.starts[k], direction, length, IMPACT_COLOR);
      if (this.starts[k] !== point) { ends.push(...point.toArray(), ...this.starts[k].toArray()); }
    });
    impacts.end();
    this.leaders.geometry.dispose();
    this.leaders.geometry = new THREE.BufferGeometry();
    this.leaders.geometry.setAttribute("position", new THREE.Float32BufferAttribute(ends, 3));
    this.leaders.visible = ends.length > 0;
  }

  // The boxes around the impulses [px].
  boxes() {
    const {stage} = this, point = new THREE.Vector3();
    return this.struck.map(({direction, length}, k) => {
      const [a, b] = [0, length].map(reach => point.copy(this.starts[k]).addScaledVector(direction, reach)
        .project(stage.camera).toArray()).map(([x, y]) => [(0.5 + 0.5 * x) * stage.width, (0.5 - 0.5 * y) * stage.height]);
      return {x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2, width: Math.abs(a[0] - b[0]) + 4, height: Math.abs(a[1] - b[1]) + 4};
    });
  }

  // Where the impulses start such that none lies over another one, each as near to its point as the earlier ones leave
  // room for.
  besides() {
    const {stage} = this, {camera} = stage, tip = new THREE.Vector3(), taken = [];
    camera.updateMatrixWorld();
    const pixel = place => place.project(camera) &&
      [(0.5 + 0.5 * place.x) * stage.width, (0.5 - 0.5 * place.y) * stage.height];
    const [right, up, ahead] = [0, 1, 2].map(axis => new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, axis));
    return this.struck.map(({point, direction, length}) => {
      const a = pixel(point.clone()), b = pixel(tip.copy(point).addScaledVector(direction, length));
      const depth = -tip.copy(point).sub(camera.position).dot(ahead);
      const perPixel = 2 * depth * Math.tan(camera.fov * Math.PI / 360) / stage.height;
      const shift = freeShift(a, b, taken, stage.width, stage.height);
      taken.push([a, b].map(end => [end[0] + shift[0], end[1] + shift[1]]));
      if (!shift[0] && !shift[1]) { return point; }
      return point.clone().addScaledVector(right, shift[0] * perPixel).addScaledVector(up, -shift[1] * perPixel);
    });
  }
}

// The shortest shift [px] of the arrow from a to b that leaves APART to all that are taken: to its sides first, then
// around. None where there is no room in the picture.
function freeShift(a, b, taken, width, height) {
  const size = Math.hypot(b[0] - a[0], b[1] - a[1]) || 1, across = [(a[1] - b[1]) / size, (b[0] - a[0]) / size];
  const free = ([x, y]) => {
    const moved = [a, b].map(end => [end[0] + x, end[1] + y]);
    return moved.every(([u, v]) => u >= 0 && u <= width && v >= 0 && v <= height) &&
      taken.every(other => between(...moved, ...other) >= APART);
  };
  if (taken.every(other => between(a, b, ...other) >= APART)) { return [0, 0]; }
  for (let ring = 1; ring < 16; ++ring) {
    for (let turn = 0; turn < 8; ++turn) {
      const angle = Math.PI * [0, 4, 1, 7, 3, 5, 2, 6][turn] / 4, reach = APART * 1.05 * ring;
      const [c, s] = [reach * Math.cos(angle), reach * Math.sin(angle)];
      const shift = [c * across[0] - s * across[1], c * across[1] + s * across[0]];
      if (free(shift)) { return shift; }
    }
  }
  return [0, 0];
}

// The distance of two segments in the plane.
function between(a, b, c, d) {
  const turn = (p, q, r) => (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
  if (turn(a, b, c) * turn(a, b, d) < 0 && turn(c, d, a) * turn(c, d, b) < 0) { return 0; }
  const toSegment = (p, q, r) => {
    const [x, y] = [r[0] - q[0], r[1] - q[1]], square = x * x + y * y;
    const share = square > 0 ? Math.max(0, Math.min(1, ((p[0] - q[0]) * x + (p[1] - q[1]) * y) / square)) : 0;
    return Math.hypot(p[0] - q[0] - share * x, p[1] - q[1] - share * y);
  };
  return Math.min(toSegment(a, c, d), toSegment(b, c, d), toSegment(c, a, b), toSegment(d, a, b));
}
