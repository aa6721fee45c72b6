// Signs of contact: arrows of forces in the colours of their pairs, of impulses, and points by what they do. What bodies
// hide of an arrow is faint; they never hide points. However many there are, they take ten drawing calls.

const IMPACT_COLOR = 0xe0431f, INK = "#1d2733";
const MODE_COLORS = {stick: 0x0072b2, slip: 0xe69f00, roll: 0x009e73, frictionless: 0x8c8c8c};
const ARROW_LENGTH = 0.4;  // of the size of the bodies, for the full force
const FAINT = 0.45;  // opacity of what is behind bodies
const AFTERGLOW = 0.25;  // [s] of viewing for which an impact is shown

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
    this.longest = 1.5 * ARROW_LENGTH * size;  // at the scale 1: peaks are cut
    this.forces = new Arrows(stage.scene, 0.007 * size, 20);
    this.impacts = new Arrows(stage.scene, 0.007 * size, 30);
    this.dots = new Dots(stage, 40);
    stage.beforeDraw = () => this.dots.size();
    this.shown = {forces: true, points: true, impacts: true};
    this.least = 0;  // [N s] impacts below are not shown
  }

  // [m/N] at the scale 1.
  get perNewton() { return ARROW_LENGTH * this.stage.view.size / (this.source.fullForce || 1); }

  // Show what happens at t; impacts for a while of viewing time. Returns the strongest impact shown, -1 without one.
  show(t, speed) {
    const {forces, dots, impacts, source} = this, direction = new THREE.Vector3(), cut = this.longest * this.scale;
    for (const part of [forces, dots, impacts]) { part.begin(); }
    source.contacts(t, (point, force, mode, pair) => {
      if (this.shown.points) { dots.add(point, MODE_COLORS[MODES[mode]]); }
      const strength = force.length();
      if (this.shown.forces && strength > 0) {
        const length = Math.min(strength * this.perNewton * this.scale, cut);
        forces.add(point, direction.copy(force).divideScalar(strength), length, source.pair(pair).color);
      }
    });
    const latest = this.showImpacts(t, speed);
    for (const part of [forces, dots, impacts]) { part.end(); }
    this.stage.draw();
    return latest;
  }

  showImpacts(t, speed) {
    const events = this.source.events, window = Math.min(AFTERGLOW * speed, (this.source.end - this.source.start) / 12);
    const full = ARROW_LENGTH * this.stage.view.size, point = new THREE.Vector3(), direction = new THREE.Vector3();
    let strongest = -1;
    for (let k = lastNotAbove(events.time, t + 1e-9); k >= 0 && events.time[k] > t - window - 1e-9; --k) {
      if (!events.isImpact(k) || events.impulse[k] < this.least) { continue; }
      if (strongest < 0 || events.impulse[k] > events.impulse[strongest]) { strongest = k; }
      if (!this.shown.impacts || !events.drawn[k]) { continue; }
      point.fromArray(events.point, 3 * k);
      direction.fromArray(events.direction, 3 * k);
      const share = events.strongest > 0 ? events.impulse[k] / events.strongest : 1;
      this.impacts.add(point, direction, full * Math.max(share, 0.15), IMPACT_COLOR);
    }
    return strongest;
  }
}
