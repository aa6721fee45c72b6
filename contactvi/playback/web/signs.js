// Signs of contact: arrows of forces and impulses, points by what they do. Bodies never hide them. However many there
// are, they take six drawing calls.

const FORCE_COLOR = 0x1e4fbf, IMPACT_COLOR = 0xe0431f;
const MODE_COLORS = {stick: 0x0072b2, slip: 0xe69f00, roll: 0x009e73, frictionless: 0x8c8c8c};
const ARROW_LENGTH = 0.4;  // of the size of the bodies, for the full force
const AFTERGLOW = 0.25;  // [s] of viewing for which an impact is shown

// Arrows of one colour with a light seam, which sets them off against dark bodies.
class Arrows {
  constructor(scene, color, thick, order) {
    this.scene = scene;
    this.thick = thick;  // [m] radius of a shaft
    this.count = 0;
    this.meshes = [];
    this.kinds = [[0xffffff, 1.7, order], [color, 1, order + 1]];
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
    this.meshes = this.kinds.flatMap(([color, wide, order]) => Object.entries(this.parts).map(([part, geometry]) => {
      const material = new THREE.MeshBasicMaterial({color: new THREE.Color(color).convertSRGBToLinear(),
        transparent: true, depthTest: false, depthWrite: false});
      const mesh = new THREE.InstancedMesh(geometry, material, capacity);
      mesh.frustumCulled = false;
      mesh.renderOrder = order;
      this.scene.add(mesh);
      return {mesh, part, wide};
    }));
  }

  begin() { this.places = []; }

  add(point, direction, length) { this.places.push([point.clone(), direction.clone(), length]); }

  end() {
    this.count = this.places.length;
    if (this.count > this.capacity) { this.grow(2 * this.count); }
    const [matrix, at, turn, size] = this.made, z = new THREE.Vector3(0, 0, 1);
    this.places.forEach(([point, direction, length], k) => {
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
      }
    });
    for (const {mesh} of this.meshes) {
      mesh.count = this.count;
      mesh.instanceMatrix.needsUpdate = true;
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
    this.forces = new Arrows(stage.scene, FORCE_COLOR, 0.007 * size, 20);
    this.impacts = new Arrows(stage.scene, IMPACT_COLOR, 0.007 * size, 30);
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
    source.contacts(t, (point, force, mode) => {
      if (this.shown.points) { dots.add(point, MODE_COLORS[MODES[mode]]); }
      const strength = force.length();
      if (this.shown.forces && strength > 0) {
        const length = Math.min(strength * this.perNewton * this.scale, cut);
        forces.add(point, direction.copy(force).divideScalar(strength), length);
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
      this.impacts.add(point, direction, full * Math.max(share, 0.15));
    }
    return strongest;
  }
}
